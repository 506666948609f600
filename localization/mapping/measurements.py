"""Measurements of a drive: encoder poses and sonar readings, grouped into the nodes of a trajectory.

    recording --> DriveLog --> Trajectory
                  states       nodes, odometry between them, echoes relative to their node

A node stands for the readings of half a second. Between two nodes the odometry is integrated once, with its covariance
and its derivative by the calibration parameters, so that the estimator needs no encoder reading again.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import radians
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, POSE, Floats, relative_pose, rotate, wrap_angle
from localization.filters.odometry import (
    MAX_STATE,
    OdometryNoise,
    move,
    process_covariance,
    process_variance,
    step_between,
    step_jacobians,
)
from localization.filters.sonar_cone import ConeSonar
from localization.live.sensor_input import FiringSchedule, FiringTime, LogRow, new_echoes
from nclient.errors import LogFileError, RecordingError
from nclient.protocol.types import get_model
from nclient.recording.format import IN, OUT, Recording, read_recording
from nclient.state import RobotState
from worlds.robots import BODIES, Body

Indices = npt.NDArray[np.intp]

READINGS_PER_NODE: Final = 8
"""Readings of one node: half a turn of the ring, 0.5 s, in which a robot rolls 2.5 in."""
NODE_S: Final = 0.5
"""Duration of a node in the log of any robot: its sonars may measure more often than those of a Nomad."""
RESUME_PAUSE_S: Final = 1.0
"""Between the end of a drive and its continuation: whatever it was, the robot stood."""
ROWS_PER_S: Final = 30
"""States of the last second, at least: a control loop has two in 0.1 s."""
STANDING_IN, STANDING_RAD = 0.05, 0.005
"""A robot that moves less than this between two nodes stands: its readings repeat themselves and are left out."""
QUANTIZATION_STD: Final = (0.04, 0.04, 0.001)
"""Standard deviation of an odometry step by the encoders' resolution, 0.1 in and 0.1 deg: in, in, rad."""
SAME_AXIS_RAD: Final = radians(6.0)
"""Sonars of two rounds are compared if their axes differ by less: half of what is left of a cone's half angle."""
DISPLACEMENTS_IN: Final[Floats] = np.arange(-24.0, 24.5)
"""Displacements that are tested along x and along y: farther away little is the same."""
STANDING_VAR_IN2: Final = 1.0
"""Variance of the difference of two readings besides their noise: a robot rolls on while it brakes."""
MAX_DIFFERENCE: Final = 3.0
"""A larger difference of two readings, in standard deviations, is a bad reading or another place."""
COMPARED_ROUNDS: Final = 2
"""Two of each, so that one bad reading of a sonar is not the only one."""
MIN_COMPARED: Final = 4
"""With fewer sonars that are compared nothing is decided."""
MIN_AGREEING: Final = 0.3
"""Fraction of them that must agree: if a fifth of all readings is bad, four in five do; at another place few."""
MAX_SAVED: Final = 14.0
"""Sum of squared standard deviations that a displacement may explain: less than two readings."""


