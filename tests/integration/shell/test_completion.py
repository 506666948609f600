"""Completion scripts in real shells: Tab in bash and zsh at a terminal, and fish's `complete -C`."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.shell.at_terminal import Terminal

BIN = str(Path(sys.executable).parent)
TAB, TO_THE_BEGINNING = "\t", "\x01"
CASES = {
    "nomad doc": "nomad doctor",
    "nomad state --wa": "nomad state --watch",
    "nomad wire encode --line ser": "nomad wire encode --line serial",
    "nomad doctor sim:the": "nomad doctor sim:thesis_room",
    "nomad stop nser": "nomad stop nserver://localhost:7019/1",
    "nomad state sim: son": "nomad state sim: sonar",
    "nomad localize sim: --map sev": "nomad localize sim: --map several_walls",
    "nomad shell --script squ": "nomad shell --script square.nomad",
    "nserver --lock": "nserver --lockstep",
    "nserver --robot sc": "nserver --robot scout",
    "nserver --setup meas": "nserver --setup measured",
    "nserver thesis": "nserver thesis_room",
    "nserver ctl pau": "nserver ctl pause",
    "nserver ctl --js": "nserver ctl --json",
    "nserver ctl --po": "nserver ctl --po",
    "nserver ctl faults sh": "nserver ctl faults show",
    "nserver ctl faults sta": "nserver ctl faults sta",
    "nserver ctl faults set squ": "nserver ctl faults set square.nomad",
    "nserver ctl --control ./x world set th": "nserver ctl --control ./x world set thesis_room",
    "nserver ctl noise sensors=me": "nserver ctl noise sensors=measured",
    "nserver ctl speed m": "nserver ctl speed max",
    "nserver hel": "nserver help",
    "nserver help c": "nserver help ctl",
    "nserver thesis_room --lock": "nserver thesis_room --lockstep",
    "nomad wire encode pre": "nomad wire encode predict_sensors",
    "nomad wire decode --call conf_l": "nomad wire decode --call conf_ls",
    "nomad help wi": "nomad help wire",
    "nserver --restore squ": "nserver --restore square.nomad",
}
NOT_IN_ZSH = {"nomad state sim: son"}
"""Where shtab's script for zsh completes the first word alone."""
# Words of bash end at : and = by default; docs/shell.md has this setting.
START = {
    "bash": (
        ["bash", "--norc", "--noprofile", "-i"],
        'PS1="ready> "; bind "set enable-bracketed-paste off"; COMP_WORDBREAKS=${COMP_WORDBREAKS//[:=]/}',
    ),
    "zsh": (["zsh", "-f", "-i"], 'PS1="ready> "; autoload -U compinit; compinit -u -D; setopt no_beep'),
}


@pytest.mark.parametrize("shell", START)
def test_tab_completion(shell: str, tmp_path: Path) -> None:
    assert shutil.which(shell), f"{shell} is missing: scripts/test installs it"
    (tmp_path / "square.nomad").write_text("st\n")
    command, settings = START[shell]
    with Terminal(command, {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}, tmp_path) as terminal:
        # "settled" is printed by the shell itself, so the echo of the typed line does not match.
        terminal.type(f'{settings}; eval "$(nomad completion {shell})"; echo set"tled"\r')
        terminal.see("settled.*ready> ")
        for typed, completed in CASES.items():
            if shell == "zsh" and typed in NOT_IN_ZSH:
                continue
            terminal.type(typed + TAB)
            # The completed line is printed instead of executed.
            terminal.type(TO_THE_BEGINNING + "echo \r")
            terminal.see(rf"\n{completed} ?\r.*ready> ")
        terminal.type("exit\r")
        assert terminal.leave() == 0


def test_fish_completion(tmp_path: Path) -> None:
    assert shutil.which("fish"), "fish is missing: scripts/test installs it"
    (tmp_path / "square.nomad").write_text("st\n")
    asked = "".join(f"echo '> {typed}'; complete -C '{typed}'\n" for typed in CASES)
    script = f"{BIN}/nomad completion fish | source\n{asked}"
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "HOME": str(tmp_path)}
    done = subprocess.run(
        ["fish", "--no-config", "-c", script],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    blocks = (block.splitlines() for block in done.stdout.split("> ")[1:])
    reason = {typed: [line.partition("\t")[0] for line in lines] for typed, *lines in blocks}
    assert reason == {
        typed: [completed.rpartition(" ")[2]] if completed != typed else [] for typed, completed in CASES.items()
    }


@pytest.mark.parametrize(("words", "reason"), [
    (["completion", "tcsh"], "no 'tcsh'; there are bash, zsh, fish"),
    (["completion", "bash", "nsever"], "no program 'nsever'; there are nomad, nserver"),
])
def test_completion_errors(words: list[str], reason: str) -> None:
    command = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert reason in done.stderr
