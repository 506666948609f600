"""Tasks of robots: what they observe, how they are rewarded, and when a task is done; for n robots at once.

Observations are dictionaries of arrays in metres, radians and seconds, of what a real robot measures: its encoders and
sonars. Rewards and ends use the true pose, which of a connected robot is that of the encoders.

A task and its robots, one control period at a time: what environments of one and of many robots have in common.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, radians
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from nclient.errors import suggest
from nclient.protocol.types import M_PER_IN
from nserver_emu.gym.robots import BatchRobots, BoolArray, ConnectedRobot, Robots, Sensed, SimulatedRobots
from nserver_emu.simulation.models import MODELS, RobotModel
from nserver_emu.simulation.noise import SETUPS, RobotSetup
from worlds.drawing import ESTIMATE, GOAL, TRUTH, blank, draw_body, draw_walls, pixels, require_matplotlib
from worlds.geometry import FloatArray
from worlds.io import load_world
from worlds.rings import Ring
from worlds.robots import Body
from worlds.validate import OpenNodes
from worlds.world import World

Observation = dict[str, npt.NDArray[Any]]
"""Arrays by name; of n robots with n rows."""

CONTACT_REWARD: Final = -1.0
"""Of a contact, which ends an episode."""
SUCCESS_REWARD: Final = 1.0

MAX_COORDINATE_M: Final = 1000.0
MAX_TIME_S: Final = 1e6
MAX_SPEED_M_S: Final = 10.0
MAX_TURN_RAD_S: Final = 10.0


class Scene(NamedTuple):
    """Constants that the robots of a task share.

    Attributes
    ----------
    body
        Of all robots.
    world
        None for a connected robot whose world is not known.
    places_in
        Points (k, 2) at which a robot fits and that all others can reach; empty without a world.
    """

    body: Body
    world: World | None
    places_in: FloatArray


class Score(NamedTuple):
    """Rewards (n,), True where the task is done (n,), and True where it can no longer be done."""

    rewards: FloatArray
    is_success: BoolArray
    is_failed: BoolArray


class Task(ABC):
    """A task of n robots.

    `prepare` comes first, then for each step `observe` and `score`; `begin` for robots whose episode begins.
    """

    scene: Scene

    def prepare(self, scene: Scene, count: int) -> None:
        """Make room for so many robots."""
        self.scene = scene
        self._time_s, self._poses = np.zeros(count), np.zeros((count, 3))
        self._velocities = np.zeros((count, 2))

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Return the spaces of one robot's observation by name."""
        ring = self.scene.body.ring
        reading_m = max(ring.max_range_in, ring.no_echo_in) * M_PER_IN
        pose = np.array([MAX_COORDINATE_M, MAX_COORDINATE_M, pi])
        return {
            "ranges": _box(np.zeros(ring.count), np.full(ring.count, reading_m)),
            "pose": _box(-pose, pose),
            "velocity": _box([-MAX_SPEED_M_S, -MAX_TURN_RAD_S], [MAX_SPEED_M_S, MAX_TURN_RAD_S]),
            "time": _box([0.0], [MAX_TIME_S]),
        }

    def begin(self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Begin an episode of the robots of a mask (n,); `options` are those of the reset."""
        del rng, options
        self._time_s[mask], self._poses[mask] = sensed.time_s[mask], poses_m(sensed.encoder)[mask]
        self._velocities[mask] = 0.0

    def observe(self, sensed: Sensed) -> Observation:
        """Return what all robots observe, after each step once."""
        poses = poses_m(sensed.encoder)
        # Velocities are those of the encoders since the last observation; the sign is that of the heading then.
        passed_s = sensed.time_s - self._time_s
        dx, dy, turn = (poses - self._poses).T
        heading = self._poses[:, 2]
        ahead = np.copysign(np.hypot(dx, dy), dx * np.cos(heading) + dy * np.sin(heading))
        steps = np.column_stack((ahead, wrapped(turn)))
        moved = passed_s > 0.0
        self._velocities[moved] = steps[moved] / passed_s[moved, np.newaxis]
        self._time_s, self._poses = sensed.time_s.copy(), poses
        return {
            "ranges": (sensed.ranges_in * M_PER_IN).astype(np.float32),
            "pose": poses.astype(np.float32),
            "velocity": self._velocities.astype(np.float32),
            "time": sensed.time_s[:, np.newaxis].astype(np.float32),
        }

    @abstractmethod
    def score(self, sensed: Sensed) -> Score:
        """Return rewards without those of contacts, and who is done; after each `observe` once."""

    def marks_in(self, row: int) -> FloatArray:
        """Return points (k, 2) to draw for a robot."""
        del row
        return np.zeros((0, 2))


def poses_m(poses_in: FloatArray) -> FloatArray:
    """Return poses (n, 4) of the simulation as x and y in metres and heading from -pi to pi (n, 3)."""
    return np.column_stack((poses_in[:, :2] * M_PER_IN, wrapped(poses_in[:, 2])))


def wrapped(angles_rad: FloatArray) -> FloatArray:
    """Return angles from -pi to pi."""
    return (angles_rad + pi) % (2.0 * pi) - pi


def beam_points(ring: Ring, poses_in: FloatArray, along_in: FloatArray) -> FloatArray:
    """Return points on the beams of sonars, x and y (2, n, s, k), in inches.

    Parameters
    ----------
    ring
        s sonars.
    poses_in
        Of n robots (n, 4).
    along_in
        Distances from the sonars, of a shape that fits (n, s, k).
    """
    directions, ring_in, left_in = np.array(ring.mounts).T[..., np.newaxis]
    x, y, turret = poses_in[:, [0, 1, 3]].T[..., np.newaxis, np.newaxis]
    c, s = np.cos(turret + directions), np.sin(turret + directions)
    ahead_in = ring_in + along_in
    return np.array([x + ahead_in * c - left_in * s, y + ahead_in * s + left_in * c])


def _box(low: npt.ArrayLike, high: npt.ArrayLike) -> spaces.Box:
    return spaces.Box(np.asarray(low, dtype=np.float32), np.asarray(high, dtype=np.float32), dtype=np.float32)


class GoTo(Task):
    """Drive to a goal.

    Observed besides: `goal`, its distance and its bearing from the heading, by the encoders. Rewarded: metres nearer
    to the goal, and 1 for reaching it.

    Parameters
    ----------
    goal_m
        x and y; None: a random place, which a world must be given for. The option `goal_m` of a reset comes first.
    within_m
        Distance at which the goal is reached.
    """

    MIN_DISTANCE_M: Final = 0.5
    """A random goal is farther away."""

    def __init__(self, goal_m: tuple[float, float] | None = None, within_m: float = 0.15) -> None:
        self._goal_m, self._within_m = goal_m, within_m

    def prepare(self, scene: Scene, count: int) -> None:
        """Make room for goals."""
        super().prepare(scene, count)
        self._goals, self._left_m = np.zeros((count, 2)), np.zeros(count)

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Add the goal."""
        return super().spaces() | {"goal": _box([0.0, -pi], [2.0 * MAX_COORDINATE_M, pi])}

    def begin(self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Set goals: given ones, or random ones."""
        super().begin(mask, sensed, rng, options)
        actual = poses_m(sensed.actual)
        fixed = options.get("goal_m", self._goal_m)
        if fixed is not None:
            self._goals[mask] = fixed
        else:
            self._goals[mask] = self._random_goals(actual[mask, :2], rng)
        self._left_m[mask] = np.hypot(*(self._goals - actual[:, :2]).T)[mask]

    def _random_goals(self, from_m: FloatArray, rng: np.random.Generator) -> FloatArray:
        places = self.scene.places_in * M_PER_IN
        if not len(places):
            raise ValueError("expected a goal beside an address: gymnasium.make(..., goal_m=(x, y)), in metres")
        drawn = places[rng.integers(len(places), size=len(from_m))]
        # Draw again what is too near; the farthest place after as many tries as are ever needed.
        for _ in range(100):
            near = np.hypot(*(drawn - from_m).T) < self.MIN_DISTANCE_M
            if not near.any():
                break
            drawn[near] = places[rng.integers(len(places), size=int(near.sum()))]
        return drawn

    def observe(self, sensed: Sensed) -> Observation:
        """Add distance and bearing of the goal."""
        found = super().observe(sensed)
        x, y, heading = poses_m(sensed.encoder).T
        dx, dy = self._goals[:, 0] - x, self._goals[:, 1] - y
        bearing = wrapped(np.arctan2(dy, dx) - heading)
        return found | {"goal": np.column_stack((np.hypot(dx, dy), bearing)).astype(np.float32)}

    def score(self, sensed: Sensed) -> Score:
        """Reward the distance that was gained."""
        left_m = np.hypot(*(self._goals - sensed.actual[:, :2] * M_PER_IN).T)
        is_success = left_m <= self._within_m
        rewards = self._left_m - left_m + SUCCESS_REWARD * is_success
        self._left_m = left_m
        return Score(rewards, is_success, np.zeros_like(is_success))

    def marks_in(self, row: int) -> FloatArray:
        """Return the goal."""
        return self._goals[row : row + 1] / M_PER_IN


class Explore(Task):
    """See as much of an unknown world as possible.

    Observed besides: `seen`, cells of 0.25 m that a ray has passed, of a square around the start, rows from south to
    north in the frame of the encoders. Rewarded: square metres seen for the first time. Only the time limit and
    contacts end an episode.
    """

    CELL_M: Final = 0.25
    CELLS: Final = 96
    """Of a side: 24 m."""
    MAX_RANGE_M: Final = 3.0
    """What lies farther away does not count as seen: a sonar's cone is a metre wide there."""

    def prepare(self, scene: Scene, count: int) -> None:
        """Make room for maps."""
        super().prepare(scene, count)
        self._seen = np.zeros((count, self.CELLS, self.CELLS), dtype=np.uint8)
        self._origins, self._count = np.zeros((count, 2)), np.zeros(count, dtype=np.int64)

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Add the map."""
        return super().spaces() | {"seen": spaces.Box(0, 1, (self.CELLS, self.CELLS), np.uint8)}

    def begin(self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Forget what was seen."""
        super().begin(mask, sensed, rng, options)
        self._seen[mask] = 0
        self._origins[mask] = sensed.encoder[mask, :2] * M_PER_IN - 0.5 * self.CELLS * self.CELL_M
        self._count[mask] = 0

    def observe(self, sensed: Sensed) -> Observation:
        """Add the cells that rays have passed."""
        found = super().observe(sensed)
        # 1. Points along each ray, half a cell apart (n, s, k); the last cell before an echo is not counted.
        reached = np.minimum(sensed.ranges_in * M_PER_IN - self.CELL_M, self.MAX_RANGE_M)
        along = np.arange(0.0, self.MAX_RANGE_M, 0.5 * self.CELL_M)
        is_free = along <= reached[:, :, np.newaxis]
        points = beam_points(self.scene.body.ring, sensed.encoder, along / M_PER_IN) * M_PER_IN
        # 2. Their cells.
        origins = self._origins.T[..., np.newaxis, np.newaxis]
        columns, rows = np.floor((points - origins) / self.CELL_M)
        is_inside = is_free & (columns >= 0) & (rows >= 0) & (columns < self.CELLS) & (rows < self.CELLS)
        robots = np.broadcast_to(np.arange(len(reached))[:, np.newaxis, np.newaxis], is_inside.shape)
        self._seen[robots[is_inside], rows[is_inside].astype(int), columns[is_inside].astype(int)] = 1
        return found | {"seen": self._seen.copy()}

    def score(self, sensed: Sensed) -> Score:
        """Reward the cells that are new."""
        del sensed
        count = self._seen.sum(axis=(1, 2), dtype=np.int64)
        rewards = (count - self._count) * self.CELL_M**2
        self._count = count
        never = np.zeros(len(count), dtype=np.bool_)
        return Score(rewards, never, never)


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

    def __init__(self, task: Task, options: RunnerOptions, count: int = 1, *, is_batch: bool = False,
                 threads: int | None = None) -> None:
        # A robot at an address drives in a world that is not known.
        world = load_world(options.world) if isinstance(options.world, str) else options.world
        self.task, self.options, self._count = task, options, count
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

    def reset(self, mask: BoolArray, rng: np.random.Generator, options: Mapping[str, Any] | None, *,
              is_seeded: bool) -> Observation:
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
                raise ValueError(f"no option {name!r} of a reset; there are "
                                 f"{', '.join(RESET_OPTIONS)}{suggest(name, RESET_OPTIONS)}")
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
        count, places = self._count, self.task.scene.places_in
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
            if len(chosen) < self._count and (np.hypot(*(places[chosen] - places[row]).T) > apart_in).all():
                chosen.append(row)
        if len(chosen) < self._count:
            raise ValueError(f"the world has room for {len(chosen)} robots at once, expected {self._count}")
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
    # 2. Flood from the start, which counts as free, over free neighbours.
    at_column, at_row = np.rint((start - first) / PLACE_SPACING_IN).astype(int).tolist()
    is_free[at_row, at_column] = True
    is_reached = np.zeros_like(is_free)
    is_reached[tuple(OpenNodes(is_free).flood(at_row, at_column).T)] = True
    # 3. Those with room around; the start alone, if there are none.
    roomy = is_reached & (clearances > MARGIN_IN)
    return points[roomy if roomy.any() else is_reached]
