"""The script `nomad`, and `python -m nclient.cli`."""

import sys

from nclient.common import INTERRUPTED, exit_on_interrupt, use_one_thread


def main() -> int:
    """Run `nomad`, and return the exit code."""
    try:
        use_one_thread()
        with exit_on_interrupt():
            from nclient.cli import main as command
        return command.main()
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
