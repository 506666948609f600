"""The compiled part of the batch simulation: how one robot of many advances, as `SimulatedRobot` does.

The formulas are those of axis, segments, drive, collision, odometry, sonar and worlds.raycast: numba
compiles the same source. What stands here is only what connects them: there in objects, here in arrays.
A robot is a record, and a batch an array of them; robots do not see each other, so threads advance parts of the array
in parallel.

numpy's random streams as functions of an array, for compiled code: PCG64 and its standard normal numbers.

A stream is a row of four 64-bit words: both halves of the 128-bit state, and of the increment. Its numbers are those of
`numpy.random.Generator(PCG64)`, whose streams `RngFactory` makes, in the same order.

References
----------
O'Neill, PCG: a family of simple fast space-efficient statistically good algorithms (2014): the generator XSL RR 128/64.
Marsaglia and Tsang, The ziggurat method for generating random variables (2000), as numpy implements it.
"""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable
from functools import cache, wraps
from inspect import isfunction
from math import atan2, copysign, cos, exp, inf, log1p, sin
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from numba import extending, types
from numba.np.random import _constants

from nserver_emu.simulation import acoustics, axis, collision, drive, odometry, segments, sonar
from nserver_emu.simulation.axis import TIME_TOLERANCE_S, Phase, advance_phases, phase_now, plan_distance, plan_velocity
from nserver_emu.simulation.collision import Capsule, Contact, PlacedSegment
from nserver_emu.simulation.drive import NO_TRACK, AxisRate, path_segment, until_reversal
from nserver_emu.simulation.noise import Purpose, RngFactory
from nserver_emu.simulation.odometry import disturbed_segment, erroneous_segment
from nserver_emu.simulation.segments import PS_PER_S, ConstantAccelerationSegment, wrap_to_2pi
from nserver_emu.simulation.sonar import MAX_ORDER, noisy_range, shifted
from worlds import raycast, rings
from worlds.compiled import checksum, compile_function, functions_of, make_compilable
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast import ON_LINE_IN, ON_WALL_IN, mean_ahead, nearest_wall
from worlds.rings import MAX_SONARS, quantized_range
from worlds.robots import MAX_BUMPERS

Words = npt.NDArray[np.uint64]

_MULTIPLIER_HIGH: Final = np.uint64(2549297995355413924)
_MULTIPLIER_LOW: Final = np.uint64(4865540595714422341)
_WORD: Final = 1 << 64
_HALF: Final = np.uint64(32)
_LOW_HALF: Final = np.uint64(0xFFFFFFFF)

# The layers of the ziggurat are numpy's; numba carries them for its own generators.
_WIDTHS: Final[npt.NDArray[np.float64]] = np.array(_constants.wi_double)
_LIMITS: Final[Words] = np.array(_constants.ki_double)
_HEIGHTS: Final[npt.NDArray[np.float64]] = np.array(_constants.fi_double)
_TAIL: Final = float(_constants.ziggurat_nor_r)
_TAIL_INVERSE: Final = float(_constants.ziggurat_nor_inv_r)


def stream_words(factory: RngFactory, purpose: Purpose) -> list[int]:
    """Return the words of a robot's stream, before its first number."""
    state: Any = factory.stream(purpose).bit_generator.state
    found = state["state"]
    return [word for number in (found["state"], found["inc"]) for word in divmod(number, _WORD)]


def standard_normal(words: Words) -> float:
    """Draw the next standard normal number of a stream (4,), which advances."""
    while True:
        # 1. A layer of the ziggurat, a sign and a place in the layer from one word.
        word = next_word(words)
        layer = word & np.uint64(0xFF)
        place = (word >> np.uint64(9)) & np.uint64(0x000FFFFFFFFFFFFF)
        x: float = float(place) * _WIDTHS[layer]
        if (word >> np.uint64(8)) & np.uint64(1):
            x = -x
        # 2. 99 of 100 lie in the part of the layer that is wholly below the density.
        if place < _LIMITS[layer]:
            return x
        # 3. The tail, or the part of a layer that the density crosses.
        if layer == 0:
            return _tail(words, (place >> np.uint64(8)) & np.uint64(1) != 0)
        if (_HEIGHTS[layer - np.uint64(1)] - _HEIGHTS[layer]) * _uniform(words) + _HEIGHTS[layer] < exp(-0.5 * x * x):
            return x


