"""Tasks of robots: what they observe, how they are rewarded, and when a task is done; for n robots at once.

Observations are dictionaries of arrays in metres, radians and seconds, of what a real robot measures: its encoders and
sonars. Rewards and ends use the true pose, which of a connected robot is that of the encoders.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from math import pi
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from nclient.protocol.types import M_PER_IN
from nserver_emu.gym.robots import BoolArray, Sensed
from worlds.geometry import FloatArray
from worlds.rings import Ring
from worlds.robots import Body
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

    def begin(
        self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]
    ) -> None:
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

    def begin(
        self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]
    ) -> None:
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

    def begin(
        self, mask: BoolArray, sensed: Sensed, rng: np.random.Generator, options: Mapping[str, Any]
    ) -> None:
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
