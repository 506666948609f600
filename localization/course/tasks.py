"""Tasks of the course: a check calls the student's function with random arguments and explains what is wrong.

A check is a function of the name of the task. It gets the answer and a random generator, and raises `Wrong`:

    @task("01", points=2)
    def step_pose(answer, rng): ...

Notebooks check with the seed 0, `nomad grade` with others.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from nclient.errors import NomadError, suggest

Answer = Callable[..., Any]
Rng = np.random.Generator
Mistakes = Sequence[tuple[Any, str]]
"""What typical mistakes return, and what to say about each."""

TRIES: Final = 12
"""Calls of an answer by most checks."""
MODULES: Final = ("sensors", "estimation")
MAX_SHOWN: Final = 6
"""Longer arrays are abbreviated in messages."""


class Wrong(Exception):
    """An answer is wrong; the message explains and hints."""


class NoSuchTask(NomadError, LookupError):
    """The course has no task of this name."""

    usage = True


@dataclass(frozen=True, slots=True)
class Task:
    """A function that a student writes: number of the notebook, name, points and check."""

    notebook: str
    name: str
    points: int
    check: Callable[[Answer, Rng], None]


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of a check; in a notebook it shows itself."""

    name: str
    passed: bool
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {'right' if self.passed else 'not yet'}. {self.text}".strip()

    __repr__ = __str__


_TASKS: dict[str, Task] = {}


def task(notebook: str, points: int = 1) -> Callable[[Callable[[Answer, Rng], None]], Callable[[Answer, Rng], None]]:
    """Return a decorator that makes a check the task of its name."""

    def register(check: Callable[[Answer, Rng], None]) -> Callable[[Answer, Rng], None]:
        _TASKS[check.__name__] = Task(notebook, check.__name__, points, check)
        return check

    return register


@cache
def all_tasks() -> dict[str, Task]:
    """Return the tasks of all notebooks by name, in their order."""
    for module in MODULES:
        import_module(f"localization.course.{module}")
    return _TASKS


def check(answer: Answer, name: str = "", seed: int = 0) -> Verdict:
    """Check a student's function.

    Parameters
    ----------
    answer
        The function.
    name
        Name of the task; default: that of the function.
    seed
        Of the random arguments.
    """
    name = name or getattr(answer, "__name__", "")
    tasks = all_tasks()
    if name not in tasks:
        raise NoSuchTask(f"the course has no task {name!r}{suggest(name, tasks)}")
    return verdict(tasks[name], answer, seed)


def verdict(task: Task, answer: Answer, seed: int) -> Verdict:
    """Return the verdict on an answer, whatever it does."""
    try:
        # Answers may divide by zero before they return a right result.
        with np.errstate(all="ignore"):
            task.check(answer, np.random.default_rng(seed))
    except Wrong as wrong:
        return Verdict(task.name, False, str(wrong))
    return Verdict(task.name, True, "")


def call(answer: Answer, *arguments: Any) -> Any:
    """Return the result of an answer. Raises Wrong if it raises, or returns nothing."""
    try:
        # Answers may change their arguments; a generator goes on where it is.
        result = answer(*[each if isinstance(each, Rng) else copy.deepcopy(each) for each in arguments])
    except NotImplementedError:
        raise Wrong("It is not written yet: replace `raise NotImplementedError`.") from None
    except NameError as error:
        raise Wrong(
            f"{_shown_call(arguments)} raised NameError: {error}. Names must be arguments, be defined in the "
            "function or by simple statements outside of it."
        ) from None
    except Exception as error:  # noqa: BLE001  an answer may raise anything
        raise Wrong(f"{_shown_call(arguments)} raised {type(error).__name__}: {error}") from None
    if result is None:
        raise Wrong(f"{_shown_call(arguments)} returned None: does the function end with `return`?")
    return result


