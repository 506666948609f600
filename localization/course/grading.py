"""Grades of submissions: each is executed in a process of its own, with limits of time and memory.

The notebook as a whole is not run. Of its code cells only imports, definitions and simple assignments are executed:
those that call nothing, or only mathematics and what the student has defined. Drives and pictures are left out, which
makes grading fast.
"""

from __future__ import annotations

import ast
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from localization.course.tasks import Task, all_tasks
from nclient.errors import NomadError

DEFAULT_SEED: Final = 20_260
"""Other arguments than in the notebooks, whose seed is 0."""
START_S: Final = 30.0
"""Time to start a process on a busy machine."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one submission: seconds per task, memory in MiB."""

    seconds: float = 10.0
    megabytes: int = 2048


@dataclass(frozen=True, slots=True)
class Mark:
    """Points of one task, and why."""

    task: Task
    points: int
    text: str


@dataclass(frozen=True, slots=True)
class Grade:
    """Result of one submission; `error` if it cannot be graded."""

    file: Path
    marks: tuple[Mark, ...] = ()
    error: str = ""

    @property
    def points(self) -> int:
        """Points reached."""
        return sum(mark.points for mark in self.marks)

    @property
    def maximum(self) -> int:
        """Points that can be reached."""
        return sum(mark.task.points for mark in self.marks)

    def to_json(self) -> dict[str, Any]:
        """Return the grade as plain data."""
        tasks = [{"name": mark.task.name, "points": mark.points, "of": mark.task.points, "text": mark.text}
                 for mark in self.marks]  # fmt: skip
        notebook = self.marks[0].task.notebook if self.marks else None
        return {"file": str(self.file), "notebook": notebook, "points": self.points, "of": self.maximum,
                "tasks": tasks, "error": self.error}  # fmt: skip


def grade(file: Path, seed: int = DEFAULT_SEED, limits: Limits | None = None) -> Grade:
    """Return the grade of a notebook.

    Parameters
    ----------
    file
        A notebook of the course, or a Python file with its functions.
    seed
        Of the arguments with which the functions are called.
    limits
        Of time and memory.
    """
    limits = limits or Limits()
    try:
        tasks = tasks_of(file)
    except SubmissionError as error:
        return Grade(file, error=str(error))
    marks: dict[str, Mark] = {}
    while pending := [task for task in tasks if task.name not in marks]:
        # 1. All that is left, in one process.
        found, ended = _run(file, seed, limits, pending)
        for task in pending:
            if task.name in found:
                passed, text = found[task.name]
                marks[task.name] = Mark(task, task.points if passed else 0, text)
        # 2. The process ended before all were judged: the next task ended it.
        unjudged = next((task for task in pending if task.name not in marks), None)
        if unjudged:
            marks[unjudged.name] = Mark(unjudged, 0, ended)
    return Grade(file, tuple(marks[task.name] for task in tasks))


def _run(file: Path, seed: int, limits: Limits, tasks: list[Task]) -> tuple[dict[str, tuple[bool, str]], str]:
    """Return verdicts by task, and how the process ended."""
    words = [str(file), str(seed), str(limits.seconds), str(limits.megabytes), *(task.name for task in tasks)]
    command = [sys.executable, "-m", "localization.course.worker", *words]
    # Threads of numerical libraries reserve memory, and would wait for one another.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    limit_s = START_S + 2 * limits.seconds * (len(tasks) + 1)
    # Verdicts go to a file: a pipe would remain open as long as any process that an answer started.
    with tempfile.TemporaryFile() as output:
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, env=environment,
                              start_new_session=True) as process:  # fmt: skip
            try:
                code = process.wait(limit_s)
                reason = ": out of memory?" if code < 0 else "."
                ended = f"It ended the process that graded it (exit code {code}){reason}"
            except subprocess.TimeoutExpired:
                ended = f"It cannot be stopped after {limits.seconds:g} s."
            finally:
                # The process and those that answers started.
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
        output.seek(0)
        found = {}
        for line in output.read().decode(errors="replace").splitlines():
            # The last line is incomplete if the process was killed while it wrote.
            with suppress(ValueError):
                judged = json.loads(line)
                found[judged["name"]] = judged["passed"], judged["text"]
    return found, ended


MAGIC: Final = re.compile(r"^\s*[%!].*$", re.MULTILINE)
"""Commands of Jupyter, which are no Python."""
HARMLESS: Final = frozenset(
    {"np", "numpy", "math", "functools", "operator", "abs", "dict", "float", "int", "len", "list", "max", "min",
     "range", "set", "sum", "tuple", "zip"}
)  # fmt: skip
"""Names that a simple assignment may call."""


class SubmissionError(NomadError):
    """A file is no notebook; the message says what was found."""


def read_cells(path: Path) -> list[str]:
    """Return the code cells of a notebook, or the text of a Python file as one. Raises SubmissionError."""
    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".py":
            return [text]
        cells = json.loads(text)["cells"]
        sources = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
        return [source if isinstance(source, str) else "".join(source) for source in sources]
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no notebook (JSON with cells)"
        raise SubmissionError(f"{path}: cannot be read: {reason}") from error


def statements(cells: Iterable[str]) -> tuple[list[ast.stmt], list[str]]:
    """Return the statements that grading executes, in order, and the errors of cells that are no Python."""
    selected: list[ast.stmt] = []
    errors: list[str] = []
    defined: set[str] = set()
    for cell in cells:
        try:
            tree = ast.parse(MAGIC.sub("", cell))
        except (SyntaxError, ValueError) as error:
            errors.append(f"A cell is no Python: {error}")
            continue
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                defined.add(node.name)
                selected.append(node)
            elif isinstance(node, ast.Import | ast.ImportFrom) or _is_simple(node, defined):
                selected.append(node)
    return selected, errors


def _is_simple(node: ast.stmt, defined: set[str]) -> bool:
    """Return True for an assignment that calls nothing but mathematics and functions of the student."""
    if not isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign) or node.value is None:
        return False
    for each in _evaluated(node.value):
        if isinstance(each, ast.Call):
            root: Any = each.func
            while isinstance(root, ast.Attribute):
                root = root.value
            if not isinstance(root, ast.Name) or root.id not in HARMLESS | defined:
                return False
    return True


def _evaluated(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of an expression that an assignment evaluates: not the body of a lambda."""
    yield node
    for child in () if isinstance(node, ast.Lambda) else ast.iter_child_nodes(node):
        yield from _evaluated(child)


def names(selected: Iterable[ast.stmt]) -> set[str]:
    """Return the names that statements define."""
    found = set()
    for node in selected:
        if isinstance(node, ast.FunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


def tasks_of(path: Path) -> list[Task]:
    """Return the tasks of the notebook of the course that a submission answers: the one with most of its functions.

    Raises
    ------
    SubmissionError
        If it has none of them.
    """
    # A cell that is no Python still names its functions.
    cells = read_cells(path)
    defined = names(statements(cells)[0]) | set(re.findall(r"^def (\w+)", "\n".join(cells), re.MULTILINE))
    counts = Counter(task.notebook for task in all_tasks().values() if task.name in defined)
    if not counts:
        raise SubmissionError(f"{path}: none of the functions of the course is defined in it")
    notebook = counts.most_common(1)[0][0]
    return [task for task in all_tasks().values() if task.notebook == notebook]
