"""The environment Nomad/Localize-v0, in which a filter runs, and a policy that drives on an estimate.

They are here and not in nserver_emu.gym, which imports no filter; Gymnasium finds the environment by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from localization.filters.base import LocalizationConfig, sonar_of
from localization.filters.belief import POSE, add, difference, independent, nees
from localization.filters.health import HealthStatus
from localization.filters.registry import DEFAULT_METHOD
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule, SensorData
from localization.navigation.control_law import MODEL_LIMITS
from localization.navigation.obstacles import ObstacleTracker
from localization.navigation.pilot import Pilot
from localization.navigation.roadmap import Planner
from nclient.protocol.types import M_PER_IN
from nserver_emu.gym.environments import RobotEnv
from nserver_emu.gym.robots import BoolArray, Sensed
from nserver_emu.gym.tasks import MAX_COORDINATE_M, Observation, Scene, Score, Task, wrapped
from worlds.geometry import FloatArray
from worlds.io import load_world
from worlds.robots import N150, Body
from worlds.world import World

RIGHT_REWARD: Final = 10.0
"""Of an estimate that is certain and right; its negative, if it is certain and wrong, or lost."""
MAX_NEES: Final = 16.27
"""99.9 % of the squared errors of a right estimate are smaller: chi-square with three degrees of freedom."""
IN_METRES: Final = np.array([M_PER_IN, M_PER_IN, 1.0])
"""Converts a pose (3,) in inches and radians."""


class Localize(Task):
    """Drive so that the estimate becomes certain.

    A filter gets the robot's encoders and sonars, as by `nomad localize`; it begins somewhere near the robot. Observed
    besides: `estimate` (x, y, heading) and `std`, its standard deviations. Rewarded: information gained, in nats, and
    10 for an estimate that is certain and right; -10 if it is certain and wrong, or lost, which end an episode, too.

    Parameters
    ----------
    start_std
        Standard deviations of the first estimate's error: m, m, rad.
    certain_std
        Standard deviations below which an estimate is certain.
    method
        Name of a filter (localization.filters.registry).
    has_rays
        True for sonars that are exact rays, False for cones (setups measured and building, real robots).
    """

    def __init__(self, start_std: tuple[float, float, float] = (0.3, 0.3, 0.2),
                 certain_std: tuple[float, float, float] = (0.02, 0.02, 0.015), method: str = DEFAULT_METHOD, *,
                 has_rays: bool = True) -> None:  # fmt: skip
        self._start_std, self._certain_std = np.array(start_std) / IN_METRES, np.array(certain_std) / IN_METRES
        self._method, self._has_rays = method, has_rays

    def prepare(self, scene: Scene, count: int) -> None:
        """Make room for filters. Raises ValueError without a world, which is the filter's map."""
        super().prepare(scene, count)
        if scene.world is None:
            raise ValueError("expected a world: it is the map of the filter")
        sonar = sonar_of(scene.body.ring, rays=self._has_rays)
        self._config = LocalizationConfig(scene.world.walls, scene.body, sonar=sonar)
        self._localizers: list[Localizer | None] = [None] * count
        self._estimates: list[Estimate] = []
        self._information = np.zeros(count)

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Add estimate and standard deviations."""
        pose = np.array([MAX_COORDINATE_M, MAX_COORDINATE_M, np.pi], dtype=np.float32)
        return super().spaces() | {"estimate": spaces.Box(-pose, pose, dtype=np.float32),
                                   "std": spaces.Box(np.zeros(POSE, dtype=np.float32), pose, dtype=np.float32)}

    def begin(self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Begin with estimates whose errors are drawn from their covariance."""
        super().begin(mask, sensed, rng, options)
        for row in np.flatnonzero(mask).tolist():
            error = self._start_std * rng.standard_normal(POSE)
            belief = independent(add(sensed.actual[row, :POSE], error), self._start_std)
            ring = self.scene.body.ring
            schedule = FiringSchedule(0.0, ring.interval_s, ring.firing)
            self._localizers[row] = Localizer(self._config, belief, schedule, self._method, int(rng.integers(2**31)))

    def observe(self, sensed: Sensed) -> Observation:
        """Let the filters take the new readings into account."""
        found = super().observe(sensed)
        self._estimates = []
        for row, localizer in enumerate(self._localizers):
            assert localizer is not None
            x_in, y_in, steering_rad, turret_rad = sensed.encoder[row].tolist()
            readings = tuple(sensed.ranges_in[row].tolist())
            state = SensorData(float(sensed.time_s[row]), x_in, y_in, steering_rad, turret_rad, readings,
                               bool(sensed.is_touching[row]))  # fmt: skip
            self._estimates.append(localizer.update(state))
        means, stds = self._means() * IN_METRES, np.minimum(self._stds() * IN_METRES, MAX_COORDINATE_M)
        means[:, 2] = wrapped(means[:, 2])
        stds[:, 2] = np.minimum(stds[:, 2], np.pi)
        return found | {"estimate": means.astype(np.float32), "std": stds.astype(np.float32)}

    def score(self, sensed: Sensed) -> Score:
        """Reward the information gained; a certain or lost estimate ends the episode."""
        covs = np.array([estimate.belief.cov[:POSE, :POSE] for estimate in self._estimates])
        # Differential entropy of a normal distribution is half the log of its determinant, and a constant.
        information = -0.5 * np.linalg.slogdet(covs)[1]
        rewards = information - self._information
        self._information = information
        is_certain = (self._stds() <= self._certain_std).all(axis=1)
        is_lost = np.array([each.health.status is HealthStatus.LOST for each in self._estimates])
        is_right = nees(difference(self._means(), sensed.actual[:, :POSE]), covs) <= MAX_NEES
        is_success, is_failed = is_certain & is_right & ~is_lost, is_lost | (is_certain & ~is_right)
        return Score(rewards + RIGHT_REWARD * is_success - RIGHT_REWARD * is_failed, is_success, is_failed)

    def _means(self) -> FloatArray:
        return np.array([estimate.pose for estimate in self._estimates])

    def _stds(self) -> FloatArray:
        return np.array([estimate.belief.std[:POSE] for estimate in self._estimates])

    def marks_in(self, row: int) -> FloatArray:
        """Return the estimated position."""
        return self._means()[row : row + 1, :2]


