"""A whole state of the robot in one call of machine code: numba compiles the formulas of the filter.

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

from localization.filters import belief, filter_loop, health, odometry, sonar_cone, sonar_ray, update
from localization.filters.base import EncoderRow
from localization.filters.belief import POSE, Belief, Floats
from localization.filters.filter_loop import FilterConfig, FilterMemory, StateInput, filter_state, new_memory
from localization.filters.health import Signs
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import Gate, RayModel, RaySonar
from localization.filters.update import Outcome
from worlds import compiled, raycast
from worlds.compiled import checksum, compile_function, functions_of, make_compilable, mark_path, write_mark

ENCODERS, ECHO, OUTCOME, SIGNS = 5, 3, 6, 6
"""Elements of `base.EncoderRow`, of `base.NewEcho`, of `update.Outcome` and of `health.Signs`."""
SCALARS = ENCODERS + 2
"""Elements before the poses: the encoders, and the other two numbers of a `filter_loop.StateInput`."""
_log = logging.getLogger(__name__)

# The fields that compiled code reads of the classes of the same name.
NoiseRow = NamedTuple("NoiseRow", [(field.name, float) for field in fields(OdometryNoise)])  # type: ignore[misc]
RaySonarRow = NamedTuple(
    "RaySonarRow", [*((field.name, float) for field in fields(RaySonar)), ("range_span_in", float)]  # type: ignore[misc]
)
ConeSonarRow = NamedTuple(
    "ConeSonarRow",
    [*((field.name, float) for field in fields(ConeSonar)), ("outlier_density", float)],  # type: ignore[misc]
)
GateRow = NamedTuple("GateRow", [(field.name, float) for field in fields(Gate)])  # type: ignore[misc]


class ListedWalls(NamedTuple):
    """A `WallMap` with the rows as a list, which compiled code makes once and not for every ray."""

    segments: Floats
    lines: Floats
    middle: tuple[float, float, float]
    rows: Any


class PackedWalls(NamedTuple):
    """A `WallMap` whose rows compiled code reads one by one, without a list: quicker where few rays are cast."""

    segments: Floats
    lines: Floats
    middle: tuple[float, float, float]


class RayArrays(NamedTuple):
    """A `RayModel`."""

    noise: Any
    walls: PackedWalls
    gate: Any
    threshold: float
    mounts: Floats
    range_parameters: int


class ConeArrays(NamedTuple):
    """A `ConeModel`."""

    noise: Any
    walls: PackedWalls
    faces: Floats
    vertices: Floats
    mounts: Floats
    range_parameters: int


def row_of(row: Any, record: object) -> Any:
    """Return a record as a row of floats."""
    return row(*(float(getattr(record, name)) for name in row._fields))


# A call of compiled code takes most of its time for its arguments: a tuple of five numbers costs as much as two arrays
# of any size, a named tuple several times as much. So all that stays from call to call is one array.


class ConfigArrays(NamedTuple):
    """A `filter_loop.FilterConfig`."""

    noise: Any
    model: Any
    slip_nats: float
    max_totals: Floats
    middle: tuple[float, float]


def pack_config(config: FilterConfig) -> Floats:
    """Return what a filter is configured with in one array, which `_config_of` unpacks.

    Named tuples stand in it as they are, arrays of rows after their number of rows.
    """
    model: Any = config.model
    walls = model.walls
    limits = *config.middle, config.slip_nats, len(config.max_totals), *config.max_totals
    if isinstance(model, RayModel):
        sonar = row_of(RaySonarRow, model.noise)
        rest = [*row_of(GateRow, model.gate), model.threshold]
    else:
        sonar, rest = row_of(ConeSonarRow, model.noise), [*_packed(model.faces), *_packed(model.vertices)]
    walls = [*walls.middle, *_packed(walls.segments), *_packed(walls.lines)]
    shared = *_packed(model.mounts), model.range_parameters
    return np.array([*row_of(NoiseRow, config.noise), *limits, *sonar, *walls, *shared, *rest], dtype=np.float64)


def _packed(rows: Sequence[Sequence[float]] | Floats) -> list[float]:
    """Return the number of rows, and all their elements."""
    return [len(rows), *(number for row in rows for number in row)]


def _first(count: int, numbers: Floats) -> tuple[float, ...]:
    """Return so many elements as a tuple, in compiled code: `load` gives numba its form."""
    return tuple(numbers[:count].tolist())


def _unpack_rows(columns: int, numbers: Any) -> tuple[Any, Any]:
    """Return the rows at the beginning of an array, and what follows them: see `_packed`."""
    rows = int(numbers[0])
    end = 1 + rows * columns
    return numbers[1:end].reshape((rows, columns)), numbers[end:]


_ODOMETRY, _MIDDLE, _GATE = len(NoiseRow._fields), 3, len(GateRow._fields)
_RAY, _CONE = len(RaySonarRow._fields), len(ConeSonarRow._fields)


def _unpack_walls(numbers: Any) -> tuple[PackedWalls, Any, int, Any]:
    """Return walls, mounts and range parameters, which follow one another, and what follows them."""
    middle_x, middle_y, half_in = _first(_MIDDLE, numbers)
    segments, numbers = _unpack_rows(4, numbers[_MIDDLE:])
    lines, numbers = _unpack_rows(3, numbers)
    mounts, numbers = _unpack_rows(3, numbers)
    return PackedWalls(segments, lines, (middle_x, middle_y, half_in)), mounts, int(numbers[0]), numbers[1:]


def _ray_model(numbers: Any) -> RayArrays:
    """Return the model of rays from `pack_config`, in compiled code."""
    sonar = RaySonarRow(*_first(_RAY, numbers))
    walls, mounts, parameters, numbers = _unpack_walls(numbers[_RAY:])
    return RayArrays(sonar, walls, GateRow(*_first(_GATE, numbers)), numbers[_GATE], mounts, parameters)


def _cone_model(numbers: Any) -> ConeArrays:
    """Return the model of cones from `pack_config`, in compiled code."""
    sonar = ConeSonarRow(*_first(_CONE, numbers))
    walls, mounts, parameters, numbers = _unpack_walls(numbers[_CONE:])
    faces, numbers = _unpack_rows(5, numbers)
    vertices, _ = _unpack_rows(3, numbers)
    return ConeArrays(sonar, walls, faces, vertices, mounts, parameters)


def _config_of(numbers: Any, assemble: Callable[[Any], Any]) -> ConfigArrays:
    """Return what `pack_config` has packed, in compiled code, with the model that `assemble` unpacks."""
    noise, numbers = NoiseRow(*_first(_ODOMETRY, numbers)), numbers[_ODOMETRY:]
    middle, slip_nats = (numbers[0], numbers[1]), numbers[2]
    totals = int(numbers[3])
    end = 4 + totals
    return ConfigArrays(noise, assemble(numbers[end:]), slip_nats, numbers[4:end], middle)


# Compiling.

SOURCES: Final = (belief, filter_loop, health, odometry, sonar_ray, sonar_cone, update, raycast)
"""numba may compile all functions of these modules; it does so for those that the loop calls."""

# Forms for numba of what differs between lists and arrays. It cannot unpack a row of an array: rows become tuples.


def _each_wall_row(walls: Any) -> Any:
    segments = walls.segments
    for k in range(len(segments)):
        yield segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]


def _listed_rows(walls: Any) -> Any:
    return walls.rows


def _form_of_rows(walls: Any) -> Callable[..., Any]:
    """Return the form of `wall_rows` for a type of walls."""
    return _listed_rows if walls.instance_class is ListedWalls else _each_wall_row


def _rows_of_five(rows: Any) -> Any:
    for k in range(len(rows)):
        yield rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4]


def _rows_of_three(rows: Any) -> Any:
    for k in range(len(rows)):
        yield rows[k, 0], rows[k, 1], rows[k, 2]


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


def _same(form: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that gives numba this form for arguments of any type."""
    return lambda *_: form


