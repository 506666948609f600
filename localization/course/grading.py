"""Grades of submissions: each is executed in a process of its own, with limits of time and memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from localization.course.submission import SubmissionError, tasks_of
from localization.course.tasks import Task

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
