"""Where `nomad` and `nserver` begin: Ctrl-C while they still import ends them with 130, and says nothing.

Rules: nothing that takes time is imported here before Ctrl-C is watched for, and so no package of ours: reading
nclient's own __init__ is most of the start. Until a command is imported there is nothing to leave in order, and the
process ends there and then: an exception could be swallowed in the middle of an import. From then on Ctrl-C is the
command's.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

INTERRUPTED = 130
"""ExitCode.INTERRUPTED, which is behind the imports."""


def nomad() -> int:
    """The command `nomad`; its exit code."""

    def imported() -> Callable[[], int]:
        from nclient.cli.main import main

        return main

    return _begin(imported)


def nserver() -> int:
    """The command `nserver`; its exit code."""

    def imported() -> Callable[[], int]:
        from nserver_emu.cli import main

        return main

    return _begin(imported)


def _begin(imported: Callable[[], Callable[[], int]]) -> int:
    """Import a command and run it. A Ctrl-C that is ignored, as in the background of a script, stays so."""
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heard:
        signal.signal(signal.SIGINT, _leave)
    try:
        main = imported()
        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return main()
    except KeyboardInterrupt:
        return INTERRUPTED


def _leave(number: int, frame: FrameType | None) -> None:
    del number, frame
    os._exit(INTERRUPTED)
