"""The sonar ring: the sequence of firing, and the readings. Poses and time are passed in.

    order 0 2 15 1 ..., rate 15:    0 fires at 0 ms, 2 at 60 ms, 15 at 120 ms, 1 at 180 ms ... and again

Number, directions, firing and limits of the sonars are those of the body's `Ring` (worlds/rings.py).

A firing records its pose and walls and draws its noise; the range is computed when a reading is used. An unused ring
therefore costs nothing, and reading it earlier or later changes no value. The sonar model
computes the range: SonarNoise, one exact ray with noise, or Polaroid (acoustics.py), which models a real ring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from math import cos, inf, sin
from typing import ClassVar, Final, NamedTuple

import numpy as np

from nclient.protocol.types import MAX_SONAR_RATE, SONAR_RATE_STEP_S
from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap, SonarErrors, range_std_in
from nserver_emu.simulation.segments import NO_STAMP, PS_PER_S, TIME_MAX_PS, SegmentTime, Stamp
from nserver_emu.simulation.visibility import NEAREST_OBSTACLE, SensorPose, nearest_disc
from worlds.geometry import FloatArray, near_walls
from worlds.raycast_arrays import cast_each
from worlds.robots import Body

DEAD_IN: Final = 0
"""The reading of a dead sonar."""

TICK_PS: Final = round(SONAR_RATE_STEP_S * PS_PER_S)
"""The unit of the firing rate, 4 ms."""

MAX_RATE: Final = MAX_SONAR_RATE
"""The largest firing rate that a byte on the robot's serial line can hold; the slowest ring."""

MAX_UNSELECTED_WALLS: Final = 100
"""With more walls, those in reach are selected first."""

MAX_ORDER: Final = 256
"""Sonars in the order of a restored ring: conf_sn may name one several times."""

MAX_EARLIER_PINGS: Final = 10_000
"""Pings that a restored ring may still have in flight: 30 s of them, the longest that the settings permit."""


@dataclass(frozen=True, slots=True)
class SonarNoise(SonarErrors):
    """The ideal sonar: one exact ray, with Gaussian noise of its range (none where both deviations are 0)."""

    audible_ps: ClassVar[int] = 0
    """There is no cross-talk between rays."""

    @property
    def has_noise(self) -> bool:
        """True if ranges are noisy."""
        return bool(self.range_std_floor_in or self.range_std_relative)

    def surfaces(self, _seed: int) -> None:
        """Return None: exact rays meet the walls as the map has them."""

    def draw(self, rng: np.random.Generator) -> tuple[float, ...]:
        """Draw the noise of a ping: one number, or 0 without drawing where there is no noise."""
        return (rng.standard_normal(),) if self.has_noise else (0.0,)

    def measured_ranges(self, pings: Sequence[Ping], sensor_poses: Sequence[SensorPose], walls: FloatArray,
                        body: Body) -> list[float]:
        """Return the range from the ring along each ray to a wall (m, 4) or a robot, with noise, inches; inf for none.

        The number of rays in a call changes no bit of the result.
        """
        # 0. Among many walls, those that an echo can come from.
        if len(walls) > MAX_UNSELECTED_WALLS:
            walls = self._walls_in_reach(pings, walls, body)
        # 1. Ranges from the axis.
        from_axis = ranges_from_axis(pings, sensor_poses, walls)
        # 2. From the ring, with noise.
        ring_in = body.sonar_ring_radius_in
        if not self.has_noise:
            return [range_in - ring_in for range_in in from_axis]
        stds = self.range_std_relative, self.range_std_floor_in
        return [noisy_range(range_in - ring_in, ping.noise[0], *stds)
                for range_in, ping in zip(from_axis, pings, strict=True)]

    def _walls_in_reach(self, pings: Sequence[Ping], walls: FloatArray, body: Body) -> FloatArray:
        """Return the walls that decide the readings of these pings."""
        x, y = [ping.x_in for ping in pings], [ping.y_in for ping in pings]
        apart_in = max(max(x) - min(x), max(y) - min(y))
        reach_in = self.reach_in(body.ring.max_range_in) + body.ring.radius_in + apart_in
        return near_walls(x[0], y[0], reach_in, walls)


