"""Grade notebooks of the course: call the students' functions with hidden arguments.

    nomad grade 01-encoders.ipynb               points of each task, and what is wrong
    nomad grade submissions/ --seed 7 --json    all notebooks of a folder, as JSON

Each notebook is graded in a process of its own with limits of time and memory. They protect from mistakes, not from
attacks: grade notebooks that you do not trust in a container. Exit code 1: a file is no notebook of the course.
"""

import argparse
import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from textwrap import wrap
from typing import Final

from localization.course.grading import DEFAULT_SEED, Grade, Limits, SubmissionError, grade
from nclient.common.arguments import add_flag, add_value, number, whole_number
from nclient.common.process import ExitCode

CHECKPOINTS: Final = ".ipynb_checkpoints"
"""Jupyter's copies of notebooks."""
WIDTH: Final = 100
MAX_SEED: Final = 2**31 - 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("notebooks", nargs="+", type=Path, metavar="NOTEBOOK", help="notebook, or folder of notebooks")
    add_value(parser, "--seed", "N", whole_number("a seed", 0, MAX_SEED),
              "seed of the arguments; notebooks use 0 (default: a fixed other one)", DEFAULT_SEED)
    add_value(parser, "--time-limit", "S", number("a number of seconds", 0.1, 600.0), "seconds per task", 10.0)
    add_value(parser, "--memory-limit", "MB", whole_number("a number of megabytes", 256), "memory per notebook", 2048)
    add_value(parser, "--jobs", "N", whole_number("a number of processes", 1, 64), "notebooks at a time",
              os.cpu_count() or 1)
    add_flag(parser, "--json", "print JSON")


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