def _tail(words: Words, is_negative: bool) -> float:
    while True:
        beyond = -_TAIL_INVERSE * log1p(-_uniform(words))
        height = -log1p(-_uniform(words))
        if height + height > beyond * beyond:
            return -(_TAIL + beyond) if is_negative else _TAIL + beyond


def _uniform(words: Words) -> float:
    """Draw a number from [0, 1) with 53 bits."""
    return float(next_word(words) >> np.uint64(11)) / 9007199254740992.0


def next_word(words: Words) -> Any:
    """Draw 64 bits of a stream (4,), which advances."""
    high, low, add_high, add_low = words[0], words[1], words[2], words[3]
    # 1. state = state x multiplier + increment, modulo 2^128.
    product = low * _MULTIPLIER_LOW
    new_low = product + add_low
    new_high = _high_word(low, _MULTIPLIER_LOW) + high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH + add_high
    if new_low < product:
        new_high += np.uint64(1)
    words[0], words[1] = new_high, new_low
    # 2. Both halves combined, rotated by the top six bits.
    combined, turn = new_high ^ new_low, new_high >> np.uint64(58)
    return (combined >> turn) | (combined << ((np.uint64(64) - turn) & np.uint64(63)))


def _high_word(a: Any, b: Any) -> Any:
    """Return the upper 64 bits of a product."""
    a_high, a_low, b_high, b_low = a >> _HALF, a & _LOW_HALF, b >> _HALF, b & _LOW_HALF
    # Products of halves; `middle` collects what carries into the upper word.
    middle = a_high * b_low + ((a_low * b_low) >> _HALF)
    carried = a_low * b_high + (middle & _LOW_HALF)
    return a_high * b_high + (middle >> _HALF) + (carried >> _HALF)


log = logging.getLogger(__name__)

Records = npt.NDArray[np.void]

NEVER_PS: Final = 2**63 - 1
"""An instant that is never reached."""

AXES: Final = 3
PHASES: Final = 5
"""Phases of a planned motion."""

# Columns of the fields pose, angles, spans, streams and limits.
X, Y, YAW, LAG = range(4)
STEERING, TURRET = range(2)
FIRST, END = range(2)
MOTION, SONAR = range(2)
TOP_SPEED, SPEED, ACCELERATION = range(3)


MAX_ENTRIES: Final = MAX_ORDER
"""Entries in the firing order of a batch."""


def robot_dtype(sonars: int) -> np.dtype[np.void]:
    """Return the record of one robot; an array of them has every field as an array of n rows.

    time_ps, deadline_ps, has_timed_out   simulated time, the time-out, and True if it stopped the robot since the
                                          last command
    pose                                  true x, y; yaw of the body, lag of the turret
    angles                                mechanical steering and turret; of a differential drive twice the heading
    encoders                              x, y by dead reckoning
    clearance_in                          lower bound of the distance to the nearest wall
    phases, spans, elapsed_s              planned phases of each axis, the first that is not over and the end, and
                                          how long it has lasted
    due_ps, fired                         the next firing of the ring, and the firings so far
    pings, is_pending, readings_in        by sonar: x, y, direction and noise of its last ping, True until its
                                          reading is computed, the reading
    bumpers                               pressed bumpers as bits
    streams                               random streams of the motion and of the sonars
    wall_begin, wall_end                  rows of the walls of its world
    """
    return np.dtype(
        [
            ("time_ps", np.int64), ("deadline_ps", np.int64), ("pose", np.float64, 4), ("angles", np.float64, 2),
            ("encoders", np.float64, 2), ("clearance_in", np.float64), ("phases", np.float64, (AXES, PHASES, 3)),
            ("spans", np.int64, (AXES, 2)), ("elapsed_s", np.float64, AXES), ("due_ps", np.int64),
            ("fired", np.int64), ("pings", np.float64, (sonars, 4)), ("readings_in", np.float64, sonars),
            ("bumpers", np.int64), ("streams", np.uint64, (2, 4)), ("wall_begin", np.int64), ("wall_end", np.int64),
            ("is_pending", np.int8, sonars), ("has_timed_out", np.bool_),
        ],
        align=True,
    )  # fmt: skip


