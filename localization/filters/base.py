"""The interface of a filter, and what every filter is configured with.

    predict(distance, turn)          the encoders reported a step      predicted(distance, turn)    the same, not taken
    update(sonar, turret, reading)   an echo, at this instant          belief, health               the estimate
    process, advance                 all echoes of a ring, of a state  places, smoothed             what some report

Filters are made by name (registry.make). Echoes come in order of time, each after the prediction to its instant.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Belief
from localization.filters.health import FilterHealth
from localization.filters.odometry import NO_LAG, Lag, OdometryNoise, clock_lag, pose_at, relative_step
from localization.filters.sonar_cone import ConeModel, ConeSonar, cone_sonar
from localization.filters.sonar_ray import STRICT, WIRE_SONAR, Gate, RayModel, RaySonar, ray_sonar
from localization.filters.update import MeasurementModel, Outcome, UpdateResult
from worlds.geometry import lengths
from worlds.rings import Ring
from worlds.robots import IDEAL_CALIBRATION, Body, Calibration
from worlds.world import SurfaceSpot, World

THESIS_ODOMETRY: Final = OdometryNoise()
"""Noise of the encoders in the experiments."""
RANGE_STDS: Final = (0.35, 0.01)
"""Transducers seldom lie an inch behind or before the ring; 1 % is 6 degrees Celsius."""


EncoderRow = tuple[float, float, float, float, float]
"""The encoders at an instant: clock_s, x_in, y_in, heading_rad, turret_rad."""
NewEcho = tuple[float, int, float]
"""An echo: the instant, the sonar, and its reading in inches."""
Advance = tuple[Sequence[Outcome], EncoderRow, Belief]
"""The outcome of each echo, the encoders at the last one, and the belief predicted from there, as it is reported."""


class Place(NamedTuple):
    """A pose at which the robot may be, and its probability."""

    belief: Belief
    probability: float


class Filter(ABC):
    """An estimate of a robot's state.

    Attributes
    ----------
    detects_slips
        False while the clock is so uneven that its errors look like slips of the wheels.
    """

    detects_slips = True

    @property
    @abstractmethod
    def belief(self) -> Belief:
        """Mean (n,) and covariance (n, n), n >= 3: a pose, then parameters."""

    @property
    @abstractmethod
    def health(self) -> FilterHealth:
        """Status of the estimate."""

    @abstractmethod
    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the belief after a step that the encoders report, inches and radians."""

    @abstractmethod
    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by a lag."""

    @abstractmethod
    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the belief by a reading of sonar number `sonar`, the turret turned by so much against the heading."""

    def process(self, encoders: EncoderRow, poses: Sequence[EncoderRow],
                echoes: Sequence[NewEcho]) -> Sequence[Outcome]:
        """Predict to the instant of each echo, and update. `filter_loop.filter_ring` does so in one function.

        Parameters
        ----------
        encoders
            The encoders at the instant to which the filter has predicted.
        poses
            The polled encoders, from the last before the first echo.
        echoes
            In order of time.
        """
        results = []
        _, x, y, heading, _ = encoders
        for instant_s, sonar, reading_in in echoes:
            # 1. The step of the encoders to their pose at the instant of the echo.
            to_x, to_y, to_heading, turret = pose_at(poses, instant_s)
            distance_in, turn_rad = relative_step(x, y, heading, to_x, to_y, to_heading)
            x, y, heading = to_x, to_y, to_heading
            # 2. Predict, and correct by the reading.
            self.predict(distance_in, turn_rad)
            results.append(self.update_at(instant_s, sonar, turret - to_heading, reading_in))
        return results

    def update_at(self, instant_s: float, sonar: int, turret_offset_rad: float, reading_in: float) -> Outcome:  # noqa: ARG002
        """Correct the belief by a reading of this instant; only a filter of a user takes note of the time."""
        return self.update(sonar, turret_offset_rad, reading_in)

    def advance(self, encoders: EncoderRow, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho],
                clock_std_s: float) -> Advance:
        """Take a whole state of the robot: `process` its echoes; return the belief that is predicted for the last pose.

        Parameters
        ----------
        encoders, poses, echoes
            As in `process`; there may be no echo.
        clock_std_s
            Uncertainty of the instants of echoes and states (`odometry.clock_lag`).
        """
        outcomes: Sequence[Outcome] = ()
        if echoes:
            outcomes, last_s = self.process(encoders, poses, echoes), echoes[-1][0]
            encoders = (last_s, *pose_at(poses, last_s))
        step = relative_step(*encoders[1:4], *poses[-1][1:4])
        lag = clock_lag(poses[max(len(poses) - 2, 0)], poses[-1], clock_std_s)
        return outcomes, encoders, self.predicted(*step, lag)

    def roll_on_spot(self, distance_in: float) -> None:  # noqa: B027  most filters do without
        """Widen the belief by the noise of wheels that roll so far while something holds the robot."""

    # Of a filter that may consider several poses at once.

    @property
    def places(self) -> tuple[Place, ...]:
        """The poses, the most probable first; none while searching."""
        return ()

    @property
    def informative_turn_rad(self) -> float | None:
        """Turn from the present heading to the direction in which the poses differ soonest; None without any."""
        return None

    # Of a filter that also estimates a past state from all readings since.

    lag = 0
    """Number of predictions that it looks back."""

    def smoothed(self) -> Belief | None:
        """Return the belief over the state `lag` predictions ago (the first, where there were fewer)."""
        return None


