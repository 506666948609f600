"""Filters of users: any class with `x`, `P`, `predict` and `update` localizes a robot; docs/own-filter.md shows one.

nomad localize ADDRESS --method mymodule:MyFilter        a module that Python finds, here first
nomad localize ADDRESS --method my_filter.py:MyFilter    a file

OwnFilter           what the class needs
TimedEcho           an echo, its time, and the direction in which it was measured
OwnFilterAdapter    such a filter as one of this package's: with health, for the live localizer
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple, Protocol, cast

import numpy as np
import numpy.typing as npt

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import POSE, Belief
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import NO_LAG, Lag, add_lag, predict
from localization.filters.update import GATE, LIMIT, NONE, Outcome, UpdateResult, mount_at, result_of
from nclient.errors import NomadError, suggest

SEPARATOR: Final = ":"
"""Between module and class; no method of this package has one in its name."""


class OwnFilterError(NomadError, ValueError):
    """A filter of a user cannot be loaded, or its estimate is not valid; the message says what is expected."""

    usage = True


class TimedEcho(NamedTuple):
    """An echo of one sonar.

    Attributes
    ----------
    clock_s
        The instant of the echo, seconds of the robot's clock.
    sonar
        Number of the sonar.
    range_in
        Its reading in inches, from the transducer. Limits (nothing found, or too near) are not passed on.
    direction_rad
        Direction of the sonar against the heading at that instant, counter-clockwise.
    ring_in
        Distance of the transducer from the robot's axis in that direction.
    left_in
        Distance of the transducer to the left of that line; 0 on a Nomad.
    """

    clock_s: float
    sonar: int
    range_in: float
    direction_rad: float
    ring_in: float
    left_in: float = 0.0


class OwnFilter(Protocol):
    """Interface of a filter that a user writes. It is made by `MyFilter(config, belief)`.

    config
        `LocalizationConfig`: walls (m, 4), the robot's body, the noise of its encoders.
    belief
        `Belief` at the first state: mean (3,) and cov (3, 3) of x_in, y_in and the heading in radians.
    """

    @property
    def x(self) -> npt.ArrayLike:
        """Return the estimate: x_in, y_in, heading in radians, and what else the filter estimates."""

    @property
    def P(self) -> npt.ArrayLike:
        """Return its covariance."""

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict after a step that the encoders report: so far along the heading, and so far turned."""

    def update(self, echo: TimedEcho) -> tuple[float, float] | None:
        """Correct the estimate, which is predicted to the echo's instant.

        Return the innovation in inches and its variance S, or None if the echo was not used.
        """


OwnFactory = Callable[[LocalizationConfig, Belief], OwnFilter]