SETTINGS_DTYPE: Final = np.dtype(
    [
        # Motion: top speed, speed and acceleration of each axis; track (NO_TRACK: a synchro drive).
        ("limits", np.float64, (AXES, 3)), ("has_ramps", np.bool_), ("track_in", np.float64),
        ("alphas", np.float64, 4), ("scales", np.float64, 3), ("drifts", np.float64, 2), ("slip_in", np.float64),
        ("has_exact_motion", np.bool_), ("has_motion_noise", np.bool_), ("has_axis_errors", np.bool_),
        # The body.
        ("radius_in", np.float64), ("bumpers", np.int64), ("bumper_angles_rad", np.float64, MAX_BUMPERS),
        # The sonars: entry k of the order fires order[starts[k]:starts[k + 1]].
        ("ring_in", np.float64), ("turned_rad", np.float64), ("sonars", np.int64),
        ("sonar_angles_rad", np.float64, MAX_SONARS), ("has_shifts", np.bool_),
        ("shifts_in", np.float64, (MAX_SONARS, 2)), ("offsets_in", np.float64, MAX_SONARS),
        ("is_dead", np.int8, MAX_SONARS), ("entries", np.int64), ("order", np.int64, MAX_ENTRIES),
        ("starts", np.int64, MAX_ENTRIES + 1), ("interval_ps", np.int64),
        ("min_range_in", np.float64), ("max_range_in", np.float64), ("resolution_in", np.float64),
        ("no_echo_in", np.float64), ("has_sonar_noise", np.bool_), ("range_std_relative", np.float64),
        ("range_std_floor_in", np.float64),
    ],
    align=True,
)  # fmt: skip
"""The record of what all robots of a batch share: model and setup; fields as those of the classes they come from."""


# The loops over an array of robots.


class Loops(NamedTuple):
    """The loops over an array of robots, in Python or in machine code, which releases the interpreter lock.

    Attributes
    ----------
    advance(robots, settings, walls, dt_ps)
        Let time pass; walls (4, m) are columns x1 y1 x2 y2.
    observe(robots, settings, walls)
        Compute the readings of the sonars that have fired, and the bumpers.
    command(robots, settings, mask, values, is_relative, timeout_ps)
        Command velocities (n, 3), or distances, of the robots of the mask; restart their time-outs.
    start_rings(robots, settings, mask, with_all)
        Restart the rings of the robots of the mask; `with_all` fires all sonars first, as at power-on.
    """

    advance: Callable[..., None]
    observe: Callable[..., None]
    command: Callable[..., None]
    start_rings: Callable[..., None]


def make_loops(sources: int) -> Loops:
    """Return the loops in Python; the checksum of what they call is part of their key in numba's cache."""

    def advance(robots: Records, settings: Records, walls: FloatArray, dt_ps: int) -> None:
        gaps = np.empty(walls.shape[1])
        for i in range(len(robots)):
            _advance(robots[i], settings[0], walls, gaps, robots[i]["time_ps"] + dt_ps)
        assert sources >= 0

    def observe(robots: Records, settings: Records, walls: FloatArray) -> None:
        ranges = np.empty(walls.shape[1])
        for i in range(len(robots)):
            _measure(robots[i], settings[0], walls, ranges)
            robots[i]["bumpers"] = _bumpers(robots[i], settings[0], walls, ranges)
        assert sources >= 0

    def command(robots: Records, settings: Records, mask: BoolArray, values: FloatArray, is_relative: bool,
                timeout_ps: int) -> None:
        for i in range(len(robots)):
            if mask[i]:
                _command(robots[i], settings[0], values[i], is_relative, timeout_ps)
        assert sources >= 0

    def start_rings(robots: Records, settings: Records, mask: BoolArray, with_all: bool) -> None:
        for i in range(len(robots)):
            if mask[i]:
                _start_ring(robots[i], settings[0], with_all)
        assert sources >= 0

    return Loops(advance, observe, command, start_rings)


def _command(robot: np.void, settings: np.void, values: FloatArray, is_relative: bool, timeout_ps: int) -> None:
    robot["deadline_ps"] = robot["time_ps"] + timeout_ps if timeout_ps else NEVER_PS
    robot["has_timed_out"] = False
    for axis_number in range(AXES):
        if is_relative:
            _move_by(robot, settings, axis_number, values[axis_number])
        else:
            _move_at(robot, settings, axis_number, values[axis_number])


def _start_ring(robot: np.void, settings: np.void, with_all: bool) -> None:
    if with_all:
        turret_rad = _turret_direction(robot, robot["angles"][TURRET])
        for sonar_number in range(settings["sonars"]):
            _fire(robot, settings, sonar_number, robot["pose"][X], robot["pose"][Y], turret_rad)
    robot["fired"] = 0
    robot["due_ps"] = robot["time_ps"] if settings["entries"] else NEVER_PS
    _fire_due(robot, settings)


