"""Grades of submissions: each is executed in a process of its own, with limits of time and memory.

The notebook as a whole is not run. Of its code cells only imports, definitions and simple assignments are executed:
those that call nothing, or only mathematics and what the student has defined. Drives and pictures are left out, which
makes grading fast.

The process that executes the functions of one submission, with limits; `grading` starts it.

    python -m localization.course.grading FILE SEED SECONDS MEGABYTES TASK...

Prints a JSON line per task. What the student's code prints goes nowhere. The limits protect from mistakes, not from
attacks.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from types import FrameType
from typing import Any, Final

from localization.course.tasks import Task, Verdict, all_tasks, verdict
from nclient.common.arguments import add_flag, add_value, number, whole_number
from nclient.common.process import ExitCode
from nclient.errors import NomadError

MAX_TEXT: Final = 2000
"""Characters of an explanation: an exception may quote a whole array."""


class TimeLimit(BaseException):
    """The time of a task is over. No Exception: `except Exception` of a student must not catch it."""


def _stop(_number: int, _frame: FrameType | None) -> None:
    raise TimeLimit


@contextlib.contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    signal.signal(signal.SIGALRM, _stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def load(path: Path, limit_s: float) -> tuple[dict[str, Any], str]:
    """Return the names that a submission defines, and the first error."""
    selected, errors = statements(read_cells(path))
    values: dict[str, Any] = {"__name__": "submission"}
    for node in selected:
        try:
            with _time_limit(limit_s):
                exec(compile(ast.Module([node], []), str(path), "exec"), values)
        except (Exception, SystemExit, TimeLimit) as error:  # noqa: BLE001  whatever a student writes
            # Values of drives are missing, since drives are not executed: no mistake of the student.
            if isinstance(error, NameError) and not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            errors.append(f"Line {node.lineno} of a cell raised {type(error).__name__}: {error}")
    return values, errors[0] if errors else ""


def judge(values: dict[str, Any], name: str, seed: int, limit_s: float, error: str) -> Verdict:
    """Return the verdict on one task."""
    answer = values.get(name)
    if not callable(answer):
        return Verdict(name, False, f"There is no function {name}. {error}".strip())
    try:
        with _time_limit(limit_s):
            return verdict(all_tasks()[name], answer, seed)
    except TimeLimit:
        return Verdict(name, False, f"It takes longer than {limit_s:g} s: is there a loop without an end?")
    except (Exception, SystemExit, KeyboardInterrupt) as raised:  # noqa: BLE001  a result of any type may do so
        return Verdict(name, False, f"The check failed with {type(raised).__name__}: {raised}")


def main(words: list[str]) -> int:
    """Judge the tasks, and print a line for each."""
    import resource  # not on Windows, where `nomad grade` is not offered

    file, seed, limit_s, megabytes, *names = words
    # Results have a copy of stdout; the student's code gets none.
    results = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    all_tasks()
    process = os.getpid()
    resource.setrlimit(resource.RLIMIT_AS, (int(megabytes) << 20,) * 2)
    values, error = load(Path(file), float(limit_s))
    for name in names:
        found = judge(values, name, int(seed), float(limit_s), error)
        # A copy of this process, by os.fork in an answer, ends: the first one reports.
        if os.getpid() != process:
            os._exit(0)
        print(json.dumps({"name": name, "passed": found.passed, "text": found.text[:MAX_TEXT]}), file=results)
    results.flush()
    # Threads and handlers of the student's code do not delay the end.
    os._exit(0)


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
    command = [sys.executable, "-m", "localization.course.grading", *words]
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


CHECKPOINTS: Final = ".ipynb_checkpoints"
"""Jupyter's copies of notebooks."""
WIDTH: Final = 100
MAX_SEED: Final = 2**31 - 1


class GradeCommand:
    """Grade notebooks of the course: call the students' functions with hidden arguments.

        nomad grade 01-encoders.ipynb               points of each task, and what is wrong
        nomad grade submissions/ --seed 7 --json    all notebooks of a folder, as JSON

    Each notebook is graded in a process of its own with limits of time and memory. They protect from mistakes, not from
    attacks: grade notebooks that you do not trust in a container. Exit code 1: a file is no notebook of the course.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument("notebooks", nargs="+", type=Path, metavar="NOTEBOOK",
                            help="notebook, or folder of notebooks")
        add_value(parser, "--seed", "N", whole_number("a seed", 0, MAX_SEED),
                  "seed of the arguments; notebooks use 0 (default: a fixed other one)", DEFAULT_SEED)
        add_value(parser, "--time-limit", "S", number("a number of seconds", 0.1, 600.0), "seconds per task", 10.0)
        add_value(parser, "--memory-limit", "MB", whole_number("a number of megabytes", 256),
                  "memory per notebook", 2048)
        add_value(parser, "--jobs", "N", whole_number("a number of processes", 1, 64), "notebooks at a time",
                  os.cpu_count() or 1)
        add_flag(parser, "--json", "print JSON")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Run the command and return its exit code."""
        files = [file for path in options.notebooks for file in find_notebooks(path)]
        limits = Limits(options.time_limit, options.memory_limit)
        grades = []
        with ThreadPoolExecutor(options.jobs) as pool:
            # Results appear in the order of the files, as soon as they are there.
            for each in pool.map(lambda file: grade(file, options.seed, limits), files):
                grades.append(each)
                if not options.json:
                    print(format_grade(each), flush=True)
        if options.json:
            print(json.dumps({"seed": options.seed, "submissions": [each.to_json() for each in grades]}))
        elif len(grades) > 1:
            print(format_summary(grades))
        return ExitCode.FAILED if any(each.error for each in grades) else ExitCode.DONE


def find_notebooks(path: Path) -> list[Path]:
    """Return a file, or the notebooks in a folder and those below it. Raises SubmissionError if there are none."""
    if not path.is_dir():
        return [path]
    found = [file for file in sorted(path.rglob("*.ipynb")) if CHECKPOINTS not in file.parts]
    if not found:
        raise SubmissionError(f"{path}: there is no notebook in this folder; expected files that end in .ipynb")
    return found


def format_grade(grade: Grade) -> str:
    """Return a grade as a table: a row per task, with an explanation."""
    if grade.error:
        return f"{grade.error}\n"
    width = max(len(mark.task.name) for mark in grade.marks)
    lines = [f"{grade.file}: {grade.points} of {grade.maximum} points"]
    for mark in grade.marks:
        first, *others = wrap(mark.text, WIDTH - width - 9) or [""]
        lines.append(f"  {mark.task.name:{width}}  {mark.points}/{mark.task.points}  {first}".rstrip())
        lines += [" " * (width + 9) + line for line in others]
    return "\n".join(lines) + "\n"


def format_summary(grades: list[Grade]) -> str:
    """Return a table with a row per submission."""
    width = max(len(str(each.file)) for each in grades)
    return "\n".join(
        f"{each.file!s:{width}}  " + (f"{each.points:3} of {each.maximum}" if not each.error else "not graded")
        for each in grades
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
