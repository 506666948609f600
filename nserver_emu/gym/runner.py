"""A task and its robots, one control period at a time: what environments of one and of many robots have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from nclient.common.hints import suggest
from nclient.protocol.types import M_PER_IN
from nserver_emu.gym.robots import BatchRobots, BoolArray, ConnectedRobot, Robots, SimulatedRobots
from nserver_emu.gym.tasks import CONTACT_REWARD, Observation, Scene, Task, beam_points, poses_m
from nserver_emu.simulation.models import MODELS, RobotModel
from nserver_emu.simulation.noise import SETUPS, RobotSetup
from worlds.drawing import ESTIMATE, GOAL, TRUTH, blank, draw_body, draw_walls, pixels, require_matplotlib
from worlds.geometry import FloatArray
from worlds.io import load_world
from worlds.world import World

RESET_OPTIONS: Final = ("start_m", "goal_m")
"""Options of a reset: x, y in metres and the heading in radians; x, y in metres."""
PLACE_SPACING_IN: Final = 4.0
"""Between places at which episodes begin."""
MARGIN_IN: Final = 6.0
"""Between a robot at a place and the walls; robots that share a world are as far apart."""
PASSAGE_IN: Final = 1.0
"""Between a robot on its way to a place and the walls."""
RENDER_FPS: Final = 5
RENDER_IN: Final = 5.0
"""Size of a rendered picture, which has 100 pixels per inch."""


@dataclass(frozen=True, slots=True)
class RunnerOptions:
    """Options that all environments have.

    Attributes
    ----------
    world
        A name, a file or a world; None: none, beside an address.
    model, setup
        Of the robots; names, or what they stand for.
    address
        Of a robot to connect to, which then needs neither model nor setup.
    period_s
        Of a step.
    max_speed_m_s, max_turn_rad_s
        Bounds of the actions.
    """

    world: str | World | None = "several_walls"
    model: str | RobotModel = "n150"
    setup: str | RobotSetup = "noisy"
    address: str | None = None
    period_s: float = 0.2
    max_speed_m_s: float = 0.3
    max_turn_rad_s: float = radians(40.0)

    def loaded_world(self) -> World | None:
        """Return the world."""
        return load_world(self.world) if isinstance(self.world, str) else self.world

    def robots(self, count: int, world: World | None, is_batch: bool, threads: int | None = None) -> Robots:
        """Return robots: at the address, of a batch, or of one simulation."""
        if self.address is not None:
            return ConnectedRobot(self.address)
        if world is None:
            raise ValueError("expected a world, or the address of a robot")
        model, setup = _named(self.model, MODELS, "model"), _named(self.setup, SETUPS, "setup")
        if is_batch:
            return BatchRobots(world, count, model, setup, threads)
        return SimulatedRobots(world, count, model, setup)


def _named(value: Any, table: Mapping[str, Any], kind: str) -> Any:
    """Return the value of a name, or the value itself."""
    if not isinstance(value, str):
        return value
    if value not in table:
        raise ValueError(f"no {kind} {value!r}; there are {', '.join(table)}{suggest(value, table)}")
    return table[value]


class Outcome(NamedTuple):
    """Result of a step of n robots: observations, rewards (n,), ends (n,), and whether the task is done (n,)."""

    observations: Observation
    rewards: FloatArray
    terminated: BoolArray
    is_success: BoolArray


class TaskRunner:
    """A task, carried out by robots.

    Attributes
    ----------
    task, robots, options
        As given.
    observation_space, action_space
        Of one robot. An action is a speed in m/s and a turn rate in rad/s.
    """

    def __init__(
        self, task: Task, options: RunnerOptions, count: int = 1, *, is_batch: bool = False, threads: int | None = None
    ) -> None:
        # A robot at an address drives in a world that is not known.
        world = options.loaded_world()
        self.task, self.options = task, options
        self.robots = options.robots(count, world, is_batch, threads)
        # Robots of one simulation must not touch at their starts.
        self._is_shared = count > 1 and not is_batch
        places_in = np.zeros((0, 2)) if options.address or world is None else reachable_places(world, self.robots)
        try:
            task.prepare(Scene(self.robots.body, world, places_in), count)
        except BaseException:
            self.robots.close()
            raise
        limits = np.array([options.max_speed_m_s, options.max_turn_rad_s], dtype=np.float32)
        self.action_space = spaces.Box(-limits, limits, dtype=np.float32)
        self.observation_space: Any = spaces.Dict(task.spaces())

    def reset(
        self, mask: BoolArray, rng: np.random.Generator, options: Mapping[str, Any] | None, *, is_seeded: bool
    ) -> Observation:
        """Begin episodes of the robots of a mask (n,), and return the observations of all.

        Parameters
        ----------
        options
            RESET_OPTIONS, for all robots of the mask.
        is_seeded
            True to restart the robots' own random streams with a number from `rng`.
        """
        options = options or {}
        for name in options:
            if name not in RESET_OPTIONS:
                raise ValueError(
                    f"no option {name!r} of a reset; there are {', '.join(RESET_OPTIONS)}{suggest(name, RESET_OPTIONS)}"
                )
        # The order of draws is the same for any options, so that a seed gives one robot in any of them.
        seed = int(rng.integers(2**31)) if is_seeded else None
        self.robots.reset(mask, self._starts(rng, options), seed)
        sensed = self.robots.sense()
        self.task.begin(mask, sensed, rng, options)
        observations = self.task.observe(sensed)
        self.task.score(sensed)
        return observations

    def _starts(self, rng: np.random.Generator, options: Mapping[str, Any]) -> FloatArray:
        """Return a start (n, 4) for each robot: given, random, or none for a robot at an address."""
        count, places = len(self.robots), self.task.scene.places_in
        starts = np.zeros((count, 4))
        if "start_m" in options:
            x, y, heading = options["start_m"]
            starts[:] = x / M_PER_IN, y / M_PER_IN, heading, heading
        elif len(places):
            rows = rng.integers(len(places), size=count) if not self._is_shared else self._apart(rng, places)
            starts[:, :2], starts[:, 2] = places[rows], rng.uniform(0.0, 2.0 * np.pi, count)
            starts[:, 3] = starts[:, 2]
        return starts

    def _apart(self, rng: np.random.Generator, places: FloatArray) -> list[int]:
        """Return rows of places (k, 2) for all robots, far enough apart."""
        chosen: list[int] = []
        apart_in = 2.0 * self.robots.body.radius_in + MARGIN_IN
        for row in rng.permutation(len(places)).tolist():
            if len(chosen) < len(self.robots) and (np.hypot(*(places[chosen] - places[row]).T) > apart_in).all():
                chosen.append(row)
        if len(chosen) < len(self.robots):
            raise ValueError(f"the world has room for {len(chosen)} robots at once, expected {len(self.robots)}")
        return chosen

    def step(self, actions: npt.ArrayLike, is_driving: BoolArray | None = None) -> Outcome:
        """Drive for a period with actions (n, 2), which are clipped to their bounds.

        `is_driving` (n,) is False for robots that shall stand.
        """
        # 1. The period.
        clipped = np.clip(np.asarray(actions, dtype=np.float64), self.action_space.low, self.action_space.high)
        if is_driving is not None:
            clipped[~is_driving] = 0.0
        self.robots.drive(clipped[:, 0] / M_PER_IN, clipped[:, 1])
        self.robots.step(self.options.period_s)
        # 2. What it brought.
        sensed = self.robots.sense()
        observations = self.task.observe(sensed)
        rewards, is_success, is_failed = self.task.score(sensed)
        touched = sensed.is_touching & ~is_success
        terminated = is_success | is_failed | touched
        return Outcome(observations, rewards + CONTACT_REWARD * touched, terminated, is_success)

    def poses_m(self) -> FloatArray:
        """Return the true poses (n, 3) in metres and radians."""
        return poses_m(self.robots.sense().actual)

    def render(self) -> npt.NDArray[np.uint8]:
        """Return a picture (height, width, 3) of the world, the robots and what they are to do."""
        require_matplotlib()
        sensed, body = self.robots.sense(), self.robots.body
        picture = blank(RENDER_IN, RENDER_IN)
        axes = picture.add_subplot(aspect="equal")
        axes.set_axis_off()
        # 1. The world.
        if self.task.scene.world is not None:
            draw_walls(axes, self.task.scene.world.walls)
        for row, pose in enumerate(sensed.actual):
            # 2. The robot with its readings, as points.
            draw_body(axes, pose, body, TRUTH)
            ranges_in = sensed.ranges_in[row]
            has_echo = (ranges_in < body.ring.max_range_in) & (ranges_in != body.ring.no_echo_in)
            echoes = beam_points(body.ring, pose[np.newaxis], ranges_in[:, np.newaxis])[:, 0, has_echo, 0]
            axes.plot(*echoes, ".", color=ESTIMATE, markersize=4)
            # 3. Its task.
            axes.plot(*self.task.marks_in(row).T, marker="X", color=GOAL, markersize=10, linestyle="")
        return pixels(picture)


def reachable_places(world: World, robots: Robots) -> FloatArray:
    """Return points (k, 2) of a grid at which a robot fits, and which it reaches from the world's first start."""
    # 1. A grid over the world, aligned to the first start, which is one of its points.
    start = np.array([world.starts[0].x_in, world.starts[0].y_in])
    ends = world.walls.reshape(-1, 2)
    low, high = (ends.min(axis=0), ends.max(axis=0)) if len(ends) else (start - 100.0, start + 100.0)
    first = start - np.ceil((start - low) / PLACE_SPACING_IN) * PLACE_SPACING_IN
    counts = np.ceil((high - first) / PLACE_SPACING_IN).astype(int) + 1
    columns, rows = (first[axis] + PLACE_SPACING_IN * np.arange(counts[axis]) for axis in (0, 1))
    points = np.stack(np.meshgrid(columns, rows), axis=-1)
    clearances = world.clearances(points) - robots.body.radius_in
    is_free = clearances > PASSAGE_IN
    # 2. Grow from the start over free neighbours until nothing is added.
    at_column, at_row = np.rint((start - first) / PLACE_SPACING_IN).astype(int)
    is_reached = np.zeros_like(is_free)
    is_reached[at_row, at_column] = True
    while True:
        grown = is_reached.copy()
        grown[1:] |= is_reached[:-1]
        grown[:-1] |= is_reached[1:]
        grown[:, 1:] |= is_reached[:, :-1]
        grown[:, :-1] |= is_reached[:, 1:]
        grown &= is_free | is_reached
        if (grown == is_reached).all():
            break
        is_reached = grown
    # 3. Those with room around; the start alone, if there are none.
    roomy = is_reached & (clearances > MARGIN_IN)
    return points[roomy if roomy.any() else is_reached]