_FORMS: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    sonar_ray.wall_rows: _form_of_rows,
    sonar_cone.rows_of_five: _form_for_arrays(_rows_of_five),
    sonar_cone.rows_of_three: _form_for_arrays(_rows_of_three),
    sonar_ray.nearest: _same(_nearest),
    sonar_ray.line_of: _same(_line_of),
    belief.choose: _same(_choose),
}
"""What chooses the form of a function by the types of its arguments."""


@cache
def load() -> bool:
    """Prepare numba; return True if it is installed. From then on `filter_of` returns compiled filters."""
    try:
        make_compilable(function for function in functions_of(*SOURCES) if function not in _FORMS)
        import numba.extending
    except ImportError:
        return False
    for function, of_type in _FORMS.items():
        numba.extending.overload(function, strict=False)(of_type)
    from numba.np.unsafe import ndarray

    # The number of elements is part of the type of a tuple: a literal. numba wants a form without annotations.
    to_tuple: Any = ndarray.to_fixed_tuple
    numba.extending.overload(_first, prefer_literal=True)(
        lambda count, numbers: lambda count, numbers: to_tuple(numbers, count)  # noqa: ARG005
    )
    return True


@cache
def source_checksum(loop: Callable[..., Any] = filter_state) -> int:
    """Return a checksum of all sources, with this file and that of a loop."""
    return checksum(__file__, loop.__code__.co_filename, *(module.__file__ for module in SOURCES))