def noisy_range(range_in: float, noise: float, relative: float, floor_in: float) -> float:
    """Return a range with noise, given as a standard normal number; infinity and ranges without noise as they are."""
    return range_in + noise * range_std_in(range_in, relative, floor_in) if noise and range_in < inf else range_in


def shifted(x_in: float, y_in: float, direction_rad: float, shift_in: Sequence[float]) -> tuple[float, float]:
    """Return a point moved along a direction and to the left of it."""
    cosine, sine = cos(direction_rad), sin(direction_rad)
    forwards_in, left_in = shift_in[0], shift_in[1]
    return x_in + forwards_in * cosine - left_in * sine, y_in + forwards_in * sine + left_in * cosine


def ranges_from_axis(pings: Sequence[Ping], sensor_poses: Sequence[SensorPose], walls: FloatArray) -> list[float]:
    """Return the range from the axis of the ring along each ray to a wall (m, 4) or a robot, inches; inf for none."""
    rays = [(ping.x_in, ping.y_in, cos(ping.direction_rad), sin(ping.direction_rad)) for ping in pings]
    NEAREST_OBSTACLE.count_calls(len(rays))
    if NEAREST_OBSTACLE.is_compiled:
        cast = NEAREST_OBSTACLE.run
        return [cast(*ray, walls, pose.robots.sorted, pose.self_index, pose.robots.max_radius_in)
                for ray, pose in zip(rays, sensor_poses, strict=True)]
    return [nearest_disc(*ray, wall_in, pose.robots.rows, pose.self_index, pose.robots.max_radius_in)
            for ray, pose, wall_in in zip(rays, sensor_poses, cast_each(rays, walls), strict=True)]


IDEAL_SONAR: Final = SonarNoise()
"""Exact ranges."""

SonarModel = SonarNoise | Polaroid
"""The sonar model of a setup: `draw` the noise of a ping, measure the range; `audible_ps`, `dead` and `offsets_in`."""


class Firing(NamedTuple):
    """A ping whose range has not been computed yet, the pings before it that are still audible, its pose and walls."""

    ping: Ping
    earlier: tuple[Ping, ...]
    sensor_pose: SensorPose
    reflectors: ReflectorMap


class SonarState(NamedTuple):
    """The state of a ring in a snapshot; fields as those of `SonarRing`."""

    readings: tuple[float, ...]
    stamps: tuple[Stamp, ...]
    pings: tuple[Ping | None, ...]
    earlier: tuple[Ping, ...]
    firing: tuple[tuple[int, ...], ...]
    interval_ps: int
    fired: int
    due_ps: int


