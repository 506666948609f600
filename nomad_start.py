"""Entry points of the scripts `nomad` and `nserver`: Ctrl-C during the imports exits with 130, without a traceback.

A top-level module, because importing any module of `nclient` first imports the package, which takes most of the start:
nothing slow may be imported before the handler is installed. Until the command is imported there is nothing to clean
up, and the process exits at once; an exception could be swallowed in the middle of an import. Afterwards the command
handles Ctrl-C itself.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

INTERRUPTED = 130
"""ExitCode.INTERRUPTED, which cannot be imported before the handler is installed."""


def nomad() -> int:
    """Run `nomad`, and return the exit code."""

    def import_main() -> Callable[[], int]:
        from nclient.cli.main import main

        return main

    return _begin(import_main)


def nserver() -> int:
    """Run `nserver`, and return the exit code."""

    def import_main() -> Callable[[], int]:
        from nserver_emu.cli import main

        return main

    return _begin(import_main)


def _begin(import_main: Callable[[], Callable[[], int]]) -> int:
    """Import a command and run it. A SIGINT that is ignored, as in the background of a script, stays ignored."""
    is_handled = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_handled:
        signal.signal(signal.SIGINT, _exit_at_once)
    try:
        main = import_main()
        if is_handled:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return main()
    except KeyboardInterrupt:
        return INTERRUPTED


def _exit_at_once(number: int, frame: FrameType | None) -> None:
    del number, frame
    os._exit(INTERRUPTED)