# Time: `SimulatedRobot.advance_to`.


def _advance(robot: np.void, settings: np.void, walls: FloatArray, gaps: FloatArray, end_ps: int) -> None:
    while robot["time_ps"] < end_ps:
        # 1. The next instant at which something other than motion happens.
        until_ps = min(end_ps, robot["deadline_ps"])
        if not settings["has_exact_motion"]:
            until_ps = min(until_ps, robot["due_ps"])
        # 2. Motion up to it, with the sonars that fire in between.
        _move(robot, settings, walls, gaps, (until_ps - robot["time_ps"]) / PS_PER_S)
        robot["time_ps"] = until_ps
        # 3. The events at that instant.
        if until_ps == robot["deadline_ps"]:
            robot["deadline_ps"] = NEVER_PS
            robot["has_timed_out"] = True
            for axis_number in range(AXES):
                _move_at(robot, settings, axis_number, 0.0)
        _fire_due(robot, settings)


# Axes: `Axis`.


def _move_at(robot: np.void, settings: np.void, axis_number: int, velocity: float) -> None:
    top, rate = settings["limits"][axis_number, TOP_SPEED], settings["limits"][axis_number, ACCELERATION]
    wanted = min(max(velocity, -top), top)
    _begin(robot, axis_number, plan_velocity(_now(robot, axis_number)[1], wanted, rate, settings["has_ramps"]))


def _move_by(robot: np.void, settings: np.void, axis_number: int, distance: float) -> None:
    top, rate = settings["limits"][axis_number, SPEED], settings["limits"][axis_number, ACCELERATION]
    velocity = _now(robot, axis_number)[1]
    # At speed 0 the target is never reached: hold instead.
    if top == 0.0:
        _begin(robot, axis_number, plan_velocity(velocity, 0.0, rate, settings["has_ramps"]))
    else:
        _begin(robot, axis_number, plan_distance(velocity, distance, top, rate, settings["has_ramps"]))


def _begin(robot: np.void, axis_number: int, planned: tuple[Phase, ...]) -> None:
    """Begin the phases that have a duration."""
    end = 0
    for phase in planned:
        if phase.duration_s > 0.0:
            row = robot["phases"][axis_number, end]
            row[0], row[1], row[2] = phase.duration_s, phase.velocity, phase.acceleration
            end += 1
    robot["spans"][axis_number, FIRST] = 0
    robot["spans"][axis_number, END] = end
    robot["elapsed_s"][axis_number] = 0.0


def _now(robot: np.void, axis_number: int) -> tuple[float, float, float]:
    """Return `Axis.current_phase`."""
    first = robot["spans"][axis_number, FIRST]
    if first == robot["spans"][axis_number, END]:
        return inf, 0.0, 0.0
    return phase_now(robot["phases"][axis_number, first], robot["elapsed_s"][axis_number])


def _after(robot: np.void, axis_number: int, dt_s: float) -> tuple[float, int, float]:
    """Return `advance_phases` of an axis."""
    first, end = robot["spans"][axis_number, FIRST], robot["spans"][axis_number, END]
    if first == end:
        return 0.0, 0, 0.0
    return advance_phases(robot["phases"][axis_number, first:end], robot["elapsed_s"][axis_number], dt_s)


def _advance_axis(robot: np.void, axis_number: int, dt_s: float) -> float:
    travelled, done, elapsed_s = _after(robot, axis_number, dt_s)
    robot["spans"][axis_number, FIRST] += done
    robot["elapsed_s"][axis_number] = elapsed_s
    return travelled


def _halt(robot: np.void, axis_number: int) -> None:
    robot["spans"][axis_number, END] = robot["spans"][axis_number, FIRST]


# The drive: `SynchroDrive` and `DifferentialDrive`.


def _segment(robot: np.void, settings: np.void, max_s: float) -> ConstantAccelerationSegment:
    first_s, first_velocity, first_acceleration = _now(robot, 0)
    second_s, second_velocity, second_acceleration = _now(robot, 1)
    first, second = AxisRate(first_velocity, first_acceleration), AxisRate(second_velocity, second_acceleration)
    segment = path_segment(min(max_s, first_s, second_s), first, second, settings["track_in"])
    return segment if settings["track_in"] == NO_TRACK else until_reversal(segment)


