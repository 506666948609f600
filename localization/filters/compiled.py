"""The echoes of a whole ring in one call of machine code: numba compiles the formulas of the filter.

numba compiles the functions of odometry, sonar_ray, sonar_cone, update and worlds.raycast from their own source, for
floats. Only what numba cannot type has a second form here: access to the walls, which are lists in plain Python and
arrays in compiled code. No fast math: results equal those of plain Python to the bit, so it is used by default
where either the code is on disk or a terminal shows that it is being compiled.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from inspect import isfunction
from pathlib import Path
from typing import Any, Final, NamedTuple, cast
from zlib import crc32

import numpy as np

from localization.filters import belief, odometry, sonar_cone, sonar_ray, update
from localization.filters.belief import POSE, Floats
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import Gate, RayModel, RaySonar
from localization.filters.update import Covariance, DirectModel, Outcome, State
from worlds import raycast

ENCODERS: Final = 5
"""Elements of `base.EncoderRow`."""
_log = logging.getLogger(__name__)

# Arguments of compiled code: what it reads of the classes of the same name, with arrays for lists.
NoiseRow = NamedTuple("NoiseRow", [(field.name, float) for field in fields(OdometryNoise)])  # type: ignore[misc]
RaySonarRow = NamedTuple(
    "RaySonarRow", [*((field.name, float) for field in fields(RaySonar)), ("range_span_in", float)]  # type: ignore[misc]
)
ConeSonarRow = NamedTuple(
    "ConeSonarRow",
    [*((field.name, float) for field in fields(ConeSonar)), ("outlier_density", float)],  # type: ignore[misc]
)
GateRow = NamedTuple("GateRow", [(field.name, float) for field in fields(Gate)])  # type: ignore[misc]


class WallArrays(NamedTuple):
    """A `WallMap`."""

    segments: Floats
    lines: Floats
    middle: tuple[float, float, float]


class ListedWalls(NamedTuple):
    """`WallArrays` with the rows as a list, which compiled code makes once and not for every ray."""

    segments: Floats
    lines: Floats
    middle: tuple[float, float, float]
    rows: Any


class RayArrays(NamedTuple):
    """A `RayModel`."""

    noise: Any
    walls: WallArrays
    gate: Any
    threshold: float
    mounts: Floats
    range_parameters: int


class ConeArrays(NamedTuple):
    """A `ConeModel`."""

    noise: Any
    walls: WallArrays
    faces: Floats
    vertices: Floats
    mounts: Floats
    range_parameters: int


def row_of(row: Any, record: object) -> Any:
    """Return a record as a row of floats."""
    return row(*(float(getattr(record, name)) for name in row._fields))


def _arrays(model: Any) -> RayArrays | ConeArrays:
    """Return a model, of rays or cones, as compiled code takes it."""
    walls = WallArrays(model.walls.segments, model.walls.lines, model.walls.middle)
    ring = (np.array(model.mounts), model.range_parameters)
    if isinstance(model, RayModel):
        noise, gate = row_of(RaySonarRow, model.noise), row_of(GateRow, model.gate)
        return RayArrays(noise, walls, gate, model.threshold, *ring)
    faces, vertices = np.array(model.faces).reshape(-1, 5), np.array(model.vertices).reshape(-1, 3)
    return ConeArrays(row_of(ConeSonarRow, model.noise), walls, faces, vertices, *ring)


# Compiling.

SOURCES: Final = (belief, odometry, sonar_ray, sonar_cone, update, raycast)
"""numba may compile all functions of these modules; it does so for those that the loop calls."""

# Forms for numba of what differs between lists and arrays. It cannot unpack a row of an array: rows become tuples.


def _wall_rows(walls: Any) -> Any:
    return [(row[0], row[1], row[2], row[3]) for row in walls.segments]


def _listed_rows(walls: Any) -> Any:
    return walls.rows


def _form_of_rows(walls: Any) -> Callable[..., Any]:
    """Return the form of `wall_rows` for a type of walls."""
    return _listed_rows if "rows" in walls.fields else _wall_rows


def _rows_of_five(rows: Any) -> Any:
    return [(row[0], row[1], row[2], row[3], row[4]) for row in rows]


def _rows_of_three(rows: Any) -> Any:
    return [(row[0], row[1], row[2]) for row in rows]


def _nearest(x: Any, y: Any, dx: Any, dy: Any, walls: Any) -> Any:
    return raycast.nearest_wall(x, y, dx, dy, sonar_ray.wall_rows(walls))


def _line_of(row: Any, walls: Any) -> Any:
    return walls.lines[row, 0], walls.lines[row, 1], walls.lines[row, 2]


def _choose(condition: Any, value: Any, other: Any) -> Any:
    return value if condition else other


_FORMS: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    sonar_ray.wall_rows: _wall_rows,
    sonar_cone.rows_of_five: _rows_of_five,
    sonar_cone.rows_of_three: _rows_of_three,
    sonar_ray.nearest: _nearest,
    sonar_ray.line_of: _line_of,
    belief.choose: _choose,
}


def _same(form: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that gives numba this form for arguments of any type."""
    return lambda *_: form