@dataclass(frozen=True, slots=True)
class DriveLog:
    """Encoder poses and sonar readings of a drive.

    Attributes
    ----------
    encoders
        (t, 5) rows of clock, x, y, heading, turret; seconds, inches, radians; increasing clock.
    instants_s, sonars, readings_in
        (e,) each: when which sonar fired, and its reading, in order of time.
    angles_rad
        (s,) direction of each sonar from the turret's.
    ring_radius_in
        Distance of the sonars from the robot's axis.
    model
        Name of the robot model.
    is_omnidirectional
        True if the robot moves sideways as well as ahead, as a drone does; else steps are along the heading.
    readings_per_node
        Number of readings of half a second.
    """

    encoders: Floats
    instants_s: Floats
    sonars: Indices
    readings_in: Floats
    angles_rad: Floats
    ring_radius_in: float
    model: str = "n150"
    is_omnidirectional: bool = False
    readings_per_node: int = READINGS_PER_NODE

    def poses_at(self, instants_s: Floats) -> Floats:
        """Return encoder poses and turret angles (e, 4) at instants (e,), by linear interpolation."""
        clock = self.encoders[:, 0]
        angles = np.unwrap(self.encoders[:, 3:], axis=0)
        columns = [self.encoders[:, 1], self.encoders[:, 2], angles[:, 0], angles[:, 1]]
        return np.stack([np.interp(instants_s, clock, column) for column in columns], axis=-1)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Nodes of a drive, odometry between them, and echoes.

    Attributes
    ----------
    instants_s
        (n,) instant of each node.
    odometry
        (n, 3) encoder poses of the nodes.
    steps
        (n - 1, 3) pose of each next node in the frame of the node before, by the encoders.
    step_info
        (n - 1, 3, 3) upper triangular root W of the information of a step: W' W is the inverse covariance.
    step_by_parameters
        (n - 1, 3, 3) derivative of a step by distance scale, turn scale and drift.
    group
        (n,) number of the group of readings (`DriveLog.readings_per_node`) that each node stands for.
    node, sonar
        (e,) node and sonar of each echo.
    mounts
        (e, 2) position of the sonar in the frame of its node, inches.
    axes_rad
        (e,) direction of the sonar from the node's heading.
    readings_in
        (e,) readings.
    std_in
        (e,) standard deviation of a reading.
    weight
        (e,) how much a reading counts, 1 or less if it repeats the error of others (`repeats.py`).
    noise_var_in2, other_var_in2, heading_var_in2
        (e,) parts of the variance: of the sonar's noise before rounding, of rounding and of the surface, and of the
        heading of a ray that meets its wall at 45 degrees, 0 for cones.
    step_in
        Step to which readings are rounded.
    readings
        Number of all readings, with those without an echo.
    is_too_near
        (n,) True for nodes at which a sonar has measured its lower limit: something may be nearer.
    """

    instants_s: Floats
    odometry: Floats
    steps: Floats
    step_info: Floats
    step_by_parameters: Floats
    group: Indices
    node: Indices
    sonar: Indices
    mounts: Floats
    axes_rad: Floats
    readings_in: Floats
    std_in: Floats
    weight: Floats
    noise_var_in2: Floats
    other_var_in2: Floats
    heading_var_in2: Floats
    step_in: float
    readings: int
    is_too_near: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.instants_s)

    def part(self, first: int, last: int) -> Trajectory:
        """Return the nodes from one up to another one, which is left out."""
        nodes, between = slice(first, last), slice(first, max(last - 1, first))
        echoes = slice(*np.searchsorted(self.node, (first, last)).tolist())
        return replace(
            self, instants_s=self.instants_s[nodes], odometry=self.odometry[nodes], steps=self.steps[between],
            step_info=self.step_info[between], step_by_parameters=self.step_by_parameters[between],
            group=self.group[nodes], node=self.node[echoes] - first, sonar=self.sonar[echoes],
            mounts=self.mounts[echoes], axes_rad=self.axes_rad[echoes], readings_in=self.readings_in[echoes],
            std_in=self.std_in[echoes], weight=self.weight[echoes], noise_var_in2=self.noise_var_in2[echoes],
            other_var_in2=self.other_var_in2[echoes], heading_var_in2=self.heading_var_in2[echoes],
            is_too_near=self.is_too_near[nodes],
        )  # fmt: skip


class DriveCollector:
    """Collects states of a robot into a DriveLog: `restart` when the ring is restarted, then `add` for each state.

    Parameters
    ----------
    model
        Name of the robot model.
    before
        The drive so far of a robot that goes on from where it stood at its end.
    """

    def __init__(self, model: str, before: DriveLog | None = None) -> None:
        self.model = model
        self._schedule: FiringSchedule | None = None
        self._rows: list[tuple[float, float, float, float, float]] = []
        self._firings: list[tuple[float, int, float]] = []
        self._last_s = -np.inf
        self._shift_s, self._moved = 0.0, (0.0, 0.0, 0.0)
        if before is not None:
            self._rows = [(row[0], row[1], row[2], row[3], row[4]) for row in before.encoders.tolist()]
            self._firings = list(
                zip(before.instants_s.tolist(), before.sonars.tolist(), before.readings_in.tolist(), strict=True)
            )

    def __len__(self) -> int:
        """Return the number of readings."""
        return len(self._firings)

    @property
    def has_drive(self) -> bool:
        """True once there are readings and states to interpolate between."""
        return len(self._rows) > 1 and bool(self._firings)

    def restart(self, state: RobotState, schedule: FiringSchedule) -> None:
        """Begin with the state that answers the restart of the ring; what came before on this connection is dropped."""
        assert state.clock_s is not None
        self._schedule, self._last_s = schedule, state.clock_s
        pose = (state.x_in, state.y_in, state.steering_rad)
        if self._rows:
            # The robot stands where it stood: the encoders and the clock go on from their last values.
            last = self._rows[-1]
            turn = last[3] - pose[2]
            c, s = np.cos(turn), np.sin(turn)
            self._moved = last[1] - (c * pose[0] - s * pose[1]), last[2] - (s * pose[0] + c * pose[1]), turn
            self._shift_s = last[0] + RESUME_PAUSE_S - state.clock_s
        self._rows.append(self._row(state))

    def add(self, state: RobotState) -> list[FiringTime]:
        """Take a state into account and return the readings that it shows for the first time; none for an old state."""
        if self._schedule is None or state.clock_s is None or state.clock_s + self._shift_s <= self._rows[-1][0]:
            return []
        self._rows.append(self._row(state))
        firings = self._schedule.readable(self._last_s, state.clock_s)
        for sonar, instant_s in firings:
            self._firings.append((instant_s + self._shift_s, sonar, float(state.sonars_in[sonar])))
            self._last_s = instant_s
        return firings

    def _row(self, state: RobotState) -> tuple[float, float, float, float, float]:
        x, y, turn = self._moved
        if self._moved == (0.0, 0.0, 0.0):
            return (state.clock_s or 0.0) + self._shift_s, state.x_in, state.y_in, state.steering_rad, state.turret_rad
        c, s = np.cos(turn), np.sin(turn)
        return (
            (state.clock_s or 0.0) + self._shift_s,
            float(x + c * state.x_in - s * state.y_in), float(y + s * state.x_in + c * state.y_in),
            state.steering_rad + turn, state.turret_rad + turn,
        )  # fmt: skip

    def encoders_at(self, instant_s: float) -> Floats:
        """Return the encoder pose and the turret angle (4,) at an instant of the last second, of the drive's clock."""
        rows = np.array(self._rows[-ROWS_PER_S:])
        angles = np.unwrap(rows[:, 3:], axis=0)
        return np.array([np.interp(instant_s, rows[:, 0], c) for c in (rows[:, 1], rows[:, 2], *angles.T)])

    @property
    def shift_s(self) -> float:
        """Seconds from the robot's clock to that of the drive."""
        return self._shift_s

    def log(self, first_reading: int = 0) -> DriveLog:
        """Return the drive, from one of its readings on."""
        firings = self._firings[first_reading:]
        instants, sonars, readings = zip(*firings, strict=True)
        # A state before the first reading, to interpolate.
        first = bisect_left(self._rows, instants[0], key=lambda row: row[0]) if first_reading else 1
        body = BODIES[self.model]
        return DriveLog(
            np.array(self._rows[max(first - 1, 0) :], dtype=np.float64), np.array(instants),
            np.array(sonars, dtype=np.intp), np.array(readings), np.asarray(body.sonar_angles_rad),
            body.sonar_ring_radius_in, self.model,
        )  # fmt: skip


def read_drive(*paths: Path) -> DriveLog:
    """Return the drive of a recording of the client or of the emulator (`record=FILE`, `nserver --record FILE`).

    Of several recordings each goes on where the one before ended.

    Raises
    ------
    RecordingError
        A file that is no recording, or one from which it does not follow when the sonars fired.
    """
    log = None
    for path in paths:
        recording = read_recording(path)
        drives = (_drive_of(recording, connection, log) for connection in recording.connections())
        found = next((drive for drive in drives if drive is not None), None)
        if found is None:
            raise RecordingError(
                f"{path}: no connection restarts the sonars (conf_sn) and reads states after it, so it is unknown when "
                "they fired; record a drive of `nomad localize`, `nomad shell` after `conf_sn`, or any program that "
                "configures them"
            )
        log = found
    assert log is not None
    return log


def drive_of_rows(
    rows: Sequence[LogRow], body: Body, *, is_omnidirectional: bool = False, delay_s: float = 0.0
) -> DriveLog:
    """Return the drive of a log that has the last reading of each sonar, and not when it fired.

    A reading is taken `delay_s` before the instant of the row in which it is new (`new_echoes`); see DriveLog for
    `is_omnidirectional`.

    Raises
    ------
    LogFileError
        If the log has no new reading, or the sonars do not stand on a circle about the robot's axis.
    """
    ring = body.ring
    if ring.shifts_in:
        raise LogFileError(f"model {body.name!r} has mounts_in: sonars must stand on a circle about the robot's axis")
    clocks = [row.clock_s for row in rows]
    new = new_echoes([row.sonars_in for row in rows], clocks, ring.round_s)
    firings = [
        (clock_s - delay_s, sonar, row.sonars_in[sonar])
        for clock_s, row, sonars in zip(clocks, rows, new, strict=True) for sonar in sonars
        if clock_s - delay_s >= clocks[0]
    ]  # fmt: skip
    if len(firings) < READINGS_PER_NODE:
        raise LogFileError(f"the log has {len(firings)} new readings, a map needs hundreds")
    instants, sonars, readings = (np.array(column) for column in zip(*firings, strict=True))
    encoders = np.array([(row.clock_s, *row.odometry, row.turret_rad) for row in rows])
    encoders[:, 3:] = np.unwrap(encoders[:, 3:], axis=0)
    # Times 1, 2 ...: the node of a ring that is as fast as a Nomad's has as many readings.
    halves = round(NODE_S * len(firings) / max(clocks[-1] - clocks[0], NODE_S) / READINGS_PER_NODE)
    return DriveLog(
        encoders, instants, sonars, readings, np.array(ring.angles_rad), ring.radius_in, body.name, is_omnidirectional,
        READINGS_PER_NODE * max(halves, 1),
    )  # fmt: skip


def _drive_of(recording: Recording, connection: str, before: DriveLog | None) -> DriveLog | None:
    """Return the drive on one connection; None without a restart of the ring and states after it."""
    model = get_model(next((e.more["model"] for e in recording.entries if "model" in e.more), "n150"))
    collector = DriveCollector(model.name, before)
    restart: tuple[int, tuple[int, ...]] | None = None
    readings = len(collector)
    # States and restarts of the ring, in order. The reply to conf_sn has the clock of the restart.
    for kind, frame in _frames(recording, connection):
        if kind == OUT and frame.get("call") == "conf_sn":
            rate, *order = frame["args"]
            restart = int(rate), tuple(int(sonar) for sonar in order if int(sonar) < len(model_angles(model.name)))
        if kind != IN or frame.get("reply") != "state" or frame.get("clock") is None:
            continue
        state = RobotState(model, tuple(frame["State"]), clock_ms=int(frame["clock"]))
        if restart is not None:
            collector = DriveCollector(model.name, before)
            assert state.clock_s is not None
            collector.restart(state, FiringSchedule.of_command(state.clock_s, *restart))
            restart = None
            continue
        collector.add(state)
    return collector.log() if len(collector) > readings and collector.has_drive else None


def model_angles(name: str) -> Sequence[float]:
    """Return the directions of the sonars of a robot model."""
    angles: Sequence[float] = BODIES[name].sonar_angles_rad
    return angles


# Continuing a drive.


class RoundComparison(NamedTuple):
    """Comparison of the last rounds of a drive with the first ones after it.

    Attributes
    ----------
    compared
        Number of sonars with echoes in both, or in all rounds of one and none of the other; also those with echoes in
        a direction in which no sonar measured before.
    agreeing
        Number of those whose readings agree.
    saved
        Sum of squared differences, in standard deviations and bounded, that the best displacement explains.
    displacement_in
        This displacement, x ahead and y to the left of the robot.
    """

    compared: int
    agreeing: int
    saved: float
    displacement_in: tuple[float, float]

    @property
    def has_moved(self) -> bool:
        """True if the readings contradict a robot that still stands where the drive ended."""
        if self.compared < MIN_COMPARED:
            return False
        return self.agreeing < MIN_AGREEING * self.compared or self.saved > MAX_SAVED


def compare_rounds(before: DriveLog, after: DriveLog, sonar: ConeSonar) -> RoundComparison:
    """Compare the last rounds of a drive with the first ones of another, of a robot that stood between them.

    Each reading is corrected by the encoders' motion between its instant and the end, or the beginning, as of a wall
    across the axis of the sonar. A displacement d changes the range of a sonar of axis u by -u . d. The squares of the
    differences are bounded, so bad readings agree on no displacement.

    Parameters
    ----------
    before, after
        The drives.
    sonar
        Noise and limits of the readings.
    """
    # 1. Axes and ranges at the end of the one and at the beginning of the other.
    count = COMPARED_ROUNDS * len(before.angles_rad)
    axes, ranges = _ranges_at(before, slice(-count, None), before.encoders[-1, 1:4], sonar)
    new_axes, new_ranges = _ranges_at(after, slice(None, count), after.encoders[0, 1:4], sonar)
    sonars = after.sonars[:count]
    # 2. For each sonar the cost of each displacement, by the two readings that fit it best. The first one is none.
    x, y = (grid.ravel() for grid in np.meshgrid(DISPLACEMENTS_IN, DISPLACEMENTS_IN, indexing="ij"))
    displacements = np.concatenate((np.zeros((1, 2)), np.stack((x, y), axis=-1)))
    costs: list[Floats] = []
    for number in np.unique(sonars):
        own = np.flatnonzero(sonars == number)
        new, old = np.nonzero(np.abs(wrap_angle(new_axes[own, None] - axes)) < SAME_AXIS_RAD)
        z, z_before, axis = new_ranges[own[new]], ranges[old], new_axes[own[new]]
        has_both = np.isfinite(z) & np.isfinite(z_before)
        if has_both.any():
            z, z_before, axis = z[has_both], z_before[has_both], axis[has_both]
            u = np.stack((np.cos(axis), np.sin(axis)), axis=-1)
            variance = sonar.variance(z) + sonar.variance(z_before) + STANDING_VAR_IN2
            costs.append((np.square(z - z_before + displacements @ u.T) / variance).min(axis=1))
        elif np.isfinite(new_ranges[own]).all() or (len(new) and np.isfinite(z_before).all()):
            # Echoes in all rounds of one drive, and in none of the other, or where no sonar was directed then, since
            # the turret stands otherwise: another place.
            costs.append(np.full(len(displacements), np.inf))
    if not costs:
        return RoundComparison(0, 0, 0.0, (0.0, 0.0))
    # 3. None, and the best one.
    bounded = np.minimum(costs, MAX_DIFFERENCE**2)
    cost = bounded.sum(axis=0)
    best = int(cost.argmin())
    agreeing = int((bounded[:, 0] < MAX_DIFFERENCE**2).sum())
    at = displacements[best].tolist()
    return RoundComparison(len(costs), agreeing, float(cost[0] - cost[best]), (at[0], at[1]))


def _ranges_at(log: DriveLog, part: slice, pose: Floats, sonar: ConeSonar) -> tuple[Floats, Floats]:
    """Return axes in the frame of a pose (3,) and ranges at it of a part of the readings; NaN for one at a limit."""
    readings, there = log.readings_in[part], log.poses_at(log.instants_s[part])
    axes = there[:, 3] + log.angles_rad[log.sonars[part]]
    u = np.stack((np.cos(axes), np.sin(axes)), axis=-1)
    moved = ((pose[:2] - there[:, :2]) * u).sum(axis=1)
    is_echo = (readings > sonar.lowest_in) & (readings < sonar.highest_in)
    return axes - pose[HEADING], np.where(is_echo, readings - moved, np.nan)