@dataclass(frozen=True, slots=True)
class LocalizationConfig:
    """Map, robot, sensor and noise models of a filter.

    Attributes
    ----------
    walls
        (m, 4) segments, rows x1 y1 x2 y2 in inches.
    body
        The robot's ring of sonars.
    odometry
        Noise of the encoders.
    sonar
        Noise of the sonars; its type decides the measurement model.
    gate
        Conditions for a beam to be used, for rays only.
    clearance_in
        No wall is nearer to the robot's axis than this: its radius, or slightly less.
    calibration
        Systematic errors of this robot: its sonars are corrected by them; its wheels are part of the belief.
    surfaces
        Measured surfaces of walls by their rows, for Kalman filters with sonars in a building (`surface.py`).
    range_stds
        Standard deviations of the errors that all readings have in common, before the first echo: of their offset,
        inches, and of their scale (`update.RANGE_PARAMETERS`). Kalman filters estimate them. None: there are none.
    """

    walls: npt.ArrayLike
    body: Body
    odometry: OdometryNoise = THESIS_ODOMETRY
    sonar: RaySonar | ConeSonar = WIRE_SONAR
    gate: Gate = STRICT
    clearance_in: float = 9.0
    calibration: Calibration = IDEAL_CALIBRATION
    range_stds: tuple[float, float] | None = RANGE_STDS
    surfaces: Mapping[int, tuple[SurfaceSpot, ...]] = field(default_factory=dict)

    @classmethod
    def in_world(cls, world: World, body: Body, odometry: OdometryNoise, sonar: RaySonar | ConeSonar,
                 calibration: Calibration = IDEAL_CALIBRATION) -> LocalizationConfig:  # fmt: skip
        """Return the configuration for a map, with the accuracy and the surfaces of the walls that were measured."""
        first = len(world.fixed_walls) - len(world.inner_walls)
        surfaces = {first + row: accuracy.surface for row, accuracy in world.accuracies.items() if accuracy.surface}
        sonar = with_wall_errors(sonar, world)
        return cls(world.walls, body, odometry, sonar, calibration=calibration, surfaces=surfaces)


def sonar_of(ring: Ring, *, rays: bool) -> RaySonar | ConeSonar:
    """Return the noise model of a ring, for exact rays or for the cones of a real one."""
    return ray_sonar(ring) if rays else cone_sonar(ring)


def with_wall_errors(sonar: RaySonar | ConeSonar, world: World) -> RaySonar | ConeSonar:
    """Return the noise of sonars in a map whose walls were measured: its mean variance repeats itself in readings.

    To `place_var_in2` is added the mean of offset_std_in^2 over the length of all walls; those that state no accuracy
    are exact.

    All echoes of a wall repeat its error, from wherever they are measured. The filter counts as correlated only those
    of one sonar from one pose (`update.count_used`): along a wall the belief can become more certain than it.
    """
    if not world.accuracies:
        return sonar
    sizes, variances = lengths(world.walls), np.zeros(len(world.walls))
    first = len(world.fixed_walls) - len(world.inner_walls)
    for row, accuracy in world.accuracies.items():
        variances[first + row] = accuracy.offset_std_in**2
    return replace(sonar, place_var_in2=sonar.place_var_in2 + float(sizes @ variances / sizes.sum()))


def measurement_model(walls: npt.ArrayLike, body: Body, sonar: RaySonar | ConeSonar, gate: Gate = STRICT,
                      range_parameters: int = 0) -> MeasurementModel:  # fmt: skip
    """Return the measurement model for sonars of this type; `range_parameters` as in `update.expected_reading`."""
    if isinstance(sonar, ConeSonar):
        return ConeModel(walls, body, sonar, range_parameters)
    return RayModel(walls, body, sonar, gate, range_parameters)