def _advance_drive(robot: np.void, settings: np.void, dt_s: float) -> float:
    """Advance all axes and return the turn of the turret."""
    first, second = _advance_axis(robot, 0, dt_s), _advance_axis(robot, 1, dt_s)
    if settings["track_in"] != NO_TRACK:
        robot["angles"][STEERING] += (first - second) / settings["track_in"]
        robot["angles"][TURRET] = robot["angles"][STEERING]
        return 0.0
    robot["angles"][STEERING] += second
    turned = _advance_axis(robot, 2, dt_s)
    robot["angles"][TURRET] += turned
    return turned


def _turret_after(robot: np.void, settings: np.void, dt_s: float) -> float:
    if settings["track_in"] != NO_TRACK:
        turned: float = (_after(robot, 0, dt_s)[0] - _after(robot, 1, dt_s)[0]) / settings["track_in"]
    else:
        turned = _after(robot, 2, dt_s)[0]
    angle_rad: float = robot["angles"][TURRET] + turned
    return angle_rad


def _turret_direction(robot: np.void, turret_rad: float) -> float:
    return wrap_to_2pi(turret_rad + robot["pose"][LAG] + robot["pose"][YAW])


# Motion: `SimulatedRobot._move` and `_follow`.


def _move(robot: np.void, settings: np.void, walls: FloatArray, gaps: FloatArray, span_s: float) -> None:
    left_s = span_s
    while left_s > 0.0:
        segment = _segment(robot, settings, left_s)
        # At rest only the turret may turn.
        if segment.speed == segment.turn_rate == segment.acceleration == segment.turn_acceleration == 0.0:
            _fire_along(robot, settings, segment, span_s - left_s, left_s)
            turned_rad = _advance_drive(robot, settings, left_s)
            _turn_uncounted(robot, settings, 0.0, turned_rad)
            return
        left_s -= _follow(robot, settings, walls, gaps, segment, span_s - left_s)


def _follow(robot: np.void, settings: np.void, walls: FloatArray, gaps: FloatArray,
            segment: ConstantAccelerationSegment, begin_s: float) -> float:
    """Follow a segment to its end or to a contact; return the seconds it took."""
    duration = segment.duration_s
    steering_rad = robot["angles"][STEERING]
    # 1. The true motion: systematic errors, then noise.
    actual, is_disturbed = segment, False
    if settings["has_axis_errors"]:
        actual = erroneous_segment(segment, settings["track_in"], settings["scales"], settings["drifts"])
    is_moving = actual.distance_at(duration) != 0.0 or actual.turn_at(duration) != 0.0
    if settings["has_motion_noise"] and is_moving:
        is_disturbed = True
        along_normal = standard_normal(robot["streams"][MOTION])
        turn_normal = standard_normal(robot["streams"][MOTION])
        actual = disturbed_segment(actual, settings["alphas"], along_normal, turn_normal)
    # 2. Contact on it, and whether the commanded motion presses on.
    heading = steering_rad + robot["pose"][YAW]
    contact = _contact(robot, settings, walls, gaps, actual, heading)
    is_blocked, free_s, commanded_in = False, duration, 0.0
    if contact.time_s < inf:
        free_s, commanded_in = contact.time_s, segment.distance_at(duration)
        is_pressing = not is_disturbed or contact.pressed_by(heading + actual.turn_at(free_s), commanded_in)
        is_blocked = commanded_in != 0.0 and is_pressing
    taken_s = free_s if is_blocked else duration
    # 3. Sonars, then the chassis and the encoders, which move by the same numbers without errors.
    _fire_along(robot, settings, segment, begin_s, taken_s)
    dx, dy = actual.displacement(heading, free_s)
    robot["pose"][X] += dx
    robot["pose"][Y] += dy
    robot["clearance_in"] -= actual.length_bound(free_s)
    if is_disturbed or settings["has_axis_errors"] or taken_s != free_s or steering_rad != heading:
        dx, dy = segment.displacement(steering_rad, taken_s)
    robot["encoders"][X] += dx
    robot["encoders"][Y] += dy
    # 4. The axes, and the turns that no encoder counts.
    turned_rad = _advance_drive(robot, settings, taken_s)
    _turn_uncounted(robot, settings, actual.turn_at(taken_s) - segment.turn_at(taken_s), turned_rad)
    # 5. A blocked robot slips, and its wheels stop.
    if is_blocked:
        slip_in, heading = copysign(settings["slip_in"], commanded_in), robot["angles"][STEERING]
        robot["encoders"][X] += slip_in * cos(heading)
        robot["encoders"][Y] += slip_in * sin(heading)
        _halt(robot, 0)
        if settings["track_in"] != NO_TRACK:
            _halt(robot, 1)
    return taken_s


def _turn_uncounted(robot: np.void, settings: np.void, body_rad: float, counted_rad: float) -> None:
    if not settings["has_exact_motion"]:
        robot["pose"][YAW] += body_rad
        robot["pose"][LAG] += (settings["scales"][2] - 1.0) * counted_rad


# Contact: `Chassis`.


def _contact(robot: np.void, settings: np.void, walls: FloatArray, gaps: FloatArray,
             segment: ConstantAccelerationSegment, heading_rad: float) -> Contact:
    # Most segments are shorter than the clearance: nothing needs to be examined.
    distance = segment.length_bound(segment.duration_s)
    if distance == 0.0 or distance < robot["clearance_in"]:
        return collision.NO_CONTACT
    capsules = _walls_within(robot, settings, walls, gaps, distance)
    if not len(capsules):
        return collision.NO_CONTACT
    placed = PlacedSegment(robot["pose"][X], robot["pose"][Y], heading_rad, segment)
    return collision.find_contact(placed, settings["radius_in"], capsules)


def _walls_within(robot: np.void, settings: np.void, walls: FloatArray, gaps: FloatArray,
                  distance_in: float) -> list[Capsule]:
    """Return the walls within a distance, and update the clearance; `gaps` (m,) is overwritten."""
    begin, end = robot["wall_begin"], robot["wall_end"]
    radius_in, x_in, y_in = settings["radius_in"], robot["pose"][X], robot["pose"][Y]
    x1, y1, x2, y2 = walls[0], walls[1], walls[2], walls[3]
    # The gaps to all walls in vectors, as the ranges in `_range_from_axis`; few walls are near.
    for row in range(np.uint64(begin), np.uint64(end)):
        gaps[row] = Capsule(x1[row], y1[row], x2[row], y2[row], 0.0).gap_to(radius_in, x_in, y_in)[0]
    robot["clearance_in"] = _smallest(gaps, begin, end)
    found: list[Capsule] = []
    if robot["clearance_in"] <= distance_in:
        for row in range(begin, end):
            if gaps[row] <= distance_in:
                found.append(Capsule(x1[row], y1[row], x2[row], y2[row], 0.0))
    return found


def _bumpers(robot: np.void, settings: np.void, walls: FloatArray, gaps: FloatArray) -> int:
    bits = 0
    # Nothing can be that near.
    if robot["clearance_in"] > collision.TOUCH_IN:
        return bits
    # The bumpers of a differential drive turn with its heading.
    frame_rad = 0.0 if settings["track_in"] == NO_TRACK else robot["angles"][STEERING]
    front = frame_rad + robot["pose"][YAW]
    for capsule in _walls_within(robot, settings, walls, gaps, collision.TOUCH_IN):
        _, away_x, away_y = capsule.gap_to(0.0, robot["pose"][X], robot["pose"][Y])
        bumper_angles = settings["bumper_angles_rad"][: settings["bumpers"]]
        bits |= collision.touched_bumpers(atan2(-away_y, -away_x) - front, bumper_angles)
    return bits


# Sonars: `SonarRing`, and `SimulatedRobot._emit_along`.


def _fire_along(robot: np.void, settings: np.void, segment: ConstantAccelerationSegment, begin_s: float,
                taken_s: float) -> None:
    """Fire the sonars that are due within the first seconds of a segment, which is about to begin."""
    before_s = taken_s - TIME_TOLERANCE_S
    into_s = (robot["due_ps"] - robot["time_ps"]) / PS_PER_S - begin_s
    heading = robot["angles"][STEERING] + robot["pose"][YAW]
    round_ps = settings["entries"] * settings["interval_ps"]
    while into_s < before_s:
        # A ping that the same sonars repeat within this segment leaves nothing but its noise.
        if (robot["due_ps"] + round_ps - robot["time_ps"]) / PS_PER_S - begin_s < before_s:
            _skip_entry(robot, settings)
        else:
            into_s = max(into_s, 0.0)
            turret_rad = _turret_direction(robot, _turret_after(robot, settings, into_s))
            dx, dy = segment.displacement(heading, into_s)
            _fire_entry(robot, settings, robot["pose"][X] + dx, robot["pose"][Y] + dy, turret_rad)
        into_s = (robot["due_ps"] - robot["time_ps"]) / PS_PER_S - begin_s


def _fire_due(robot: np.void, settings: np.void) -> None:
    """Fire the sonars that are due now."""
    while robot["due_ps"] <= robot["time_ps"]:
        turret_rad = _turret_direction(robot, robot["angles"][TURRET])
        _fire_entry(robot, settings, robot["pose"][X], robot["pose"][Y], turret_rad)


def _fire_entry(robot: np.void, settings: np.void, x_in: float, y_in: float, turret_rad: float) -> None:
    """Fire the next entry of the order at this pose."""
    entry = robot["fired"] % settings["entries"]
    for at in range(settings["starts"][entry], settings["starts"][entry + 1]):
        _fire(robot, settings, settings["order"][at], x_in, y_in, turret_rad)
    robot["fired"] += 1
    robot["due_ps"] += settings["interval_ps"]


def _skip_entry(robot: np.void, settings: np.void) -> None:
    """Fire the next entry of the order without a ping: only its noise is drawn."""
    if settings["has_sonar_noise"]:
        entry = robot["fired"] % settings["entries"]
        for _ in range(settings["starts"][entry], settings["starts"][entry + 1]):
            standard_normal(robot["streams"][SONAR])
    robot["fired"] += 1
    robot["due_ps"] += settings["interval_ps"]


def _fire(robot: np.void, settings: np.void, sonar_number: int, x_in: float, y_in: float, turret_rad: float) -> None:
    direction_rad = turret_rad + settings["turned_rad"] + settings["sonar_angles_rad"][sonar_number]
    if settings["has_shifts"]:
        x_in, y_in = shifted(x_in, y_in, direction_rad, settings["shifts_in"][sonar_number])
    ping = robot["pings"][sonar_number]
    ping[0], ping[1], ping[2] = x_in, y_in, direction_rad
    ping[3] = standard_normal(robot["streams"][SONAR]) if settings["has_sonar_noise"] else 0.0
    robot["is_pending"][sonar_number] = 1


def _measure(robot: np.void, settings: np.void, walls: FloatArray, ranges: FloatArray) -> None:
    """Compute the readings of the sonars that have fired since the last call; `ranges` (m,) is overwritten."""
    # Columns one by one, once for all rays.
    columns = walls[0], walls[1], walls[2], walls[3]
    begin, end = robot["wall_begin"], robot["wall_end"]
    is_complete = True
    for number in range(settings["sonars"]):
        if robot["is_pending"][number]:
            x_in, y_in, direction_rad, _ = robot["pings"][number]
            range_in = _range_from_axis(x_in, y_in, cos(direction_rad), sin(direction_rad), columns, begin, end, ranges)
            if range_in >= 0.0:
                _read(robot, settings, number, range_in)
            else:
                is_complete = False
    # The others, in a loop of their own: numba counts the references to arrays even where `nearest_wall` is not called.
    if not is_complete:
        for number in range(settings["sonars"]):
            if robot["is_pending"][number]:
                x_in, y_in, direction_rad, _ = robot["pings"][number]
                x1, y1, x2, y2 = columns
                rows = zip(x1[begin:end], y1[begin:end], x2[begin:end], y2[begin:end])  # noqa: B905  for numba
                range_in = nearest_wall(x_in, y_in, cos(direction_rad), sin(direction_rad), rows)[0]
                _read(robot, settings, number, range_in)


def _read(robot: np.void, settings: np.void, sonar_number: int, from_axis_in: float) -> None:
    """Set the reading of a sonar that has fired, from its true range."""
    robot["is_pending"][sonar_number] = 0
    if not settings["is_dead"][sonar_number]:
        range_in = noisy_range(from_axis_in - settings["ring_in"], robot["pings"][sonar_number][3],
                               settings["range_std_relative"], settings["range_std_floor_in"])
        robot["readings_in"][sonar_number] = quantized_range(
            range_in + settings["offsets_in"][sonar_number], settings["min_range_in"], settings["max_range_in"],
            settings["resolution_in"], settings["no_echo_in"],
        )  # fmt: skip


UNDECIDED: Final = -1.0
"""Stands for the range of a ray along a wall, or through an end of one: `nearest_wall` computes it."""


