"""How well many poses explain one reading: what Monte Carlo localization weighs its particles with.

    RayLikelihood     z_hit N(z; ray, sigma) + z_rand / range        the beam model (Thrun, Burgard, Fox 2005, 6.3)
    ConeLikelihood    the same over all reflectors in the cone       the densities of mixture

Rules: pure arrays; a pose a row, a likelihood a row, never 0; no particle is changed here. Widened by what the number
of particles cannot resolve: a likelihood sharper than the distance between particles kills all but one, and so would
many from one place. What it is widened by counts as an error that stays (repeats).
"""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import Floats
from localization.estimation.repeats import share_of_first
from localization.sonar.cone import ConeModel, Ear, cone_chances
from localization.sonar.measurement import SonarModel, SonarRing, pick, rays, ring, wall_map
from localization.sonar.range_noise import RangeNoise
from localization.sonar.reflectors import reflectors
from worlds.raycast import cast_rays

SPAN_IN: Final = 249.0
"""Bad readings of a ray lie anywhere from 6 to 255 inches."""


class Weighed(NamedTuple):
    """Likelihoods of a reading at n poses, per inch: of whatever it may be (n,), and of them the part of bad readings
    (n,)."""

    whole: Floats
    bad: Floats


class Likelihood(Protocol):
    """A kind of sonar, in a map, on a body."""

    def is_range(self, reading_in: float) -> bool:
        """Whether a reading tells a range at all."""
        ...

    def news(self, reading_in: float, times: int) -> float:
        """What the `times`-th of such readings from one place adds, as a share of the first (repeats)."""
        ...

    def of(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Weighed:
        """Of a reading at poses (n, 3)."""
        ...


def _news(noise: RangeNoise, widened_in2: float, reading_in: float, times: int) -> float:
    variance, constant = np.array((noise.variance_at(reading_in), noise.constant_at(reading_in))) + widened_in2
    return float(share_of_first(variance, constant, times))


class RayLikelihood:
    """One exact ray a sonar; `bad_share` of the readings spread over all ranges; `widen_std_in` beside the sonar's."""

    def __init__(
        self,
        walls: npt.ArrayLike,
        body: SonarRing,
        sonar: SonarModel,
        *,
        bad_share: float = 0.05,
        widen_std_in: float = 0.5,
    ) -> None:
        self._walls, self._body, self._sonar = wall_map(walls), body, sonar
        self._bad_share, self._widen = bad_share, widen_std_in**2

    def is_range(self, reading_in: float) -> bool:
        return self._sonar.lowest_in < reading_in < self._sonar.highest_in

    def news(self, reading_in: float, times: int) -> float:
        return _news(self._sonar, self._widen, reading_in, times)

    def of(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Weighed:
        beam = pick(ring(self._body, turret_offset_rad), sonar)
        aimed = rays(poses[:, None, :], beam)
        from_axis = cast_rays(aimed.axes_in, aimed.directions, self._walls.segments)[0][:, 0]
        seen = np.isfinite(from_axis)
        expected = np.where(seen, from_axis, 0.0) - beam.standoff_in
        variance = self._sonar.variance(expected) + self._widen
        hit = np.exp(-0.5 * (reading_in - expected) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        bad = np.full(len(poses), self._bad_share / SPAN_IN)
        return Weighed((1.0 - self._bad_share) * np.where(seen, hit, 0.0) + bad, bad)


class ConeLikelihood:
    """All reflectors in the cone; `heading_std_rad` makes its rim soft, `widen_std_in` its ranges."""

    def __init__(
        self,
        walls: npt.ArrayLike,
        body: SonarRing,
        model: ConeModel,
        *,
        heading_std_rad: float = 0.03,
        widen_std_in: float = 0.5,
    ) -> None:
        self._around, self._body, self._model = reflectors(wall_map(walls).segments), body, model
        self._heading_std, self._widen = np.array(heading_std_rad), widen_std_in**2

    def is_range(self, reading_in: float) -> bool:
        return self._model.lowest_in < reading_in < self._model.highest_in

    def news(self, reading_in: float, times: int) -> float:
        return _news(self._model, self._widen, reading_in, times)

    def of(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Weighed:
        model = self._model
        ear = Ear(turret_offset_rad + self._body.sonar_angles_rad[sonar], self._body.sonar_ring_radius_in)
        ranges, probability = cone_chances(poses, self._heading_std, ear, self._around, model)
        variance = model.variance(ranges) + self._widen
        hits = np.exp(-0.5 * (reading_in - ranges) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        good = 1.0 - model.bad_share
        bad = model.bad_density * (1.0 - good * probability.sum(axis=-1))
        return Weighed(good * (probability * hits).sum(axis=-1) + bad, bad)
