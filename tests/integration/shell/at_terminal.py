"""Run a program on a pseudo-terminal: send keys and check its output."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

ROWS, COLUMNS = 40, 160
TIMEOUT_S = 30.0
_AT_ITS_OWN = ("sh", "-c", 'tty=$1; shift; exec "$@" <"$tty" >"$tty" 2>&1', "sh")
"""Start a session with the terminal as controlling terminal, so that Ctrl-C and hang-ups become signals."""
_WHERE, _AT_THE_TOP = b"\x1b[6n", b"\x1b[2;1R"
"""A program's query for the cursor position, and the terminal's reply."""
_STYLE = re.compile(r"\x1b(?:\[[0-9;?]*[A-Za-z]|[=>]|\][^\x07]*\x07)")


class Terminal:
    """A program on a terminal.

    It runs without coverage, whose lock is never opened again where a signal comes in the middle of its own code.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str], folder: Path) -> None:
        self._ours, theirs = pty.openpty()
        # The size decides where a program breaks lines, which patterns must not depend on.
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
        environment = {**inherited, "TERM": "xterm", "EDITOR": "", "HOME": str(folder), **environment}
        self.process = subprocess.Popen(
            [*_AT_ITS_OWN, os.ttyname(theirs), *command], cwd=folder, env=environment, start_new_session=True
        )
        # Only the program has the terminal open: reads here fail once it has ended.
        os.close(theirs)
        self._raw = ""
        self._seen = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.hang_up()
        try:
            self.process.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise

    @property
    def shown(self) -> str:
        """Return its output without colours and cursor movements."""
        return _STYLE.sub("", self._raw)

    def type(self, keys: str) -> None:
        """Send these keys."""
        os.write(self._ours, keys.encode())

    def see(self, pattern: str) -> re.Match[str]:
        """Wait until new output matches a pattern."""
        deadline_s = time.monotonic() + TIMEOUT_S
        while True:
            # Output that was matched before is not searched again.
            found = re.compile(pattern, re.DOTALL).search(self.shown, self._seen)
            if found:
                self._seen = found.end()
                return found
            left_s = deadline_s - time.monotonic()
            assert left_s > 0, f"{pattern!r} was not seen in {self.shown[self._seen :]!r}"
            self._read(left_s)

    def leave(self) -> int:
        """Read until the program ends and return its exit code."""
        deadline_s = time.monotonic() + TIMEOUT_S
        while self.process.poll() is None:
            assert time.monotonic() < deadline_s, f"it does not end: {self.shown[self._seen :]!r}"
            self._read(0.1)
        return self.process.returncode

    def hang_up(self) -> None:
        """Close the terminal, like closing its window."""
        if self._ours >= 0:
            os.close(self._ours)
            self._ours = -1

    def _read(self, patience_s: float) -> None:
        if select.select([self._ours], [], [], min(patience_s, 0.5))[0]:
            try:
                data = os.read(self._ours, 65536)
            except OSError:  # the program has ended
                data = b""
            self._raw += data.decode(errors="replace")
            # prompt_toolkit waits for this reply before it shows the prompt.
            if _WHERE in data:
                os.write(self._ours, _AT_THE_TOP)
