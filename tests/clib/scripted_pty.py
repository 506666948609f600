"""A scripted robot on a pseudo-terminal, for programs that open a serial port."""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Iterator

from tests.nclient.scripted_line import ScriptedLine


@contextlib.contextmanager
def serve_pty(robot: ScriptedLine) -> Iterator[str]:
    """Connect the robot to a pseudo-terminal and yield the name of its device."""
    master, slave = os.openpty()
    tty.setraw(slave)

    def answer() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(master, 4096):
                robot.send(data)
                os.write(master, robot.receive())

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        # Closing the other end ends the read of the thread with an error.
        os.close(slave)
        thread.join(10)
        os.close(master)
