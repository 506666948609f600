"""Walls of real buildings: errors of a map that stay the same over some distance along a wall.

A door stands back over its whole width, and a pillar stands out. A filter that takes successive echoes of a wall for
independent then becomes sure of a wrong position. Here the surface of a wall is at a level that stays for an
exponentially distributed length and is then drawn anew: two echoes of one wall, d inches of driving apart, are on the
same level with probability exp(-d / length), the correlation of their errors. An echo has two hypotheses for a wall:

    same level    z = h(x) + (z' - h(x'))        R = r + r'         probability exp(-d / length)
    new level     z = h(x)                       R = r + std^2      the rest

with z' the last echo of that wall, x' the pose then, by odometry from the pose x now, and r, r' the variances of the
two readings. The first is the measurement difference by which correlated noise is made white; its derivative is
H - H' dx'/dx. `update.pda_update` weighs both. A robot that stands learns nothing from more echoes: H = H' dx'/dx.

References
----------
Bryson, Henrikson, Estimation using sampled data containing sequentially correlated noise (1968): measurement
differencing. Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), chapter 8
(autocorrelated measurement noise) and chapter 11 (jumps as hypotheses).
"""

from __future__ import annotations

from math import exp, hypot
from typing import Final, NamedTuple

from localization.filters.belief import HEADING, unit_vector, wrap_angle
from localization.filters.sonar_cone import ConeModel, ConeSonar, arm_of, detectable, range_jacobian
from localization.filters.sonar_ray import range_variance
from localization.filters.update import (
    NONE,
    OUTLIER_THRESHOLD,
    REFUSALS,
    Association,
    Covariance,
    Refusal,
    State,
    expected_reading,
    kalman_gain,
    mount_at,
)
from worlds.rings import SonarMount

MAX_NIS: Final = 16.0
"""An echo within four standard deviations of a wall on a new level is taken for one of it."""


class LastEcho(NamedTuple):
    """The last echo of a reflector: pose by odometry, sonar (its direction from the heading), and reading."""

    x_in: float
    y_in: float
    heading_rad: float
    mount: SonarMount
    reading_in: float


class SurfaceModel:
    """Measurement model of cones among walls with a surface, for one filter: it stores the last echo of each wall.

    Parameters
    ----------
    cone
        The cone model, whose noise has the surface.
    """

    def __init__(self, cone: ConeModel) -> None:
        self._cone, self._walls = cone, len(cone.faces)
        self._last: dict[int, LastEcho] = {}
        self._x = self._y = self._heading = 0.0
        """Pose by odometry, from where the filter began."""

    @property
    def noise(self) -> ConeSonar:
        """Parameters of the sonars and of the surface."""
        return self._cone.noise

    def move(self, distance_in: float, turn_rad: float) -> None:
        """Take note of a step: the distance and the turn that the odometry parameters make of the reported one."""
        cosine, sine = unit_vector(self._heading + 0.5 * turn_rad)
        self._x, self._y = self._x + distance_in * cosine, self._y + distance_in * sine
        self._heading = wrap_angle(self._heading + turn_rad)

    def associate(
        self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float
    ) -> Association:
        """Return two hypotheses for each reflector that may return the first echo: on the same level, on a new one.

        A reading that fits no reflector is refused with NO_WALL where probably no wall is detected: real buildings are
        full of small things, and echoes of them say nothing of the pose. Nor does a missing edge: the end of a wall on
        the map is often only the end of what was mapped.
        """
        noise, mount = self.noise, mount_at(self._cone.mounts, sonar, turret_offset_rad)
        refusal, likelihood, candidates = detectable(x, P, mount, reading_in, self._cone)
        if refusal != NONE:
            return Association(REFUSALS[refusal], likelihood)
        expected, derivatives, variances, probabilities = [], [], [], []
        nearest_nis, nearest = MAX_NIS, -1
        for candidate in candidates:
            # 1. A new level.
            variance = range_variance(noise, candidate.range_in)
            reading, H = expected_reading(x, candidate.range_in, candidate.H, self._cone.range_parameters)
            R = variance + noise.surface_std_in**2
            nis = (reading_in - reading) ** 2 / kalman_gain(P, H, R)[1]
            if nis <= nearest_nis:
                nearest_nis, nearest = nis, candidate.reflector
            # 2. The level of the last echo.
            last, same = self._last.get(candidate.reflector), 0.0
            if last:
                away_in = hypot(self._x - last.x_in, self._y - last.y_in)
                same = exp(-away_in / noise.surface_length_in)
                before, H_before = self._reading_then(x, candidate.reflector, last)
                expected.append(reading + last.reading_in - before)
                derivatives.append([one - other for one, other in zip(H, H_before, strict=True)])
                variances.append(variance + range_variance(noise, last.reading_in))
                probabilities.append(candidate.probability * same)
            expected.append(reading)
            derivatives.append(H)
            variances.append(R)
            probabilities.append(candidate.probability * (1.0 - same))
        # 3. The reflector of this echo, if any.
        if nearest >= 0:
            self._last[nearest] = LastEcho(self._x, self._y, self._heading, mount, reading_in)
        elif sum(one.probability for one in candidates if one.reflector < self._walls) < OUTLIER_THRESHOLD:
            return Association(Refusal.NO_WALL, noise.outlier_density)
        return Association(
            Refusal.NONE, 1.0, expected, derivatives, variances, [0.0] * len(expected), probabilities, None,
            noise.outlier_probability, noise.outlier_density,
        )  # fmt: skip

    def _reading_then(self, x: State, reflector: int, last: LastEcho) -> tuple[float, list[float]]:
        """Return the reading that x expects of a reflector at the pose of its last echo, and its derivative by x."""
        # 1. The pose then from the pose now, by odometry; x' = x (+) (ahead, left, turn).
        cosine, sine = unit_vector(self._heading)
        back_x, back_y = last.x_in - self._x, last.y_in - self._y
        ahead, left = cosine * back_x + sine * back_y, cosine * back_y - sine * back_x
        cosine, sine = unit_vector(x[HEADING])
        east, north = cosine * ahead - sine * left, sine * ahead + cosine * left
        heading = x[HEADING] + last.heading_rad - self._heading
        # 2. The range then.
        arm_x, arm_y = arm_of(last.mount, *unit_vector(heading + last.mount.direction_rad))
        range_in, to_x, to_y = self._cone.toward(x[0] + east + arm_x, x[1] + north + arm_y, reflector)
        # 3. H' dx'/dx: turning now swings the pose then about the robot.
        H = range_jacobian(to_x, to_y, east + arm_x, north + arm_y)
        return expected_reading(x, range_in, H, self._cone.range_parameters)