def localize(world: Any = "thesis_room", method: str = DEFAULT_METHOD, *, has_rays: bool = True,
             **options: Any) -> RobotEnv:
    """Return the environment Nomad/Localize-v0."""
    return RobotEnv(Localize(method=method, has_rays=has_rays), world=world, **options)


class PilotPolicy:
    """A policy of Nomad/GoTo-v0: localization and path planning, as by `nomad go`, on the map of a world.

    Parameters
    ----------
    world
        The map: a name, a file or a world.
    body
        Of the robot.
    speed_m_s
        Highest speed.
    has_rays
        As of `Localize`.
    """

    START_STD: Final = (0.2, 0.2, 0.01)
    """Of the encoders' pose at the beginning: inches, inches, radians."""

    def __init__(self, world: str | World, body: Body = N150, speed_m_s: float = 0.2, *, has_rays: bool = True) -> None:
        self._world = load_world(world) if isinstance(world, str) else world
        self._body, self._limits = body, MODEL_LIMITS[body.name].capped(speed_m_s / M_PER_IN)
        self._planner = Planner(self._world.walls, body.radius_in)
        self._config = LocalizationConfig(self._world.walls, body, sonar=sonar_of(body.ring, rays=has_rays))

    def __call__(self, observation: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[Any]:
        """Return the action; an episode begins at time 0."""
        # 1. The observation as a state of the robot: readings are multiples of the ring's resolution.
        ring = self._body.ring
        x_in, y_in, heading = (observation["pose"] / IN_METRES).tolist()
        readings = np.rint(observation["ranges"] / M_PER_IN / ring.resolution_in) * ring.resolution_in
        state = SensorData(float(observation["time"][0]), x_in, y_in, heading, heading, tuple(readings.tolist()))
        if observation["time"][0] == 0.0:
            self._begin((x_in, y_in, heading), observation["goal"].tolist())
        # 2. The estimate, and the command of the pilot.
        command = self._pilot.step(self._localizer.update(state), state)
        return np.array([command.translation_in_s * M_PER_IN, command.steering_rad_s], dtype=np.float32)

    def _begin(self, pose: tuple[float, float, float], goal: list[float]) -> None:
        distance_in, direction = goal[0] / M_PER_IN, pose[2] + goal[1]
        goal_in = (pose[0] + distance_in * np.cos(direction), pose[1] + distance_in * np.sin(direction))
        ring = self._body.ring
        schedule = FiringSchedule(0.0, ring.interval_s, ring.firing)
        self._localizer = Localizer(self._config, independent(pose, self.START_STD), schedule)
        obstacles = ObstacleTracker(self._world.walls, ring.radius_in)
        self._pilot = Pilot(self._planner, self._limits, obstacles, [goal_in])
