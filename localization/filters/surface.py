"""Walls of real buildings: errors of a map that stay the same over some distance along a wall.

A door stands back over its whole width, and a pillar stands out. A filter that takes successive echoes of a wall for
independent then becomes sure of a wrong position. Here the surface of a wall is at a level that stays for an
exponentially distributed length and is then drawn anew: two echoes of one wall, d inches of driving apart, are on the
same level with probability exp(-d / length), the correlation of their errors. The levels of the walls that were
measured last are states of the filter. An echo has two hypotheses for a wall:

    same level    z = h(x) + b        b, the level of this wall so far         probability exp(-d / length)
    new level     z = h(x) + b'       b', drawn from N(0, std^2)               the rest

each with the variance r of the reading. A map that was learned there states spots of the surface. Where an echo comes
from one, with the level l and its standard deviation s, there is a third hypothesis:

    surface as learned   z = h(x) + l,  variance r + s^2 + SPOT_STD_IN^2       probability AS_LEARNED, the others less

Without it a learned map would be no better than the true straight lines of the walls, whose surfaces the filter has
to measure on each drive anew. All are weighed by their probability, and merged into one Gaussian in which
the wall's level is b or b'. A first echo measures the position to r + std^2; all echoes of one level together measure
it no better than to std^2, but the heading, by how the range changes along the level, to the few millimetres of a
smooth wall. A robot that stands learns nothing more from more echoes. Nor does one whose base turns below its turret:
these echoes are repeated ones (`update.count_along_axis`). Taken for new ones, the echoes of a thing that is not on the
map, received once a second along one axis, turned an uncertain heading by 17 degrees.

The filter's state is: pose and odometry parameters, MAX_LEVELS levels, b', range parameters.

References
----------
Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 8.2.3
(autocorrelated measurement noise as states) and section 11.6 (jumps as hypotheses, merged into one Gaussian).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp, hypot
from typing import Final

import numpy as np

from localization.filters import update
from localization.filters.belief import HEADING, Floats, normal_density, unit_vector, wrap_angle
from localization.filters.sonar_cone import ConeModel, Reflectors, arm_of, detectable, to_wall
from localization.filters.sonar_ray import range_variance
from localization.filters.update import Association, Covariance, MeasurementUpdate, State, UpdateResult
from worlds.world import SPOT_REACH_IN, SurfaceSpot

MAX_NIS: Final = 16.0
"""An echo within four standard deviations of a wall on a new level is taken for one of it."""
MAX_LEVELS: Final = 6
"""Walls whose level is a state: a ring measures few walls at a time, and the cost grows with the square."""
LEVEL_STATES: Final = MAX_LEVELS + 1
"""Coordinates of the state for the levels, and for the level that a wall may change to."""
AS_LEARNED: Final = 0.9
"""Probability that a learned spot of a surface is still there. Where it is, 0.9 to 0.97 do equally well; with 0.5 one
of 15 drives was lost. Where all surfaces have changed, a position is twice as far off with 0.9 as without spots."""
SPOT_STD_IN: Final = 0.4
"""Standard deviation of a surface from the level of a spot: where one level ends within it, the rest is an inch off."""


class _Level:
    """The level of a reflector: its number among the levels of the state, and where its last echo was measured."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.x_in = self.y_in = 0.0
        self.echo = 0


