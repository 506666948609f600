"""Every printed line that installs something works in a clone: the package is in no registry."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator

import pytest

from tests.docs.pages import DOCS, ROOT

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
FOLDERS = (
    "docs", "nclient", "nserver_emu", "localization", "worlds", "clib", "scripts", "benchmarks", "examples", "fuzz",
)
PROGRAMS = ("nclient/common/arguments.py", "scripts/venv")
"""Files that make an install line of variables."""
SUFFIXES = (".md", ".py", ".ipynb", ".toml", ".sh", "")
INSTALL = re.compile(r"pip install (?P<rest>[^`\n\"]+)")
# A clone is installed as `.`, or as `'.[extra]'` in quotes, which a shell would otherwise expand.
FROM_CLONE = re.compile(r"(?:-e )?(?:\.(?![\w\[])|'\.\[(?P<extras>[\w,]+)\]')")


def install_lines() -> Iterator[tuple[str, str]]:
    """Yield every file with `pip install`, and what follows the words there."""
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in SUFFIXES]
    for path in (*ROOT.glob("*.md"), *(path for path in files if path.is_file())):
        if path.relative_to(ROOT).as_posix() in PROGRAMS or "build" in path.parts:
            continue
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        yield from ((str(path.relative_to(ROOT)), found["rest"]) for found in INSTALL.finditer(text))


LINES = sorted(set(install_lines()))


def test_lines_are_found() -> None:
    assert {"docs/start.md", "docs/window.md", "docs/service.md"} <= {file for file, _ in LINES}


@pytest.mark.parametrize(("file", "rest"), LINES)
def test_install_line_works_in_a_clone(file: str, rest: str) -> None:
    found = FROM_CLONE.match(rest)
    assert found, f"{file}: pip install {rest}: the package is in no registry: pip install -e '.[EXTRA]'"
    # EXTRA stands for any of them.
    assert set((found["extras"] or "").split(",")) - {"", "EXTRA"} <= set(EXTRAS)


def test_extras_named_in_prose_exist() -> None:
    pages = [*ROOT.glob("*.md"), *DOCS.rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"\bextras? `([\w]+)`", page.read_text(encoding="utf-8"))}
    assert "viewer" in named
    assert named <= set(EXTRAS)


def test_notebooks_extra_brings_jupyter_and_their_imports() -> None:
    notebooks = [json.loads(path.read_text(encoding="utf-8")) for path in DOCS.rglob("*.ipynb")]
    assert notebooks
    assert any(requirement.startswith("jupyterlab") for requirement in EXTRAS["notebook"])
    assert any("[plot]" in requirement for requirement in EXTRAS["notebook"])