class OwnFilterAdapter(Filter):
    """A filter of a user with the interface of `base.Filter`.

    Its health is judged by the innovations that `update` returns. The estimate at a state, after the last echo, is
    predicted by the odometry model of this package from the filter's x and P.
    """

    def __init__(self, own: OwnFilter, config: LocalizationConfig) -> None:
        self.own = own
        self._config = config
        self._mounts = config.body.ring.mounts
        self._lowest_in, self._highest_in = config.sonar.lowest_in, config.sonar.highest_in
        self._monitor = IntegrityMonitor()
        self._belief = self._read_belief()

    @property
    def belief(self) -> Belief:
        """The filter's x and P, the pose only."""
        return self._belief

    @property
    def health(self) -> FilterHealth:
        """Status of the estimate."""
        return self._monitor.health(self._belief.cov.tolist())

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Call the filter's `predict`."""
        self.own.predict(distance_in, turn_rad)
        self._belief = self._read_belief()

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after a step, without taking it, widened by a lag."""
        step = np.array([distance_in, turn_rad])
        return add_lag(predict(self._belief, step, self._config.odometry), lag)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Call the filter's `update`, with an echo without a time."""
        return result_of(self.update_at(math.nan, sonar, turret_offset_rad, reading_in))

    def update_at(self, instant_s: float, sonar: int, turret_offset_rad: float, reading_in: float) -> Outcome:
        """Call the filter's `update`."""
        # 1. Limits are no ranges.
        if not self._lowest_in < reading_in < self._highest_in:
            return LIMIT, 0.0, 0.0, 0.0, 1.0, 0.0
        # 2. The filter's own update.
        direction_rad, ring_in, left_in = mount_at(self._mounts, sonar, turret_offset_rad)
        result = self.own.update(TimedEcho(instant_s, sonar, reading_in, direction_rad, ring_in, left_in))
        self._belief = self._read_belief()
        # 3. Its innovation, for health and plots.
        outcome: Outcome = (GATE, 0.0, 0.0, 1.0, 1.0, 0.0)
        if result is not None:
            innovation, S = self._innovation(result)
            outcome = (NONE, innovation, innovation * innovation / S, 0.0, 1.0, 0.0)
        self._monitor.add(outcome)
        return outcome

    def _innovation(self, result: Any) -> tuple[float, float]:
        try:
            innovation, S = (float(number) for number in result)
        except (TypeError, ValueError):
            innovation, S = math.nan, 0.0
        if not (math.isfinite(innovation) and math.isfinite(S) and S > 0.0):
            raise OwnFilterError(
                f"{self._name}.update returned {result!r}; expected the innovation and its variance S > 0, or None"
            )
        return innovation, S

    def _read_belief(self) -> Belief:
        """Return x and P of the pose. Raises OwnFilterError unless they are finite and P has variances above 0."""
        try:
            x, P = np.array(self.own.x, dtype=np.float64), np.array(self.own.P, dtype=np.float64)
        except AttributeError as error:
            raise OwnFilterError(f"{self._name} has no {error.name}; expected x (3,) and P (3, 3)") from None
        except (TypeError, ValueError):
            raise OwnFilterError(f"{self._name}.x or .P holds no numbers; expected x (3,) and P (3, 3)") from None
        if x.ndim != 1 or len(x) < POSE or P.shape != (len(x), len(x)):
            shapes = f"shapes {x.shape} and {P.shape}"
            raise OwnFilterError(f"{self._name}.x and .P have the {shapes}; expected (n,) and (n, n), n of 3 or more")
        if not (np.isfinite(x).all() and np.isfinite(P).all() and (np.diagonal(P) > 0.0).all()):
            raise OwnFilterError(f"{self._name}: x is {x.tolist()}, the diagonal of P {np.diagonal(P).tolist()}; "
                                 "expected finite numbers, and variances above 0")
        return Belief(x[:POSE], P[:POSE, :POSE])

    @property
    def _name(self) -> str:
        return type(self.own).__name__


def load_factory(method: str) -> OwnFactory:
    """Return the class that `module:Class` or `file.py:Class` names.

    Raises
    ------
    OwnFilterError
        If there is no such module or class; errors of the module itself are not caught.
    """
    place, _, name = method.rpartition(SEPARATOR)
    module = _load_file(Path(place)) if place.endswith(".py") else _load_module(place)
    found = getattr(module, name, None)
    if not callable(found):
        classes = [key for key, value in vars(module).items() if isinstance(value, type)]
        raise OwnFilterError(f"{place} has no class {name!r}; it has {', '.join(classes)}{suggest(name, classes)}")
    return cast("OwnFactory", found)


def make_own(method: str, config: LocalizationConfig, belief: Belief) -> OwnFilterAdapter:
    """Return a new filter of a user. Raises OwnFilterError."""
    # A filter without odometry parameters: it may estimate any of its own.
    return OwnFilterAdapter(load_factory(method)(config, belief.pose), config)


def _load_file(path: Path) -> ModuleType:
    # A name of its own: a file numpy.py must not take the place of the package.
    name = f"own_filter_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise OwnFilterError(f"{path}: no such file; expected FILE.py:CLASS or MODULE:CLASS")
    module = importlib.util.module_from_spec(spec)
    # Before it runs: dataclasses look their module up.
    sys.modules[name] = module
    with _found_first(path.resolve().parent):
        spec.loader.exec_module(module)
    return module


def _load_module(name: str) -> ModuleType:
    with _found_first(Path.cwd()):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            # A module that the user's own module imports is reported as Python does.
            if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                raise
            raise OwnFilterError(f"no module {name!r} here or where Python looks; expected MODULE:CLASS") from None
        except ValueError:
            raise OwnFilterError(f"{name!r} is no module; expected MODULE:CLASS or FILE.py:CLASS") from None


@contextmanager
def _found_first(folder: Path) -> Iterator[None]:
    """Let modules of a folder be imported within this block."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
