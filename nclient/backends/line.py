"""Questions and answers on a robot's line, which numbers neither: whose answer is it that comes?

    owed:  gs get_rv pr          a get_rv comes: it is that one's, the gs is lost; a gs comes: the gs was only late

Rules: a robot answers in the order in which it was asked, and a line never changes an order. So a frame is laid to
the earliest question of its type that is still owed an answer, and whatever was asked before that is lost; the last
question has its answer when nothing is owed any more. Bytes and types only; what they mean is direct.py's.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from nclient.backends.statistics import LinkStatistics
from nclient.errors import ReplyTimeout
from nclient.protocol.commands import NAK_TYPE
from nclient.protocol.serial_frame import SMALLEST_FRAME, SerialFrame, SerialFramer
from nclient.transports.byte_stream import ByteStream, Deadline

GAP_S = 0.25
"""Silence within an answer after which no more of it comes: bytes are 0.3 ms apart, a radio modem's bursts 0.1 s."""
QUIET_S = 2.0
"""Silence after which a late answer comes no more, where there is no other way to know."""
_LONGEST_QUIET_S = 10.0
_FLUSHES = 64
"""Pieces of input thrown away before a question; a line that babbles on is asked all the same."""


class Line:
    """One end of a line. `clock`: seconds, of which every wait and every latency is."""

    def __init__(self, stream: ByteStream, link: LinkStatistics, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream
        self._link = link
        self._clock = clock
        self._framer = SerialFramer()
        self._owed: list[int] = []
        self._asked_s = 0.0

    def deadline(self, seconds: float) -> Deadline:
        """So many seconds from now."""
        return Deadline.after(seconds, self._clock)

    def owes(self, frame_type: int | None) -> bool:
        """Whether an answer of this type may still come late."""
        return frame_type in self._owed

    def ask(self, frame_type: int, request: bytes, patience_s: float) -> SerialFrame:
        """Send a question and give the frame that answers it, or a NAK. Raises ReplyTimeout and ConnectionLost.

        Nothing of this type should be owed: else its late answer is waited for and dropped first.
        """
        self.empty_input()
        self._owed.append(frame_type)
        self._link.exchanges += 1
        self._asked_s = self._clock()
        self._stream.send(request)
        try:
            return self._answer(patience_s)
        finally:
            self._count()

    def took(self) -> None:
        """The last answer is believed: count it, and the time that it took."""
        self._link.took(self._clock() - self._asked_s)

    def send(self, frame_type: int, request: bytes) -> None:
        """Send something whose answer nobody waits for, and which stays owed."""
        self._owed.append(frame_type)
        self._stream.send(request)

    def receive_bare(self, size: int, deadline: Deadline) -> bytes:
        """So many bytes that are no frame; as many as there are at the deadline."""
        data = b""
        try:
            while len(data) < size:
                data += self._stream.receive(deadline)
        except ReplyTimeout:
            pass
        return data[:size]

    def empty_input(self) -> None:
        """Take what has come, so that it answers nothing that is asked from now on."""
        try:
            for _ in range(_FLUSHES):
                for frame in self._framer.receive(self._stream.receive(self.deadline(0))):
                    self._is_awaited(frame)
                    self._link.strays += 1
        except ReplyTimeout:
            pass
        self._framer.clear()
        self._count()

    def wait_for_quiet(self) -> None:
        """Wait until what is late comes no more; then nothing is owed. Raises ReplyTimeout on a line that babbles."""
        limit = self.deadline(_LONGEST_QUIET_S)
        while limit.remaining():
            try:
                self._stream.receive(self.deadline(QUIET_S))
            except ReplyTimeout:
                self._owed.clear()
                return
        raise ReplyTimeout("the line is never quiet")

    def close(self) -> None:
        """Let the stream go."""
        self._stream.close()

    def _answer(self, patience_s: float) -> SerialFrame:
        """The frame that answers the last question. Raises ReplyTimeout at the deadline, or at a gap behind rubbish."""
        deadline, over = self.deadline(patience_s), False
        while not over:
            rubbish = self._framer.skipped_bytes + self._framer.pending
            wait = self.deadline(min(GAP_S, deadline.remaining())) if rubbish >= SMALLEST_FRAME else deadline
            try:
                frames = self._framer.receive(self._stream.receive(wait))
            except ReplyTimeout:
                frames, over = self._framer.expire(), True
            for frame in frames:
                if self._is_awaited(frame):
                    return frame
                self._link.strays += 1
        raise ReplyTimeout(f"{rubbish} bytes came and no answer" if rubbish else f"no answer within {patience_s:g} s")

    def _is_awaited(self, frame: SerialFrame) -> bool:
        """Lay a frame to the earliest question that it can answer; whether that is the last one.

        While others are owed, a NAK may be any's, and counts as nobody's.
        """
        if frame.type in self._owed:
            del self._owed[: self._owed.index(frame.type) + 1]
        elif frame.type == NAK_TYPE and len(self._owed) == 1:
            self._owed.clear()
        else:
            return False
        return not self._owed

    def _count(self) -> None:
        """Take over what the framer has counted."""
        framer, link = self._framer, self._link
        link.frames += framer.frames
        link.skipped_bytes += framer.skipped_bytes
        link.checksum_errors += framer.bad_checksums
        framer.frames = framer.skipped_bytes = framer.bad_checksums = 0
