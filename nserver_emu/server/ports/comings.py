"""Who opened and closed a file, in the order in which it happened, as Linux' inotify tells it.

    opened, closed, opened     ──>   changed() is True once: those who had it open are all gone, and somebody else came

Rules: the system notes an opening before whoever opened can write, and a closing before the file is let go. So who
reads the file first, and then asks here, never takes the next one's bytes for the last one's. Two openings, or two
closings, between two looks can be told as one: the first may make a change too many, the second hides one, until
`forget`. Elsewhere than on Linux nothing is told.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from typing import Final

log = logging.getLogger(__name__)

_CLOSED_WRITE, _CLOSED, _OPENED, _LOST = 0x8, 0x10, 0x20, 0x4000
_FIELDS: Final = 4
"""Of 32 bits in each notice: watch, event, cookie, length of a name, which is 0 where a file is watched."""
_NOTICES: Final = 65536
"""Bytes of what is told at once."""


class Comings:
    """See the head of this file. `fd` is readable when there is something to ask for; -1 where nothing is told."""

    def __init__(self) -> None:
        self.fd = -1
        self._watch = -1
        self._present = 0
        self._deserted = self._changed = False
        if sys.platform == "linux":
            self._libc = ctypes.CDLL(None, use_errno=True)
            self.fd = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            if self.fd < 0:
                log.warning("a host that comes at once after another will not be told from it: %s; "
                            "fs.inotify.max_user_instances may be too small", os.strerror(ctypes.get_errno()))

    def watch(self, path: str) -> None:
        """From now on it is about this file, which nobody has open."""
        self.forget()
        if self.fd >= 0:
            events = _CLOSED_WRITE | _CLOSED | _OPENED
            self._watch = self._libc.inotify_add_watch(self.fd, os.fsencode(path), events)

    def changed(self) -> bool:
        """Whether all who had it open are gone and somebody else came, since this was asked last."""
        self._look()
        changed, self._changed = self._changed, False
        return changed

    def forget(self) -> None:
        """Nobody has it open; whatever was told before is of no interest."""
        self._look()
        self._present = 0
        self._deserted = self._changed = False

    def close(self) -> None:
        """The end; twice is fine."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def _look(self) -> None:
        if self.fd < 0:
            return
        try:
            told = os.read(self.fd, _NOTICES)
        except BlockingIOError:
            return
        fields = memoryview(told).cast("i")
        for watch, event in zip(fields[::_FIELDS], fields[1::_FIELDS], strict=True):
            if event & _LOST:
                self._changed = True
            elif watch == self._watch:
                self._note(event)

    def _note(self, event: int) -> None:
        if event & _OPENED:
            self._changed |= self._deserted
            self._deserted = False
            self._present += 1
        elif event & (_CLOSED | _CLOSED_WRITE):
            self._present = max(0, self._present - 1)
            self._deserted = not self._present
