"""The functions of a student's notebook, without running the notebook.

Of the code cells only imports, definitions and simple assignments are executed: those that call nothing, or only
mathematics and what the student has defined. Drives and pictures are left out, which makes grading fast.
"""

from __future__ import annotations

import ast
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from localization.course.tasks import Task, all_tasks
from nclient.errors import NomadError

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
