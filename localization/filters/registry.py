"""The table of methods: by name, what makes each from what is known beforehand and a first belief."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters import update as updates
from localization.filters.base import Filter, LocalizationConfig, measurement_model
from localization.filters.belief import Belief
from localization.filters.calibration import CalibratingFilter
from localization.filters.ekf import KalmanFilter
from localization.filters.global_localization import GlobalLocalizer
from localization.filters.odometry import LARGEST, POSE, with_parameters
from localization.filters.particles import (
    ConeLikelihood,
    Likelihood,
    MonteCarlo,
    ParticleFilter,
    RayLikelihood,
    drawn_from,
)
from localization.filters.range_table import RangeTable, build_range_table
from localization.filters.smoother import FixedLagSmoother
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import STRICT, Gate, RaySonar, SonarRing
from localization.filters.ukf import predict as unscented_predict
from localization.filters.update import MeasurementUpdate

Maker = Callable[[LocalizationConfig, Belief, int], Filter]
"""Makes a filter from what is known, the belief at the first state, and a seed, which methods without chance ignore."""


def _extended(known: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    return KalmanFilter(belief, _hearing(known), known.odometry)


def _iterated(known: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    return KalmanFilter(belief, _hearing(known, updates.iterated), known.odometry)


def _unscented(known: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    return KalmanFilter(belief, _hearing(known, updates.unscented), known.odometry, unscented_predict)


def _smoother(known: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    return FixedLagSmoother(belief, _hearing(known), known.odometry)


def _particles(known: LocalizationConfig, belief: Belief, seed: int) -> Filter:
    chance = np.random.default_rng(seed)
    parameters = MonteCarlo()
    states = drawn_from(belief, parameters.particles, chance)
    return ParticleFilter(states, likelihood_of(known), known.odometry, chance, parameters)


def _offsets(known: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    """Of the wheels' constants it finds out those that the belief has."""
    return CalibratingFilter(known, with_parameters(belief, (0.0,) * (LARGEST - len(belief.mean))))


def _finder(known: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    return finder(known, belief)


FINDER: Final = "finder"
"""The one that may begin without a belief."""
METHODS: Final[Mapping[str, Maker]] = MappingProxyType(
    {
        "ekf": _extended,
        "iekf": _iterated,
        "ukf": _unscented,
        "smoother": _smoother,
        "mcl": _particles,
        FINDER: _finder,
        "offsets": _offsets,
    }
)
"""Every method by its name."""
DEFAULT_METHOD: Final = "ekf"


def make(method: str, known: LocalizationConfig, belief: Belief, seed: int = 0) -> Filter:
    """The filter of a name in METHODS. Raises ValueError for any other name."""
    if method not in METHODS:
        raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}")
    return METHODS[method](known, belief, seed)


def finder(known: LocalizationConfig, belief: Belief | None, constants: tuple[float, ...] = ()) -> GlobalLocalizer:
    """The method that finds itself again, and that may begin with no belief at all; `constants` as in systematic."""
    stds = constants if belief is None else tuple(belief.std[POSE:].tolist())

    def atlas() -> RangeTable:
        walls = np.asarray(known.walls, dtype=np.float64).tobytes()
        return _drawn(walls, Ring(known.body.sonar_ring_radius_in, ()), known.sonar, known.clearance_in)

    return GlobalLocalizer(belief, _hearing(known), known.odometry, atlas, known.body.sonar_angles_rad, stds)


class Ring(NamedTuple):
    """What an atlas wants to know of a body: which sonar it is does not count there."""

    sonar_ring_radius_in: float
    sonar_angles_rad: tuple[float, ...]


@lru_cache(maxsize=4)
def _drawn(walls: bytes, body: Ring, sonar: RaySonar | ConeSonar, clearance_in: float) -> RangeTable:
    """Drawn once for all robots of a process that know the same map: many trials are driven in the same few worlds."""
    return build_range_table(np.frombuffer(walls).reshape(-1, 4), body, sonar, clearance_in)


def _hearing(known: LocalizationConfig, rule: updates.Rule = updates.linear) -> MeasurementUpdate:
    return update_for(known.walls, known.body, known.sonar, known.gate, rule)


def likelihood_of(known: LocalizationConfig) -> Likelihood:
    """How particles are weighed with sonars of this kind."""
    if isinstance(known.sonar, ConeSonar):
        return ConeLikelihood(known.walls, known.body, known.sonar)
    return RayLikelihood(known.walls, known.body, known.sonar)


def update_for(
    walls: npt.ArrayLike,
    body: SonarRing,
    sonar: RaySonar | ConeSonar,
    gate: Gate = STRICT,
    rule: updates.Rule = updates.linear,
) -> MeasurementUpdate:
    """How sonars of this model are taken in."""
    return MeasurementUpdate(measurement_model(walls, body, sonar, gate), rule)
