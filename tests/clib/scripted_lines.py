"""A scripted robot behind a pseudo-terminal, for programs that open a port; imported by name."""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Iterator

from robot_line import ScriptedLine


@contextlib.contextmanager
def on_line(robot: ScriptedLine) -> Iterator[str]:
    """The name of a pseudo-terminal behind which the robot is."""
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
        os.close(slave)
        thread.join(10)
        os.close(master)
