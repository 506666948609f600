"""Adjustment of a learned map to measured lengths: runs `nomad map edit` in a process of its own.

The world is written to a file, the command writes another one, whose text is the answer to the page. The page then
replaces the world, as by loading a file, so that it can undo the step.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from nclient.common.process import NOMAD
from nserver_emu.viewer.messages import Tape

TIMEOUT_S: Final = 60.0
"""The largest map takes some seconds."""


def adjust_world(text: str, lengths: Sequence[Tape], program: Sequence[str] = NOMAD) -> dict[str, Any]:
    """Return the answer to a page: the text of a world file after the adjustment, or an error."""
    with tempfile.TemporaryDirectory(prefix="nserver-") as folder:
        before, after = Path(folder, "world.toml"), Path(folder, "adjusted.toml")
        before.write_text(text, encoding="utf-8")
        command = [*program, "map", "edit", str(before), "--out", str(after), "--json"]
        for tape in lengths:
            (x1, y1), (x2, y2) = tape.ends
            # A value that begins with a minus would be taken for an option.
            command += ["--length", f" {x1!r},{y1!r}", f" {x2!r},{y2!r}", repr(tape.length)]
        command += ["--tape-std", repr(min(tape.std for tape in lengths))]
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return {"ok": False, "error": f"nomad map edit: {error}"}
        if ended.returncode:
            lines = ended.stderr.strip().splitlines() or [f"ended with {ended.returncode}"]
            return {"ok": False, "error": lines[-1].removeprefix("nomad: ").removeprefix("nomad map: ")}
        return {"ok": True, "text": after.read_text(encoding="utf-8"), **json.loads(ended.stdout)}