def _frames(recording: Recording, connection: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the decoded frames of one connection, each with its direction."""
    for entry in recording.entries:
        if entry.connection == connection and entry.kind in (IN, OUT):
            for frame in entry.decoded:
                yield entry.kind, dict(frame)


Step = tuple[Floats, Floats, Floats]
"""Odometry between two instants: step (3,), covariance (3, 3), derivative by the parameters (3, 3)."""
Steps = dict[tuple[float, float], Step]


def build_trajectory(
    log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, roughness_in: float, integrated: Steps | None = None,
    *, rays: bool = False,
) -> Trajectory:  # fmt: skip
    """Return the nodes of a drive with all that the estimator needs.

    Parameters
    ----------
    log
        The drive.
    noise
        Random errors of the odometry.
    sonar
        Noise and limits of the readings.
    roughness_in
        Standard deviation of the walls' surfaces from straight lines, inches.
    integrated
        Odometry by its instants that was integrated before, of the same drive; what is new is added.
    rays
        True if sonars measure along exact rays: their ranges are as uncertain as the heading at their instant.
    """
    # 1. Groups of readings; those in which the robot does not move are left out.
    count, size = len(log.readings_in) // log.readings_per_node, log.readings_per_node
    groups = np.arange(count * size).reshape(count, size)
    instants = log.instants_s[groups].mean(axis=1)
    moving = _moving(log.poses_at(instants))
    groups, instants = groups[moving], instants[moving]
    nodes = log.poses_at(instants)
    # 2. Odometry between the nodes.
    integrated = {} if integrated is None else integrated
    intervals = list(pairwise(instants.tolist()))
    new = np.array([interval for interval in intervals if interval not in integrated]).reshape(-1, 2)
    found = zip(*integrate_odometry(log, new, noise), strict=True)
    integrated.update(zip(map(tuple, new.tolist()), found, strict=True))
    steps, covariance, by_parameters = (
        np.array([integrated[interval][part] for interval in intervals]).reshape(-1, *shape)
        for part, shape in enumerate(((POSE,), (POSE, POSE), (POSE, MAX_STATE - POSE)))
    )
    root = np.linalg.cholesky(np.linalg.inv(covariance)).swapaxes(-1, -2)
    # 3. Sonars relative to their nodes: mount and axis in the node's frame.
    firing = groups.reshape(-1)
    node = np.repeat(np.arange(len(groups)), size)
    poses = log.poses_at(log.instants_s[firing])
    sonars = log.sonars[firing]
    heading = nodes[node, HEADING]
    axes = poses[:, 3] - heading + log.angles_rad[sonars]
    offset = rotate(poses[:, :2] - nodes[node, :2], -heading)
    mounts = offset + log.ring_radius_in * np.stack((np.cos(axes), np.sin(axes)), axis=-1)
    # 4. Readings at a limit are no ranges.
    readings = log.readings_in[firing]
    is_range = (readings > sonar.lowest_in) & (readings < sonar.highest_in)
    # The variance of a map's place is left out: here walls are estimated.
    noise_var = sonar.variance(readings) - sonar.place_var_in2 - sonar.rounding_var_in2
    other = np.full(len(readings), sonar.rounding_var_in2 + roughness_in**2)
    # The heading wanders while the robot turns, between the node and the reading. A ray r that meets a wall at an
    # angle a off its normal changes by r tan(a) a radian; a is taken for 45 degrees.
    slanted = np.zeros(len(readings))
    if rays:
        turn = np.abs(wrap_angle(poses[:, HEADING] - heading))
        slanted = process_variance(np.hypot(offset[:, 0], offset[:, 1]), turn, noise)[1] * np.square(readings)
    std = np.sqrt(noise_var + other + slanted)
    return Trajectory(
        instants, nodes[:, :POSE], steps, root, by_parameters, np.flatnonzero(moving), node[is_range], sonars[is_range],
        mounts[is_range], axes[is_range], readings[is_range], std[is_range], np.ones(int(is_range.sum())),
        noise_var[is_range], other[is_range], slanted[is_range], (12.0 * sonar.rounding_var_in2) ** 0.5, len(readings),
        np.asarray((log.readings_in[groups] <= sonar.lowest_in).any(axis=1), dtype=np.bool_),
    )  # fmt: skip


def _moving(poses: Floats) -> npt.NDArray[np.bool_]:
    """Return True (n,) for nodes at which the robot or its turret has moved since the last such node, and the first."""
    moving = np.zeros(len(poses), dtype=np.bool_)
    last = None
    for number, pose in enumerate(poses):
        if last is None or number == len(poses) - 1:
            moving[number], last = True, pose
            continue
        change = np.abs(pose - last)
        moving[number] = np.hypot(change[0], change[1]) > STANDING_IN or change[2:].max() > STANDING_RAD
        last = pose if moving[number] else last
    return moving


def integrate_odometry(log: DriveLog, intervals_s: Floats, noise: OdometryNoise) -> tuple[Floats, Floats, Floats]:
    """Return the odometry in intervals (n, 2): steps (n, 3), covariances and derivatives by the parameters.

    References
    ----------
    Forster, Carlone, Dellaert, Scaramuzza, On-Manifold Preintegration for Real-Time Visual-Inertial Odometry (2017),
    here with the odometry of Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 5.4, in place of an IMU.
    """
    # 1. The encoder poses between each two instants, with both: rows padded with the last one, a step of nothing.
    clock = log.encoders[:, 0]
    begin, end = intervals_s[:, :1], intervals_s[:, 1:]
    first, stop = np.searchsorted(clock, begin[:, 0], "right"), np.searchsorted(clock, end[:, 0], "left")
    longest = int((stop - first).max(initial=0))
    inner = first[:, None] + np.arange(longest)
    times = np.where(inner < stop[:, None], clock[np.minimum(inner, len(clock) - 1)], end)
    times = np.concatenate((begin, times, end), axis=1)
    poses = log.poses_at(times.reshape(-1))[:, :POSE].reshape(*times.shape, POSE)
    # 2. All intervals at once, one part after the other: mean, covariance and derivative by the parameters.
    states = np.zeros((len(times), MAX_STATE))
    covariance = np.zeros((len(times), POSE, POSE))
    by_parameters = np.zeros((len(times), POSE, MAX_STATE - POSE))
    for part in range(times.shape[1] - 1):
        if log.is_omnidirectional:
            states, F, Q = _free_step(states, relative_pose(poses[:, part], poses[:, part + 1]), noise)
        else:
            step = step_between(poses[:, part], poses[:, part + 1])
            F, G = step_jacobians(states, step)
            states, Q = move(states, step), process_covariance(G, step, noise)
        pose_F = F[:, :POSE, :POSE]
        covariance = pose_F @ covariance @ pose_F.swapaxes(-1, -2) + Q
        by_parameters = pose_F @ by_parameters + F[:, :POSE, POSE:]
    covariance[:, range(POSE), range(POSE)] += np.square(QUANTIZATION_STD)
    return states[:, :POSE], covariance, by_parameters


def _free_step(states: Floats, steps: Floats, noise: OdometryNoise) -> tuple[Floats, Floats, Floats]:
    """Return states (n, 6) after steps (n, 3) in any direction, F (n, 6, 6) and the covariance (n, 3, 3) of the step.

    The random error of the position is the same along and across the step, since both are measured alike.
    """
    # 1. The mean: both components scaled, and the turn with the drift.
    distance = np.hypot(steps[:, 0], steps[:, 1])
    local = steps[:, :2] * (1.0 + states[:, POSE, None])
    turn = steps[:, 2] * (1.0 + states[:, POSE + 1]) + states[:, POSE + 2] * distance
    moved = rotate(local, states[:, HEADING])
    after = states.copy()
    after[:, :2] += moved
    after[:, HEADING] = wrap_angle(after[:, HEADING] + turn)
    # 2. Derivatives by the pose and the parameters.
    F = np.tile(np.eye(MAX_STATE), (len(states), 1, 1))
    F[:, 0, HEADING], F[:, 1, HEADING] = -moved[:, 1], moved[:, 0]
    F[:, :2, POSE] = rotate(steps[:, :2], states[:, HEADING])
    F[:, HEADING, POSE + 1], F[:, HEADING, POSE + 2] = steps[:, 2], distance
    # 3. The covariance, which no rotation changes.
    var_distance, var_turn = process_variance(distance, steps[:, 2], noise)
    Q = np.zeros((len(states), POSE, POSE))
    Q[:, 0, 0] = Q[:, 1, 1] = var_distance
    Q[:, HEADING, HEADING] = var_turn
    return after, F, Q
