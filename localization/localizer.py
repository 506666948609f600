"""The filter live: states of a robot in, estimates out. It sees what the robot's API reports and nothing else.

    state ──> pose history ──┐
    state ──> new echoes ────┴─> for each, at the pose of its firing instant: predict, gate, correct ──> estimate

Rules: odometry from the encoder pose, readings from State's sonars, time from the robot's clock; no truth, no wall
clock, no socket. Each echo counts once; limits (6, 255) are never ranges. The same object runs on every address.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.belief import Belief, Floats
from localization.echoes import Firing, FiringSchedule
from localization.ekf import correct, innovation_squared, predict
from localization.gating import STRICT, Gate, observe
from localization.measurement import WIRE_SONAR, SonarModel, SonarRing, pick, ring, wall_map
from localization.motion import OdometryNoise, step_between
from localization.observation import Refusal
from localization.odometry import EncoderPose, PoseHistory

THESIS_ODOMETRY = OdometryNoise()
"""What the experiments take the encoders to miss."""


class Report(Protocol):
    """What the filter wants of a robot's state; nclient's RobotState has it."""

    @property
    def clock_s(self) -> float | None: ...
    @property
    def x_in(self) -> float: ...
    @property
    def y_in(self) -> float: ...
    @property
    def steering_rad(self) -> float: ...
    @property
    def turret_rad(self) -> float: ...
    @property
    def sonars_in(self) -> tuple[int, ...]: ...


class Echo(NamedTuple):
    """One reading and what became of it: `innovation_in` is reading less expectation, `nis` its square over its
    variance (0 where it was refused)."""

    sonar: int
    instant_s: float
    reading_in: int
    refusal: Refusal
    innovation_in: float
    nis: float = 0.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """Where the robot is believed to be at `clock_s` of its own clock, and the echoes heard since the last one."""

    clock_s: float
    belief: Belief
    echoes: tuple[Echo, ...]

    @property
    def pose(self) -> Floats:
        """x_in, y_in and the heading of the steering in radians, (3,)."""
        return self.belief.mean


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the filter knows beforehand: walls (m, 4) in inches, the robot's ring, and how motion and sonars err."""

    walls: npt.ArrayLike
    body: SonarRing
    odometry: OdometryNoise = THESIS_ODOMETRY
    sonar: SonarModel = WIRE_SONAR
    gate: Gate = STRICT


class Localizer:
    """An extended Kalman filter on one robot. `belief`: where it is thought to stand when the first state comes."""

    def __init__(self, known: Surroundings, belief: Belief, schedule: FiringSchedule) -> None:
        self._known = known
        self._walls = wall_map(known.walls)
        self._belief = belief
        self._schedule = schedule
        self._history = PoseHistory()
        self._settled: EncoderPose | None = None
        self._heard_s = -np.inf

    def update(self, report: Report) -> Estimate:
        """Take in one state and say where the robot is. A state no later than the one before changes nothing.

        Raises ValueError for a state without a clock: nothing was received yet.
        """
        if report.clock_s is None:
            raise ValueError("a state without a clock: ask the robot for one (refresh) before localizing")
        now = EncoderPose(report.clock_s, np.array([report.x_in, report.y_in, report.steering_rad]), report.turret_rad)
        if self._settled is None:
            self._settled = now
            self._heard_s = now.clock_s
            self._history.add(now)
        elif now.clock_s > self._history.latest.clock_s:
            self._history.add(now)
        latest = self._history.latest
        firings = self._schedule.readable(self._heard_s, latest.clock_s)
        echoes = tuple(self._hear(firing, report.sonars_in[firing.sonar]) for firing in firings)
        step = step_between(self._settled.pose, latest.pose)
        return Estimate(latest.clock_s, predict(self._belief, step, self._known.odometry), echoes)

    def _hear(self, firing: Firing, reading_in: int) -> Echo:
        self._settle(self._history.at(firing.instant_s))
        assert self._settled is not None
        self._heard_s = firing.instant_s
        beam = pick(ring(self._known.body, self._settled.turret_offset_rad), firing.sonar)
        reading = np.array([float(reading_in)])
        seen = observe(self._belief, beam, reading, self._walls, self._known.sonar, self._known.gate)
        nis = 0.0
        if seen.used[0]:
            before, self._belief = self._belief, correct(self._belief, seen)
            nis = float(innovation_squared(before, self._belief, seen))
        return Echo(*firing, reading_in, seen.reasons()[0], float(seen.innovation[0]), nis)

    def _settle(self, there: EncoderPose) -> None:
        """Move the belief to where the encoders were at that instant."""
        assert self._settled is not None
        step = step_between(self._settled.pose, there.pose)
        self._belief = predict(self._belief, step, self._known.odometry)
        self._settled = there
