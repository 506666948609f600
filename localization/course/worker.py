"""The process that executes the functions of one submission, with limits; `grading` starts it.

    python -m localization.course.worker FILE SEED SECONDS MEGABYTES TASK...

Prints a JSON line per task. What the student's code prints goes nowhere. The limits protect from mistakes, not from
attacks.
"""

from __future__ import annotations

import ast
import contextlib
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Final

from localization.course.grading import read_cells, statements
from localization.course.tasks import Verdict, all_tasks, verdict

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


def limit_memory(megabytes: int) -> None:
    """Limit the memory of this process."""
    import resource  # not on Windows, where `nomad grade` is not offered

    resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))


def main(words: list[str]) -> int:
    """Judge the tasks, and print a line for each."""
    file, seed, limit_s, megabytes, *names = words
    # Results have a copy of stdout; the student's code gets none.
    results = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    all_tasks()
    process = os.getpid()
    limit_memory(int(megabytes))
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