class SonarRing:
    """The sonars of a body, which fire one after another, or in groups.

    Attributes
    ----------
    due_ps
        The instant of the next firing; TIME_MAX_PS if the ring is off.
    """

    def __init__(self, body: Body, model: SonarModel, walls: FloatArray, rng: np.random.Generator,
                 surface_seed: int = 0) -> None:
        self.body = body
        self.model = model
        self._surface_seed = surface_seed
        self._reflectors = ReflectorMap(walls, model.surfaces(surface_seed))
        self._rng = rng
        self._ring = ring = body.ring
        self._reach_in = model.reach_in(ring.max_range_in)
        silent = ring.plain(ring.no_echo_in)
        self._readings: list[float] = [DEAD_IN if sonar in model.dead else silent for sonar in range(ring.count)]
        self._stamps: list[Stamp | SegmentTime] = [NO_STAMP] * ring.count
        self._pings: list[Ping | None] = [None] * ring.count
        self._pending: dict[int, Firing] = {}
        self._earlier: tuple[Ping, ...] = ()
        self._firing: tuple[tuple[int, ...], ...] = ()
        self._interval_ps = self._count = 0
        self.due_ps = TIME_MAX_PS

    def to_state(self) -> SonarState:
        """Return all that changes; pending ranges are computed, which changes no reading."""
        return SonarState(self.readings_in, self.stamps, self.pings, self._earlier, self._firing, self._interval_ps,
                          self._count, self.due_ps)

    def set_state(self, state: SonarState, now_ps: int) -> None:
        """Continue from a state; raise ValueError if it is not one of a ring."""
        # An interval and an order bound the number of firings in a step.
        if state.due_ps != TIME_MAX_PS and not (state.firing and TICK_PS <= state.interval_ps <= MAX_RATE * TICK_PS
                                                and now_ps <= state.due_ps <= now_ps + MAX_RATE * TICK_PS):
            raise ValueError("a sonar ring without an interval or an order")
        # One value per sonar, each in its range.
        ring = self._ring
        if not all(len(values) == ring.count for values in (state.readings, state.stamps, state.pings)):
            raise ValueError(f"a sonar ring without {ring.count} readings")
        fired = [sonar for group in state.firing for sonar in group]
        if len(fired) > MAX_ORDER or not all(state.firing) or not {*fired} <= {*range(ring.count)} or state.fired < 0:
            raise ValueError("a sonar ring with unknown sonars")
        if not all(map(ring.is_reading, state.readings)):
            raise ValueError("a sonar reading out of range")
        # Pings lie in the past: the age of a ping decides how far its sound has travelled.
        pings = (*state.earlier, *(ping for ping in state.pings if ping is not None))
        if len(state.earlier) > MAX_EARLIER_PINGS or not all(0 <= ping.instant_ps <= now_ps for ping in pings):
            raise ValueError("a ping of another time")
        self._readings = list(map(ring.plain, state.readings))
        self._stamps, self._pings = list(state.stamps), list(state.pings)
        self._earlier, self._firing, self._interval_ps = state.earlier, state.firing, state.interval_ps
        self._count, self.due_ps = state.fired, state.due_ps
        self._pending.clear()

    @property
    def readings_in(self) -> tuple[float, ...]:
        """The last reading of each sonar: inches from the ring, as `Ring.reading`; 0 where dead."""
        self._compute_pending()
        return tuple(self._readings)

    @property
    def stamps(self) -> tuple[Stamp, ...]:
        """The time stamp of each of those readings."""
        return tuple(stamp if isinstance(stamp, Stamp) else stamp.stamp for stamp in self._stamps)

    @property
    def pings(self) -> tuple[Ping | None, ...]:
        """The ping of each of those readings, with its true pose; None since the robot was moved by hand."""
        return tuple(self._pings)

    def forget_pings(self) -> None:
        """Forget the poses of the readings, because the robot was moved by hand; the readings remain."""
        self._pings = [None] * self._ring.count

    def configure(self, rate: int, order: Sequence[int], now_ps: int) -> None:
        """Restart the ring, one sonar after the other: entry k is due 4 ms x rate x k from now, and so on.

        Parameters
        ----------
        rate
            Clamped to 1..255.
        order
            Sonar numbers; ends at the first that is not one (255 by convention). Without any the ring is off, and the
            readings remain.
        """
        sonars = takewhile(range(self._ring.count).__contains__, order)
        self._restart(tuple((sonar,) for sonar in sonars), min(max(rate, 1), MAX_RATE) * TICK_PS, now_ps)

    def restart(self, now_ps: int) -> None:
        """Restart the ring with the order and the interval that its model gives."""
        self._restart(self._ring.firing, round(self._ring.interval_s * PS_PER_S), now_ps)

    def _restart(self, firing: tuple[tuple[int, ...], ...], interval_ps: int, now_ps: int) -> None:
        self._firing, self._interval_ps, self._count = firing, interval_ps, 0
        self.due_ps = now_ps if firing else TIME_MAX_PS

    def emit_due(self, sensor_pose: SensorPose, stamp: Stamp | SegmentTime) -> None:
        """Fire the sonar that is due, or the group of them, at this pose."""
        group = self._firing[self._count % len(self._firing)]
        instant_ps, audible_ps = self.due_ps, self.model.audible_ps
        # 1. Pings that are still audible disturb this one.
        if audible_ps:
            self._earlier = tuple(ping for ping in self._earlier if instant_ps - ping.instant_ps < audible_ps)
        # 2. The pings; those of a group disturb one another.
        pings = [self._emit(sonar, sensor_pose, stamp, instant_ps, self._earlier) for sonar in group]
        if audible_ps:
            for sonar, ping in zip(group, pings, strict=True) if len(group) > 1 else ():
                others = tuple(other for other in pings if other is not ping)
                self._pending[sonar] = self._pending[sonar]._replace(earlier=(*self._earlier, *others))
            self._earlier = (*self._earlier, *pings)
        # 3. The next entry of the order.
        self._count += 1
        self.due_ps += self._interval_ps

    def emit_all(self, sensor_pose: SensorPose, stamp: Stamp | SegmentTime) -> None:
        """Fire all as at power-on, each as if it were alone."""
        for sonar in range(self._ring.count):
            self._emit(sonar, sensor_pose, stamp, 0, ())

    def set_walls(self, walls: FloatArray) -> None:
        """Replace the walls (m, 4); earlier pings still meet the previous ones."""
        self._reflectors = ReflectorMap(walls, self._reflectors.surfaces)

    def set_model(self, model: SonarModel) -> None:
        """Replace the sonar model; earlier pings are measured with the previous one, and disturb no later ping."""
        self._compute_pending()
        self._earlier = ()
        self.model, self._reach_in = model, model.reach_in(self._ring.max_range_in)
        self._reflectors = ReflectorMap(self._reflectors.walls, model.surfaces(self._surface_seed))
        for sonar in range(self._ring.count):
            if sonar in model.dead:
                self._readings[sonar] = DEAD_IN

    def _emit(self, sonar: int, sensor_pose: SensorPose, stamp: Stamp | SegmentTime, instant_ps: int,
              earlier: tuple[Ping, ...]) -> Ping:
        x, y, turret_rad, _, _ = sensor_pose
        # The beam points away from the axis of the ring, or from one beside it.
        direction_rad = turret_rad + self.model.turned_rad + self._ring.angles_rad[sonar]
        if self._ring.shifts_in:
            x, y = shifted(x, y, direction_rad, self._ring.shifts_in[sonar])
        ping = Ping(x, y, direction_rad, instant_ps, self.model.draw(self._rng))
        self._pending[sonar] = Firing(ping, earlier, sensor_pose, self._reflectors)
        self._stamps[sonar] = stamp
        self._pings[sonar] = ping
        return ping

    def compute_some(self) -> bool:
        """Compute one of the readings that are pending; return True if none are left."""
        if self._pending and isinstance(self.model, Polaroid):
            self._compute(self.model, next(iter(self._pending)))
            return not self._pending
        return True

    def _compute_pending(self) -> None:
        """Compute the readings of all firings since the last call."""
        if isinstance(self.model, Polaroid):
            for sonar in tuple(self._pending):
                self._compute(self.model, sonar)
        elif self._pending:
            self._cast(self.model)

    def _compute(self, model: Polaroid, sonar: int) -> None:
        """Compute a pending reading by the acoustics."""
        ping, earlier, pose, reflectors = self._pending.pop(sonar)
        # Dead sonars draw noise as well, but are never computed.
        if sonar not in model.dead:
            range_in = model.measured_range(ping, earlier, reflectors, self.body, pose.others, self._reach_in)
            self._readings[sonar] = self._ring.reading(range_in + model.offset_in(sonar))

    def _cast(self, model: SonarNoise) -> None:
        """Compute all pending readings by exact rays."""
        # Firings among the same walls are computed together; between two readings walls seldom change.
        by_walls: dict[int, dict[int, Firing]] = {}
        for sonar, firing in self._pending.items():
            if sonar not in model.dead:
                by_walls.setdefault(id(firing.reflectors), {})[sonar] = firing
        for group in by_walls.values():
            firings = list(group.values())
            pings, poses = [firing.ping for firing in firings], [firing.sensor_pose for firing in firings]
            ranges_in = model.measured_ranges(pings, poses, firings[0].reflectors.walls, self.body)
            for sonar, range_in in zip(group, ranges_in, strict=True):
                self._readings[sonar] = self._ring.reading(range_in + model.offset_in(sonar))
        self._pending.clear()