class _Surface:
    """The learned spots of a wall: where along it, their levels towards its normal, and the variances of these.

    Parameters
    ----------
    spots
        (k, 3) x, y and standard deviation of the level.
    corner, along, normal
        (2,) beginning of the wall, its direction, and its normal.
    """

    def __init__(self, spots: Sequence[SurfaceSpot], corner: Floats, along: Floats, normal: Floats) -> None:
        rows = np.array(spots).reshape(-1, 3)
        at = (rows[:, :2] - corner) @ along
        order = np.argsort(at, kind="stable")
        self._corner, self._normal, self._at = corner.tolist(), normal.tolist(), at[order]
        self._levels = ((rows[:, :2] - corner) @ normal)[order]
        self._variances = np.append((np.square(rows[:, 2]) + SPOT_STD_IN**2)[order], np.inf)

    def change(self, face_x: Floats, face_y: Floats) -> tuple[Floats, Floats]:
        """Return by how much the surface changes ranges from the faces (...) of sonars, and the variances of this.

        The variance is inf where no spot is within SPOT_REACH_IN of the foot. A level is towards the normal of the
        wall: from that side ranges are shorter.
        """
        _, toward_x, toward_y, foot = to_wall(face_x, face_y, *self._corner, *self._normal)
        after = np.searchsorted(self._at, foot)
        before, after = np.maximum(after - 1, 0), np.minimum(after, len(self._at) - 1)
        nearest = np.where(np.abs(self._at[before] - foot) <= np.abs(self._at[after] - foot), before, after)
        is_there = np.abs(self._at[nearest] - foot) <= SPOT_REACH_IN
        change_in = (toward_x * self._normal[0] + toward_y * self._normal[1]) * self._levels[nearest]
        return change_in, self._variances[np.where(is_there, nearest, len(self._at))]


