"""Read code blocks of documentation pages and run their commands."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.programs.forked import run_forked

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def code_blocks(page: str, language: str) -> list[str]:
    """Return the code blocks of a page in a language, without the indentation of those in lists."""
    text = (DOCS / page).read_text(encoding="utf-8")
    # The closing fence ends a block also where the block stands indented in a list.
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    return [re.sub(rf"^{indent}", "", block, flags=re.MULTILINE) for indent, block in found]


def command_lines(page: str) -> list[str]:
    """Return the lines of the `sh` blocks of a page, continued ones joined."""
    return [line for block in code_blocks(page, "sh") for line in block.replace("\\\n", "").splitlines() if line]


def environment_with_venv() -> dict[str, str]:
    """Return the environment with this Python's programs first in PATH."""
    return os.environ | {"PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))}


def run(command: str, folder: Path, environment: Mapping[str, str] | None = None, timeout_s: float = 300) -> str:
    """Return the output of a shell command, which must succeed.

    A command that is only a call of `nomad` is forked, which saves its imports. The README's commands and
    tests/nclient/common/test_exit_codes.py start the installed programs.
    """
    environment = environment or environment_with_venv()
    # punctuation_chars splits off `;`, `|` and `>`, which only a shell understands, as it does `$`, `*` and `~`.
    lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words = list(lexer)
    if words[0] == "nomad" and not any(word[0] in "();<>|&" for word in words) and not set("$*~`") & set(command):
        done = run_forked(*words, timeout=timeout_s, cwd=folder, environment=environment)
    else:
        bash = ["bash", "-c", command]
        done = subprocess.run(bash, cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s,
                              check=False)  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout
