"""The script `nserver`, and `python -m nserver_emu`."""

import signal
import sys
from types import FrameType

from nclient.common import INTERRUPTED, exit_on_interrupt


def main() -> int:
    """Run `nserver`, and return the exit code."""
    # SIGUSR1 saves the state (--save). Before there is one, it must not end the process.
    if hasattr(signal, "SIGUSR1"):  # not on Windows
        signal.signal(signal.SIGUSR1, _ignore)
    try:
        with exit_on_interrupt():
            from nserver_emu import cli
        return cli.main()
    except KeyboardInterrupt:
        return INTERRUPTED


def _ignore(number: int, frame: FrameType | None) -> None:
    """Do nothing; unlike SIG_IGN a handler is not inherited by programs that this one starts."""


if __name__ == "__main__":
    sys.exit(main())