@cache
def load() -> bool:
    """Prepare numba; return True if it is installed. From then on `compiled_ring` returns rings."""
    try:
        import numba
        import numba.extending
    except ImportError:
        return False
    for module in SOURCES:
        for function in vars(module).values():
            if isfunction(function) and function.__module__ == module.__name__ and function not in _FORMS:
                numba.extending.register_jitable(function)
    for function, form in _FORMS.items():
        of_type = _form_of_rows if form is _wall_rows else _same(form)
        numba.extending.overload(function, strict=False)(of_type)
    return True


@cache
def _checksum(loop: Callable[..., list[Outcome]]) -> int:
    """Return a checksum of all sources, with this file."""
    checksum = crc32(Path(__file__).read_bytes(), crc32(Path(loop.__code__.co_filename).read_bytes()))
    for module in SOURCES:
        checksum = crc32(Path(str(module.__file__)).read_bytes(), checksum)
    return checksum


def _mark(loop: Callable[..., list[Outcome]], correct: Callable[..., Outcome]) -> Path:
    """Return the file that marks this loop and update as compiled, in the folder of numba's cache."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parent / "__pycache__")
    key = crc32(f"{version('numba')} {sys.implementation.cache_tag}".encode(), _checksum(loop))
    return folder / f"compiled.{correct.__name__}.{key:08x}"


def is_wanted(loop: Callable[..., list[Outcome]], correct: Callable[..., Outcome]) -> bool:
    """Return True if compiled code is to be used: as NOMAD_COMPILED says, or where nothing waits for it unseen.

    By default it is used if it is on disk, as importing numba and reading it takes a second, or if stderr is a
    terminal, where a localizer shows that it is being compiled.

    Raises
    ------
    VariableError
        The variable is set to an unknown word.
    """
    if not raycast.is_compiled_for(raycast.CROWD):
        return False
    try:
        return raycast.is_compiled_for(1) or _mark(loop, correct).exists() or sys.stderr.isatty()
    except PackageNotFoundError:  # no numba
        return False


@cache
def _compile(loop: Callable[..., list[Outcome]], correct: Callable[..., Outcome]) -> Callable[..., list[Outcome]]:
    """Return the loop over a ring with this update: compiled when called first, or loaded from the cache."""
    import numba

    # numba's cache watches this file only: the checksum of the others is part of its key, as a variable of the closure.
    checksum = _checksum(loop)

    def filter_ring(
        x: Any, P: Any, used: Any, encoders: Any, poses: Any, echoes: Any, noise: Any, model: Any
    ) -> list[Outcome]:
        assert checksum >= 0
        return loop(x, P, used, encoders, poses, echoes, noise, model, correct)

    numba.extending.register_jitable(loop)
    try:
        compiled: Any = numba.njit(cache=True)(filter_ring)
    except RuntimeError:  # no writable directory for the cache
        compiled = numba.njit(filter_ring)
    return cast("Callable[..., list[Outcome]]", compiled)


class CompiledRing:
    """`ekf.filter_ring` in machine code, for one model and odometry."""

    def __init__(self, loop: Callable[..., list[Outcome]], model: DirectModel, noise: OdometryNoise) -> None:
        self._run = _compile(loop, model.update)
        self._noise, self._model = row_of(NoiseRow, noise), _arrays(model)
        mark = _mark(loop, model.update)
        if mark.exists():
            self._warm_up()
            return
        _log.warning("compiling the filter with numba; the result is cached function=%s", model.update.__name__)
        self._warm_up()
        with suppress(OSError):  # no writable directory
            mark.touch()

    def _warm_up(self) -> None:
        """Compile now, not in the first update."""
        encoders = (0.0,) * ENCODERS
        self.filter([0.0] * POSE, [[0.0] * POSE for _ in range(POSE)], np.zeros((1, 4)), encoders, [encoders], [])

    def filter(
        self,
        x: State,
        P: Covariance,
        used: Any,
        encoders: Sequence[float],
        poses: Sequence[Sequence[float]],
        echoes: Sequence[Sequence[float]],
    ) -> list[Outcome]:
        """Filter x, P by all echoes of a ring, in place: see `ekf.filter_ring`; `used` is an array."""
        mean, cov, rows = np.array(x), np.array(P), np.array(echoes).reshape(-1, 3)
        outcomes = self._run(mean, cov, used, tuple(encoders), np.array(poses), rows, self._noise, self._model)
        x[:], P[:] = mean.tolist(), cov.tolist()
        return outcomes


def ring(loop: Callable[..., list[Outcome]], model: DirectModel | None, noise: OdometryNoise) -> CompiledRing | None:
    """Return the compiled loop; None for a model without an update of its own, without numba, or if not wanted."""
    return CompiledRing(loop, model, noise) if model and is_wanted(loop, model.update) and load() else None
