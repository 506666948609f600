"""The echoes of a whole ring in one call of machine code: numba compiles the formulas of the filter.

numba compiles the functions of odometry, sonar_ray, sonar_cone, update and worlds.raycast from their own source, for
floats. Only what numba cannot type has a second form here: access to the walls, which are lists in plain Python and
arrays in compiled code. No fast math: results equal those of plain Python to the bit, so it is used by default
where either the code is on disk or a terminal shows that it is being compiled.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from localization.filters import belief, health, odometry, sonar_cone, sonar_ray, update
from localization.filters.belief import POSE, Floats
from localization.filters.health import LARGEST
from localization.filters.odometry import NO_LAG, Lag, OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import Gate, RayModel, RaySonar
from localization.filters.update import DirectModel, Outcome
from worlds import compiled, raycast
from worlds.compiled import checksum, compile_function, functions_of, make_compilable, mark_path, write_mark

ENCODERS: Final = 5
"""Elements of `base.EncoderRow`."""
_log = logging.getLogger(__name__)

# What compiled code reads of the classes of the same name.
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


def _arguments(model: Any) -> tuple[Any, ...]:
    """Return a model of rays or cones in plain tuples and arrays: see `_ray_model`, `_cone_model`.

    A call of compiled code takes most of its time for its arguments, and several times as long for a named tuple.
    """
    walls, mounts = model.walls, np.array(model.mounts)
    common = (walls.middle, walls.segments, walls.lines, mounts, model.range_parameters)
    if isinstance(model, RayModel):
        sonar, gate = row_of(RaySonarRow, model.noise), row_of(GateRow, model.gate)
        return tuple(sonar), *common, tuple(gate), model.threshold
    faces, vertices = np.array(model.faces).reshape(-1, 5), np.array(model.vertices).reshape(-1, 3)
    return tuple(row_of(ConeSonarRow, model.noise)), *common, faces, vertices


def _ray_model(
    sonar: Any, middle: Any, segments: Any, lines: Any, mounts: Any, parameters: int, gate: Any, threshold: float
) -> RayArrays:
    """Return a model from its parts, in compiled code."""
    walls = WallArrays(segments, lines, middle)
    return RayArrays(RaySonarRow(*sonar), walls, GateRow(*gate), threshold, mounts, parameters)


def _cone_model(
    sonar: Any, middle: Any, segments: Any, lines: Any, mounts: Any, parameters: int, faces: Any, vertices: Any
) -> ConeArrays:
    """Return a model from its parts, in compiled code."""
    walls = WallArrays(segments, lines, middle)
    return ConeArrays(ConeSonarRow(*sonar), walls, faces, vertices, mounts, parameters)


# Compiling.

SOURCES: Final = (belief, health, odometry, sonar_ray, sonar_cone, update, raycast)
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


def _same_rows(rows: Any) -> Any:
    return rows


def _form_for_arrays(form: Callable[..., Any]) -> Callable[..., Any]:
    """Return what chooses this form for rows in an array; a list of tuples stays as it is."""
    return lambda rows: form if hasattr(rows, "ndim") else _same_rows


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
        make_compilable(function for function in functions_of(*SOURCES) if function not in _FORMS)
        import numba.extending
    except ImportError:
        return False
    for function, form in _FORMS.items():
        if form is _wall_rows:
            of_type = _form_of_rows
        elif form in {_rows_of_five, _rows_of_three}:
            of_type = _form_for_arrays(form)
        else:
            of_type = _same(form)
        numba.extending.overload(function, strict=False)(of_type)
    return True


@cache
def source_checksum(loop: Callable[..., Any]) -> int:
    """Return a checksum of all sources, with this file."""
    return checksum(__file__, loop.__code__.co_filename, *(module.__file__ for module in SOURCES))


def _mark(loop: Callable[..., list[Outcome]], correct: Callable[..., Outcome]) -> Path:
    """Return the file that marks this loop and update as compiled."""
    return mark_path(correct.__name__, source_checksum(loop))


def is_wanted(loop: Callable[..., list[Outcome]], correct: Callable[..., Outcome]) -> bool:
    """Return True if compiled code is to be used: see `worlds.compiled.is_wanted`."""
    return compiled.is_wanted(correct.__name__, source_checksum(loop))


@cache
def _compile(loop: Callable[..., list[Outcome]], correct: Callable[..., Outcome]) -> Callable[..., list[Outcome]]:
    """Return the loop over a ring with this update: compiled when called first, or loaded from the cache."""
    assemble = _ray_model if correct is sonar_ray.update_by_ray else _cone_model

    # numba's cache watches this file only: the checksum of the others is part of its key, as a variable of the closure.
    sources = source_checksum(loop)

    def filter_ring(
        x: Any, P: Any, used: Any, slip_sums: Any, encoders: Any, poses: Any, echoes: Any, noise: Any, *parts: Any
    ) -> list[Outcome]:
        assert sources >= 0
        model = assemble(*parts)
        return loop(x, P, used, slip_sums, encoders, poses, echoes, NoiseRow(*noise), model, correct)

    make_compilable([loop, assemble])
    return compile_function(filter_ring)


@cache
def _compile_prediction(widen: Callable[..., None]) -> Callable[..., tuple[Floats, Floats]]:
    """Return the prediction that is reported, without changing x and P: compiled when called first, or loaded."""
    sources, prediction = source_checksum(widen), odometry.predict_state

    def predicted(
        x: Any, P: Any, size: int, distance: float, turn: float, noise: Any, nis_ratio: float, lag: Any, scale: float,
        middle: Any, slipped: float,
    ) -> tuple[Floats, Floats]:  # fmt: skip
        assert sources >= 0
        x, P = x[:size].copy(), P[:size, :size].copy()
        widen(x, P, distance, turn, NoiseRow(*noise), nis_ratio, lag, scale, middle, slipped, prediction)
        return x, P

    make_compilable([widen])
    return compile_function(predicted)


class CompiledRing:
    """`ekf.filter_ring` and `odometry.widen_prediction` in machine code, for one model and odometry."""

    def __init__(
        self,
        loop: Callable[..., list[Outcome]],
        widen: Callable[..., None],
        model: DirectModel,
        noise: OdometryNoise,
    ) -> None:
        self._run, self._predict = _compile(loop, model.update), _compile_prediction(widen)
        self._noise = tuple(row_of(NoiseRow, noise))
        self._model = _arguments(model)
        mark = _mark(loop, model.update)
        if mark.exists():
            self._warm_up()
            return
        _log.warning("compiling the filter with numba; the result is cached function=%s", model.update.__name__)
        self._warm_up()
        write_mark(mark)

    def _warm_up(self) -> None:
        """Compile now, not in the first update."""
        encoders = (0.0,) * ENCODERS
        used, slip_sums = np.zeros((1, 4)), np.zeros((0, LARGEST + 1))
        x, P = np.zeros(POSE), np.zeros((POSE, POSE))
        self._run(x, P, used, slip_sums, encoders, np.array([encoders]), np.zeros((0, 3)), self._noise, *self._model)
        self.predicted(x, P, POSE, 0.0, 0.0, 1.0, NO_LAG, 0.0, (0.0, 0.0), 0.0)

    def filter(
        self,
        x: Any,
        P: Any,
        used: Any,
        slip_sums: Any,
        encoders: Sequence[float],
        poses: Sequence[Sequence[float]],
        echoes: Sequence[Sequence[float]],
    ) -> list[Outcome]:
        """Filter x, P by all echoes of a ring, in place: see `ekf.filter_ring`; the first four are arrays."""
        outcomes: list[Outcome] = self._run(
            x, P, used, slip_sums, tuple(encoders), np.array(poses), np.array(echoes), self._noise, *self._model
        )
        return outcomes

    def predicted(
        self, x: Any, P: Any, size: int, distance: float, turn: float, nis_ratio: float, lag: Lag, scale: float,
        middle: tuple[float, float], slipped_in2: float,
    ) -> tuple[Floats, Floats]:  # fmt: skip
        """Return the first `size` coordinates of x and P, predicted and widened: see `odometry.widen_prediction`."""
        return self._predict(x, P, size, distance, turn, self._noise, nis_ratio, lag, scale, middle, slipped_in2)


def ring(
    loop: Callable[..., list[Outcome]],
    widen: Callable[..., None],
    model: DirectModel | None,
    noise: OdometryNoise,
) -> CompiledRing | None:
    """Return the compiled loop; None for a model without an update of its own, without numba, or if not wanted."""
    return CompiledRing(loop, widen, model, noise) if model and is_wanted(loop, model.update) and load() else None
