"""Helpers of all packages: files, arguments, exit codes, signals; Ctrl-C during imports, threads of numpy.

The `__main__` modules of the commands import this package before everything else, so it imports nothing slow itself:
until the block begins, Python answers Ctrl-C by a traceback.
"""

import contextlib
import os
import signal
from collections.abc import Iterator

INTERRUPTED = 130
"""ExitCode.INTERRUPTED, whose class takes longer than all that is imported here."""


@contextlib.contextmanager
def exit_on_interrupt() -> Iterator[None]:
    """Exit at once on SIGINT within this block, in which modules are imported and nothing needs a cleanup.

    An exception in the middle of an import could be swallowed by the module that is being imported. A SIGINT that is
    ignored, as in the background of a script, stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def use_one_thread() -> None:
    """Set OPENBLAS_NUM_THREADS to 1 unless it is set. Call it before numpy is imported.

    The matrices here are small. OpenBLAS would share their products among all cores, whose threads then wait for more
    at full load: a map took twice the processor time on two cores, and no less time.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
