"""The filters by name, and what makes each from a configuration and a first belief."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters import particles, ukf
from localization.filters.base import Filter, LocalizationConfig, measurement_model
from localization.filters.belief import POSE, Belief, Floats
from localization.filters.calibration import CalibratingFilter
from localization.filters.ekf import KalmanFilter
from localization.filters.global_localization import GlobalLocalizer
from localization.filters.health import BUILDING, HealthLimits
from localization.filters.odometry import MAX_STATE, Prediction, predict_state, with_parameters
from localization.filters.own import SEPARATOR, make_own
from localization.filters.pose_search import PoseSearch, TableSearch
from localization.filters.range_table import RangeTable, build_range_table
from localization.filters.smoother import FixedLagSmoother
from localization.filters.sonar_cone import ConeModel, ConeSonar
from localization.filters.sonar_ray import STRICT, Gate, RaySonar, wall_map
from localization.filters.surface import SurfaceModel, SurfaceUpdate
from localization.filters.update import MeasurementUpdate, Rule, iterated, linear
from nclient.errors import suggest
from worlds.robots import Body

Factory = Callable[[LocalizationConfig, Belief, int], Filter]
"""Makes a filter from a configuration, the belief at the first state, and a seed for methods that draw samples."""


def _smoother(config: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    stds = config.range_stds or ()
    measurement = _measurement(config, linear, len(stds))
    return FixedLagSmoother(belief, measurement, config.odometry, range_stds=stds, middle_in=_middle(config),
                            limits=_LIMITS)


def _particles(config: LocalizationConfig, belief: Belief, seed: int) -> Filter:
    rng = np.random.default_rng(seed)
    states = particles.draw_particles(belief, particles.PARTICLES, rng)
    kind: Any = particles.ConeLikelihood if isinstance(config.sonar, ConeSonar) else particles.RayLikelihood
    likelihood = kind(config.walls, config.body, config.sonar)
    return particles.ParticleFilter(states, likelihood, config.odometry, rng, config.range_stds or (), _middle(config))


def _offsets(config: LocalizationConfig, belief: Belief, _seed: int) -> Filter:
    """Estimate the odometry parameters that the belief has; the others are certain to be 0."""
    return CalibratingFilter(config, with_parameters(belief, (0.0,) * (MAX_STATE - len(belief.mean))))


FINDER: Final = "finder"
"""The method that can begin without a belief."""
METHODS: Final[Mapping[str, Factory]] = MappingProxyType({
    "ekf": lambda config, belief, _: _kalman(config, belief),
    "iekf": lambda config, belief, _: _kalman(config, belief, iterated),
    "ukf": lambda config, belief, _: _kalman(config, belief, ukf.unscented, ukf.predict_state),
    "smoother": _smoother,
    "mcl": _particles,
    FINDER: lambda config, belief, _: finder(config, belief),
    "offsets": _offsets,
})
"""Every method by its name; they differ in the rule of the update, the prediction or the form of the belief."""
DEFAULT_METHOD: Final = "ekf"


class _MethodChoices(tuple[str, ...]):
    """The names in METHODS, and any `module:Class` as well."""

    __slots__ = ()

    def __contains__(self, method: object) -> bool:
        return isinstance(method, str) and (SEPARATOR in method or super().__contains__(method))


METHOD_CHOICES: Final = _MethodChoices(METHODS)
"""What `--method` accepts, for argparse."""
SLIP_NATS: Final = 6.0
"""Evidence of a slip of the wheels that widens the covariance."""
HEADING_NATS: Final = 12.0
"""Evidence of another heading that corrects it, as of another pose in `finder`."""
MAX_NIS_RATIO: Final = 2.5
"""The covariance is widened for a mean NIS up to this."""
MIN_MATCHED: Final = 0.37
"""Exact rays that are taken for cones are explained to a third by accident."""
_LIMITS: Final = HealthLimits(min_matched=MIN_MATCHED, max_nis_ratio=MAX_NIS_RATIO, slip_nats=SLIP_NATS,
                              heading_nats=HEADING_NATS)
_SURFACE_LIMITS: Final = replace(BUILDING, heading_nats=HEADING_NATS)


def make(method: str, config: LocalizationConfig, belief: Belief, seed: int = 0) -> Filter:
    """Return a new filter of a name in METHODS, or of a user's class, `module:Class`.

    Raises
    ------
    ValueError
        No such name.
    OwnFilterError
        No such class.
    """
    if SEPARATOR in method:
        return make_own(method, config, belief)
    if method not in METHODS:
        raise ValueError(f"no method {method!r}; there are {', '.join(METHODS)}{suggest(method, METHODS)}")
    return METHODS[method](config, belief, seed)


def finder(config: LocalizationConfig, belief: Belief | None, parameter_stds: tuple[float, ...] = (),
           poses: PoseSearch | None = None, alike: Sequence[Floats] = ()) -> GlobalLocalizer:  # fmt: skip
    """Return the filter that localizes globally; without a belief it begins with a search.

    `parameter_stds` are of the odometry parameters, where there is no belief that has them. `poses` searches the map.
    Default: in this process, which may take seconds on a large map. `alike` are poses that look like the belief's.
    """
    # With a belief the parameters' uncertainty is in it.
    stds = parameter_stds if belief is None else tuple(belief.std[POSE:].tolist())
    measurement = _measurement(config)
    poses = poses or table_search(config)
    return GlobalLocalizer(belief, measurement, config.odometry, poses, config.body.sonar_angles_rad, stds, alike=alike)


def table_search(config: LocalizationConfig) -> TableSearch:
    """Return a search in this process, by a table that is built once for all robots on a map."""

    def table() -> RangeTable:
        # Bytes are hashable, arrays are not: the walls are part of the cache's key.
        walls = np.asarray(config.walls, dtype=np.float64).tobytes()
        return _table(walls, _Ring(config.body.sonar_ring_radius_in, ()), config.sonar, config.clearance_in)

    return TableSearch(table, _measurement(config), config.odometry)


class _Ring(NamedTuple):
    """A body as far as a range table depends on it: not on the angle of each sonar."""

    sonar_ring_radius_in: float
    sonar_angles_rad: tuple[float, ...]


@lru_cache(maxsize=4)
def _table(walls: bytes, body: _Ring, sonar: RaySonar | ConeSonar, clearance_in: float) -> RangeTable:
    """Return the range table of a map; built once for all robots of a process."""
    return build_range_table(np.frombuffer(walls).reshape(-1, 4), body, sonar, clearance_in)


def _kalman(config: LocalizationConfig, belief: Belief, rule: Rule = linear,
            prediction: Prediction = predict_state) -> KalmanFilter:
    """Return a Kalman filter that estimates the range parameters as well, unless the configuration has none."""
    stds = config.range_stds or ()
    measurement, limits = _measurement(config, rule, len(stds)), _LIMITS
    if isinstance(config.sonar, ConeSonar) and config.sonar.surface_std_in and rule is linear:
        # It stores where echoes were: one for each filter.
        cone = ConeModel(config.walls, config.body, config.sonar, len(stds))
        measurement, limits = SurfaceUpdate(SurfaceModel(cone, config.surfaces)), _SURFACE_LIMITS
    return KalmanFilter(belief, measurement, config.odometry, prediction, stds, _middle(config), limits)


def _middle(config: LocalizationConfig) -> tuple[float, float]:
    """Return the middle of the map's bounding box."""
    x_in, y_in, _ = wall_map(config.walls).middle
    return x_in, y_in


def _measurement(config: LocalizationConfig, rule: Rule = linear, range_parameters: int = 0) -> MeasurementUpdate:
    return update_for(config.walls, config.body, config.sonar, config.gate, rule, range_parameters)


def update_for(walls: npt.ArrayLike, body: Body, sonar: RaySonar | ConeSonar, gate: Gate = STRICT, rule: Rule = linear,
               range_parameters: int = 0) -> MeasurementUpdate:  # fmt: skip
    """Return the measurement update for sonars of this type; `range_parameters` as in `update.expected_reading`."""
    return MeasurementUpdate(measurement_model(walls, body, sonar, gate, range_parameters), rule)