def numbers(answer: Answer, *arguments: Any, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Return the result of an answer as an array of a shape. Raises Wrong if it is none, or not finite."""
    result = call(answer, *arguments)
    found = _as_array(result, arguments)
    if found.squeeze().shape != tuple(size for size in shape if size != 1):
        expected = "one number" if not shape else f"{' x '.join(map(str, shape))} numbers"
        raise Wrong(
            f"{_shown_call(arguments)} returned {_shown(result)}, of the shape {found.shape}; expected {expected}."
        )
    if np.isnan(found).any():
        raise Wrong(
            f"{_shown_call(arguments)} returned {_shown(result)}: not a number (NaN). Is something divided by "
            "zero, or is a logarithm taken of 0?"
        )
    return found.reshape(shape)


def truth_value(answer: Answer, *arguments: Any) -> bool:
    """Return the result of an answer as True or False. Raises Wrong if it is neither."""
    result = call(answer, *arguments)
    if isinstance(result, np.ndarray) and result.size == 1:
        result = result.item()
    if not isinstance(result, (bool, int, np.bool_, np.integer)):
        raise Wrong(f"{_shown_call(arguments)} returned {_shown(result)}; expected True or False.")
    return bool(result)


def expect(answer: Answer, arguments: tuple[Any, ...], right: Any, tolerance: Any, *, angles: Sequence[int] = (),
           mistakes: Mistakes = (), hint: str = "") -> None:  # fmt: skip
    """Raise Wrong unless an answer returns the right numbers.

    Parameters
    ----------
    arguments
        Of the call.
    right
        Number, or numbers of any shape.
    tolerance
        Largest difference, a number or one for each.
    angles
        Indices of numbers that are angles in radians, equal modulo a turn.
    mistakes
        Results of typical mistakes, each with its hint.
    hint
        For other results.
    """
    right = np.asarray(right, dtype=np.float64)
    found = numbers(answer, *arguments, shape=right.shape)
    if _is_near(found, right, tolerance, angles):
        return
    for value, about in mistakes:
        wrong = np.asarray(value, dtype=np.float64)
        if wrong.shape == right.shape and _is_near(found, wrong, tolerance, angles):
            hint = about
            break
    raise Wrong(f"{_shown_call(arguments)} returned {_shown(found)}; expected {_shown(right)}. {hint}".strip())


class Part(NamedTuple):
    """One of two results: the right numbers, and the other arguments of `expect`."""

    right: Any
    tolerance: Any
    hint: str
    mistakes: Mistakes


def expect_two(answer: Answer, arguments: tuple[Any, ...], wanted: str, *parts: Part) -> None:
    """Raise Wrong, with the text `wanted`, unless an answer returns two results, and unless both are right."""
    result = call(answer, *arguments)
    require(isinstance(result, (tuple, list)) and len(result) == 2, wanted)
    for found, (right, tolerance, hint, mistakes) in zip(result, parts, strict=True):
        expect(lambda *_, found=found: found, arguments, right, tolerance, mistakes=mistakes, hint=hint)


def require(condition: object, message: str) -> None:
    """Raise Wrong with a message unless a condition holds."""
    if not condition:
        raise Wrong(message)


def _is_near(found: Any, right: Any, tolerance: Any, angles: Sequence[int]) -> bool:
    # Infinite numbers must be infinite in both; their difference would not be a number.
    same = np.isinf(found) & np.isinf(right) & (np.sign(found) == np.sign(right))
    difference = np.where(same, 0.0, np.asarray(found) - right)
    for index in angles:
        flat = difference.reshape(-1)
        flat[index] = (flat[index] + np.pi) % (2.0 * np.pi) - np.pi
    return bool((np.abs(difference) <= tolerance).all())


def _as_array(result: Any, arguments: tuple[Any, ...]) -> npt.NDArray[np.float64]:
    try:
        return np.asarray(result, dtype=np.float64)
    except (TypeError, ValueError):
        raise Wrong(f"{_shown_call(arguments)} returned {_shown(result)}; expected numbers.") from None


def _shown_call(arguments: tuple[Any, ...]) -> str:
    return f"For ({', '.join(map(_shown, arguments))}) it"


def _shown(value: Any) -> str:
    """Return a value as text, long ones abbreviated."""
    if isinstance(value, np.random.Generator):
        return "rng"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple, np.ndarray)):
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            return repr(value)[:120]
        return np.array2string(array, precision=4, suppress_small=True, threshold=MAX_SHOWN * 3, edgeitems=2,
                               separator=", ").replace("\n", "")
    return repr(value)[:120]