def _mark(correct: Callable[..., Outcome]) -> Path:
    """Return the file that marks the loop with this update as compiled."""
    return mark_path(correct.__name__, source_checksum())


def is_on_disk(correct: Callable[..., Outcome]) -> bool:
    """Return True if the loop with this update need not be compiled. Raises PackageNotFoundError without numba."""
    return _mark(correct).exists()


def is_wanted(correct: Callable[..., Outcome]) -> bool:
    """Return True if compiled code is to be used: see `worlds.compiled.is_wanted`."""
    return compiled.is_wanted(correct.__name__, source_checksum())


@cache
def _compile(correct: Callable[..., Outcome]) -> Callable[..., None]:
    """Return the loop over a state with this update: compiled when called first, or loaded from the cache."""
    assemble = _ray_model if correct is sonar_ray.update_by_ray else _cone_model
    # numba's cache watches this file only: the checksum of the others is part of its key, as a variable of the closure.
    sources = source_checksum()

    def run(x: Any, P: Any, used: Any, slip_sums: Any, windows: Any, inputs: Any, count: int, mean: Any, cov: Any,
            results: Any, numbers: Any) -> None:  # fmt: skip
        assert sources >= 0
        config: Any = _config_of(numbers, assemble)
        # 1. `inputs` has the encoders, two numbers, `count` poses and the echoes, one after another.
        end = SCALARS + ENCODERS * count
        poses, rest = inputs[SCALARS:end].reshape((count, ENCODERS)), inputs[end:]
        echoes = rest.reshape((len(rest) // ECHO, ECHO))
        before: Any = _first(ENCODERS, inputs)
        state = StateInput(before, poses, echoes, inputs[ENCODERS], inputs[ENCODERS + 1] != 0.0)
        memory = FilterMemory(x, P, used, slip_sums, windows)
        outcomes, encoders, signs = filter_state(memory, state, config, correct, mean, cov)
        # 2. The results in an array: to return tuples and lists would take longer than to filter.
        k = 0
        for value in encoders:
            results[k] = value
            k += 1
        for value in signs:
            results[k] = value
            k += 1
        for refusal, innovation, nis, outlier_probability, likelihood, slope in outcomes:
            results[k], results[k + 1], results[k + 2] = refusal, innovation, nis
            results[k + 3], results[k + 4], results[k + 5] = outlier_probability, likelihood, slope
            k += OUTCOME

    make_compilable([assemble, _config_of, _unpack_walls, _unpack_rows])
    return compile_function(run)


_RESULTS: Final = ENCODERS + SIGNS
"""Elements of the results before the outcomes."""


class CompiledFilter:
    """`filter_loop.filter_state` in machine code, for one configuration."""

    def __init__(self, config: FilterConfig) -> None:
        correct = config.model.update
        self._run, self._numbers = _compile(correct), pack_config(config)
        if is_on_disk(correct):
            self._warm_up()
            return
        _log.warning("compiling the filter with numba; the result is cached function=%s", correct.__name__)
        self._warm_up()
        write_mark(_mark(correct))

    def _warm_up(self) -> None:
        """Compile now, not in the first update."""
        x: Any = np.zeros(POSE)
        P: Any = np.zeros((POSE, POSE))
        encoders = (0.0, 0.0, 0.0, 0.0, 0.0)
        state = StateInput(encoders, [encoders], [], 0.0, detects_slips=False)
        self.filter(new_memory(x, P, as_array=True), state, POSE)

    def filter(self, memory: FilterMemory, state: StateInput,
               size: int) -> tuple[list[Outcome], EncoderRow, Signs, Belief]:
        """Return `filter_state`, and the prediction of the first `size` coordinates; the memory is in arrays."""
        encoders, poses, echoes, clock_std_s, detects_slips = state
        numbers = [*encoders, clock_std_s, detects_slips]
        for pose in poses:
            numbers += pose
        for echo in echoes:
            numbers += echo
        mean, cov, results = np.empty(size), np.empty((size, size)), np.empty(_RESULTS + OUTCOME * len(echoes))
        self._run(*memory, np.array(numbers), len(poses), mean, cov, results, self._numbers)
        values: Any = results.tolist()
        outcomes = [(int(values[k]), *values[k + 1 : k + OUTCOME]) for k in range(_RESULTS, len(values), OUTCOME)]
        return outcomes, tuple(values[:ENCODERS]), tuple(values[ENCODERS:_RESULTS]), Belief(mean, cov)


def filter_of(config: FilterConfig | None) -> CompiledFilter | None:
    """Return the compiled filter; None for a model without an update of its own, without numba, or if not wanted."""
    return CompiledFilter(config) if config and is_wanted(config.model.update) and load() else None