class SurfaceModel:
    """Measurement model of cones among walls with a surface, for one filter: the state has the levels of its walls.

    Parameters
    ----------
    cone
        The cone model, whose noise has the surface.
    surfaces
        Learned spots of walls by their rows in the map.
    """

    def __init__(self, cone: ConeModel, surfaces: Mapping[int, Sequence[SurfaceSpot]] | None = None) -> None:
        self.cone, self._walls, self.noise = cone, len(cone.faces), cone.noise
        faces = cone.around
        self._surfaces = {
            row: _Surface(spots, faces.corners[row], faces.along[row], faces.normals[row])
            for row, spots in (surfaces or {}).items() if spots
        }
        self._surface_of = {tuple(faces.walls[row].tolist()): surface for row, surface in self._surfaces.items()}
        """By the ends of their walls: a part of the reflectors (`Reflectors.within`) has other rows."""
        self._levels: dict[int, _Level] = {}
        """By the number of the reflector."""
        self._echoes = 0
        self._x = self._y = self._heading = 0.0
        """Pose by odometry, from where the filter began."""
        self._hypotheses: list[tuple[int, bool]] = []
        """Of the last association: reflector of each hypothesis, True where its level is b' afterwards."""

    def move(self, distance_in: float, turn_rad: float) -> None:
        """Take note of a step: the distance and the turn that the odometry parameters make of the reported one."""
        cosine, sine = unit_vector(self._heading + 0.5 * turn_rad)
        self._x, self._y = self._x + distance_in * cosine, self._y + distance_in * sine
        self._heading = wrap_angle(self._heading + turn_rad)

    def associate(self, x: State, P: Covariance, sonar: int, turret_offset_rad: float,
                  reading_in: float) -> Association:
        """Return hypotheses for each reflector that may return the first echo: on the same level, on a new one.

        And that its surface is as it was learned.

        A reading that fits no reflector is refused with NO_WALL where probably no wall is detected: real buildings are
        full of small things, and echoes of them say nothing of the pose. Nor does a missing edge: the end of a wall on
        the map is often only the end of what was mapped.
        """
        noise, range_parameters = self.noise, self.cone.range_parameters
        mount = update.mount_at(self.cone.mounts, sonar, turret_offset_rad)
        refusal, likelihood, candidates = detectable(x, P, mount, reading_in, self.cone)
        if refusal != update.NONE:
            return Association(update.REFUSALS[refusal], likelihood)
        expected, derivatives, variances, probabilities = [], [], [], []
        self._hypotheses, nearest_nis = [], MAX_NIS
        first = len(x) - range_parameters - LEVEL_STATES
        arm_x, arm_y = arm_of(mount, *unit_vector(x[HEADING] + mount.direction_rad))
        face_x, face_y = x[0] + arm_x, x[1] + arm_y
        for candidate in candidates:
            # 1. The reading if the wall were where the map says, and its derivative but for the levels.
            variance = range_variance(noise, candidate.range_in)
            reading, H = update.expected_reading(x, candidate.range_in, candidate.H, range_parameters)
            hypotheses = [(MAX_LEVELS, 1.0)]
            # 2. The level of the last echo, if there was one.
            if level := self._levels.get(candidate.reflector):
                same = exp(-hypot(self._x - level.x_in, self._y - level.y_in) / noise.surface_length_in)
                hypotheses = [(level.number, same), (MAX_LEVELS, 1.0 - same)]
            # 3. The learned level of the spot that it comes from.
            if learned := self._learned(candidate.reflector, face_x, face_y):
                change_in, level_variance = learned
                hypotheses = [(number, (1.0 - AS_LEARNED) * probability) for number, probability in hypotheses]
                expected.append(reading + change_in)
                derivatives.append([*H[:3], *[0.0] * LEVEL_STATES, *H[3:]])
                variances.append(variance + level_variance)
                probabilities.append(candidate.probability * AS_LEARNED)
                # Elsewhere the surface is on another level afterwards.
                self._hypotheses.append((candidate.reflector, True))
                innovation_var = update.kalman_gain(P, derivatives[-1], variances[-1])[1]
                nearest_nis = min(nearest_nis, (reading_in - expected[-1]) ** 2 / innovation_var)
            for number, probability in hypotheses:
                of_levels = [0.0] * LEVEL_STATES
                of_levels[number] = 1.0
                expected.append(reading + x[first + number])
                derivatives.append([*H[:3], *of_levels, *H[3:]])
                variances.append(variance)
                probabilities.append(candidate.probability * probability)
                self._hypotheses.append((candidate.reflector, number == MAX_LEVELS))
            nis = (reading_in - reading) ** 2 / update.kalman_gain(P, derivatives[-1], variance)[1]
            nearest_nis = min(nearest_nis, nis)
        of_walls = sum(one.probability for one in candidates if one.reflector < self._walls)
        if nearest_nis >= MAX_NIS and of_walls < update.OUTLIER_THRESHOLD:
            return Association(update.Refusal.NO_WALL, noise.outlier_density)
        return Association(update.Refusal.NONE, 1.0, expected, derivatives, variances, [0.0] * len(variances),
                           probabilities, None, noise.outlier_probability, noise.outlier_density)  # fmt: skip

    def _learned(self, reflector: int, face_x: float, face_y: float) -> tuple[float, float] | None:
        """Return by how much the learned surface changes a range, and the variance of this; None where none was."""
        if reflector not in self._surfaces:
            return None
        change_in, variance = self._surfaces[reflector].change(np.array(face_x), np.array(face_y))
        return (float(change_in), float(variance)) if variance < np.inf else None

    def densities(self, innovation_in: Floats, S: Floats, around: Reflectors, face_x: Floats, face_y: Floats) -> Floats:
        """Return the density (..., j) per inch of innovations by j reflectors, for `HeadingTest`.

        That of the hypotheses of `associate` without those of the same level: the filter's levels are of its heading.

        Parameters
        ----------
        innovation_in, S
            (..., j) reading less the expected one if the walls were where the map says, and its variance.
        around
            The j reflectors, some of those of the map.
        face_x, face_y
            (...) faces of the sonars.
        """
        found = normal_density(innovation_in, S + self.noise.surface_std_in**2)
        for number, wall in enumerate(around.walls.tolist()):
            if surface := self._surface_of.get(tuple(wall)):
                change_in, variance = surface.change(face_x, face_y)
                is_there = np.isfinite(variance)
                learned = normal_density(
                    innovation_in[..., number] - change_in, S[..., number] + np.where(is_there, variance, 0.0)
                )
                found[..., number] = np.where(
                    is_there, AS_LEARNED * learned + (1.0 - AS_LEARNED) * found[..., number], found[..., number]
                )
        return found

    def merge(self, x: State, P: Covariance, corrections: Sequence[update.Correction], beta: Sequence[float]) -> None:
        """Replace x and P by the mean and covariance of the mixture of all hypotheses, in place.

        As steps 4 and 5 of `update.pda_update`, but a hypothesis with a new level first gives it to its wall: the
        coordinate of the wall's level is then that of b'.

        Parameters
        ----------
        corrections
            Of the k hypotheses of the last association.
        beta
            Their probabilities and last that of an outlier (k + 1,).
        """
        first = len(x) - self.cone.range_parameters - LEVEL_STATES
        fresh, variance = first + MAX_LEVELS, self.noise.surface_std_in**2
        # 1. The most probable reflector, and where its level is among the coordinates.
        of_reflector: dict[int, float] = {}
        for (reflector, _), probability in zip(self._hypotheses, beta, strict=False):
            of_reflector[reflector] = of_reflector.get(reflector, 0.0) + probability
        best = max(of_reflector, key=of_reflector.__getitem__)
        is_of_it, is_known = of_reflector[best] > update.OUTLIER_THRESHOLD, best in self._levels
        # 2. For each hypothesis the coordinates of the filter that become those of the next state.
        sources = np.tile(np.arange(len(x)), (len(beta), 1))
        if is_known:
            is_new = [*(one == (best, True) for one in self._hypotheses), False]
            sources[is_new, first + self._levels[best].number] = fresh
        elif is_of_it:
            self._levels[best] = _Level(self._free_number())
            sources[:, first + self._levels[best].number] = fresh
        if is_of_it:
            self._echoes += 1
            level = self._levels[best]
            level.x_in, level.y_in, level.echo = self._x, self._y, self._echoes
        # 3. Means m_j = x + dx_j, an outlier's is x; covariances P - K_j S_j K_j^T.
        dx = np.array([*(one.dx for one in corrections), [0.0] * len(x)])
        means = np.take_along_axis(np.array(x) + dx, sources, axis=1)
        weights, prior = np.array(beta), np.array(P)
        mean = weights @ means
        cov = (means - mean).T @ (weights[:, None] * (means - mean))
        for j, source in enumerate(sources):
            cov += beta[j] * prior[source[:, None], source]
            if j < len(corrections):
                K = np.array(corrections[j].K)[source]
                cov -= beta[j] * corrections[j].S * (K[:, None] * K)
        # 4. The next new level is independent of everything.
        mean[fresh] = cov[fresh] = cov[:, fresh] = 0.0
        cov[fresh, fresh] = variance
        x[:], P[:] = mean.tolist(), cov.tolist()
        x[HEADING] = wrap_angle(x[HEADING])

    def _free_number(self) -> int:
        """Return the number of a level that no reflector has, if need be of that which was measured least recently."""
        if len(self._levels) < MAX_LEVELS:
            return len(self._levels)
        oldest = min(self._levels, key=lambda reflector: self._levels[reflector].echo)
        return self._levels.pop(oldest).number