def _range_from_axis(x_in: float, y_in: float, dx: float, dy: float, columns: tuple[FloatArray, ...], begin: int,
                     end: int, ranges: FloatArray) -> float:
    """Return the range of `nearest_wall` among the walls from row `begin` to `end`, or UNDECIDED.

    Parameters
    ----------
    columns
        x1, y1, x2, y2 of m walls.
    ranges
        (m,), overwritten.
    """
    # The range to each wall without a branch: LLVM computes several at a time, and which walls a ray meets cannot be
    # predicted. Rows are unsigned: others may count from the end, and with the test for that it uses no vectors.
    x1, y1, x2, y2 = columns
    for row in range(np.uint64(begin), np.uint64(end)):
        to_x_1, to_y_1, to_x_2, to_y_2 = x1[row] - x_in, y1[row] - y_in, x2[row] - x_in, y2[row] - y_in
        side_1, side_2 = dx * to_y_1 - dy * to_x_1, dx * to_y_2 - dy * to_x_2
        ahead_1, ahead_2 = to_x_1 * dx + to_y_1 * dy, to_x_2 * dx + to_y_2 * dy
        range_in = mean_ahead(ahead_1, side_1, ahead_2, side_2)
        met_in = max(range_in, 0.0) if (side_1 * side_2 <= 0.0) & (range_in >= -ON_WALL_IN) else inf
        ranges[row] = UNDECIDED if min(abs(side_1), abs(side_2)) <= ON_LINE_IN else met_in
    return _smallest(ranges, begin, end)


def _smallest(values: FloatArray, begin: int, end: int) -> float:
    """Return the smallest of the values from row `begin` to `end`; none is NaN."""
    smallest = inf
    for row in range(np.uint64(begin), np.uint64(end)):
        smallest = min(smallest, values[row])
    return smallest


# Compiling.

_SOURCES: Final[tuple[ModuleType, ...]] = (acoustics, axis, collision, drive, odometry, segments, sonar, raycast, rings)
"""Modules whose functions are compiled where the loops call them."""

_CLASSES: Final[tuple[type, ...]] = (ConstantAccelerationSegment, AxisRate, Capsule, Contact, PlacedSegment)
"""Named tuples whose methods are compiled where the loops call them."""


@cache
def load_loops() -> Loops:
    """Return the compiled loops: compiled at the first call of each, or read from numba's cache."""
    # All but `_smallest`, which is compiled with options of its own.
    functions = functions_of(*_SOURCES, sys.modules[__name__])
    make_compilable(function for function in functions if function is not _smallest)
    for kind in _CLASSES:
        for name, method in vars(kind).items():
            if isfunction(method) and not name.startswith("__"):
                extending.overload_method(types.BaseNamedTuple, name)(_of_class(kind, method))
    # Vectors for the minimum, whose result they do not change: nothing is NaN, and zeros of both signs become one.
    extending.register_jitable(fastmath={"nnan", "nsz"})(_smallest)
    extending.overload(math.remainder, strict=False)(_remainder_form)
    # numba's cache watches this file only: the checksum of the others is part of its key, as a variable of the closure.
    return Loops(*map(_compiled, make_loops(checksum(*(module.__file__ for module in _SOURCES)))))


def _compiled(loop: Callable[..., None]) -> Callable[..., None]:
    # Threads run a loop on parts of the array; numba's own parallel loops would compile every function twice. With the
    # test for zero in divisions LLVM would use no vectors.
    compiled: Any = compile_function(loop, is_division_tested=False)
    folder = compiled.stats.cache_path
    if not folder or not any(Path(folder).glob(f"batch_kernel.make_loops*{loop.__name__}*.nbi")):
        log.warning("compiling the batch simulation with numba; the result is cached function=%s", loop.__name__)
    return cast("Callable[..., None]", compiled)


def _of_class(kind: type, method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that gives numba this method for named tuples of this class, and nothing for others."""

    @wraps(method)
    def form(*arguments: Any) -> Callable[..., Any] | None:
        return method if arguments[0].instance_class is kind else None

    return form


def _remainder_form(x: Any, y: Any) -> Callable[[float, float], float]:
    """Return `math.remainder` for numba, which does not have it; by the same steps as CPython."""
    del x, y

    def remainder(x: float, y: float) -> float:
        rest = np.fmod(abs(x), abs(y))
        missing = abs(y) - rest
        if rest > missing:
            rest = -missing
        elif rest == missing:
            rest -= 2.0 * np.fmod(0.5 * (abs(x) - rest), abs(y))
        return float(copysign(1.0, x) * rest)

    return remainder