class SurfaceUpdate(MeasurementUpdate):
    """The update by a `SurfaceModel`, whose levels change with the echoes."""

    def __init__(self, model: SurfaceModel) -> None:
        super().__init__(model)
        self._surface = model

    @property
    def level_stds(self) -> tuple[float, ...]:
        """Prior standard deviations of the levels in the state, inches."""
        return (self._surface.noise.surface_std_in,) * LEVEL_STATES

    def move(self, distance_in: float, turn_rad: float) -> None:
        """Take note of a step of the robot; see `SurfaceModel.move`."""
        self._surface.move(distance_in, turn_rad)

    def apply(self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float, count: int = 1,
              outlier_fraction: float = 1.0) -> UpdateResult:  # noqa: ARG002  in buildings most echoes are outliers
        """Correct x and P in place by a reading; see `MeasurementUpdate.apply`."""
        association = self._surface.associate(x, P, sonar, turret_offset_rad, reading_in)
        if association.refusal is not update.Refusal.NONE:
            return UpdateResult(association.refusal, 0.0, 0.0, 1.0, association.likelihood)
        slopes = [update.forward_slope(H, *unit_vector(x[HEADING])) for H in association.H]
        corrections = update.linear(x, P, reading_in, association, association.R)
        beta, likelihood, best = update.association_probabilities(association, corrections)
        if count == 1:  # the error of a repeated reading is that of the first: it adds nothing
            self._surface.merge(x, P, corrections, beta)
        _, _, innovation_in, nis, _ = corrections[best]
        refusal = update.gate_code(beta[-1])
        return update.result_of((refusal, innovation_in, nis, beta[-1], likelihood, slopes[best]))
