"""One connection under a plan, both ways: cuts what passes into frames, and lets the injector act on each.

    request(bytes), reply(bytes) ──> deliveries          InTransit keeps them in their order until they arrive

Rules: no I/O and no clock.

A stream with faults: wraps any ByteStream, a real robot's as well as a simulated one's, and is a stream again.

    send(frame)  ──> FaultyLine ──> the stream          receive  <── InTransit <── FaultyLine <── the stream

Rules: what is sent at once ends with a frame. Waiting is done by the `sleep` that is handed in, on the clock `now`, so
that simulated time serves as well as real. A stream outlives no hang-up; its injector, and so its counts, may.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.faults.frames import Delivery, Injector, Language, Piece, total
from nclient.faults.plan import Direction
from nclient.transports.stream import ByteStream, Deadline


class FaultyLine:
    """One connection under a plan. `injector` is asked each time, so that a new plan counts at once."""

    def __init__(self, language: Language, injector: Callable[[], Injector]) -> None:
        self.injector = injector
        self._language = language

    @property
    def asking(self) -> bool:
        """Whether a part of a request is kept that is not whole yet."""
        return self._language.requests.pending > 0

    @property
    def patience_s(self) -> float | None:
        """How long a part of a request may be kept; None: as long as it takes."""
        return self._language.patience_s

    def request(self, data: bytes, now_s: float, whole: bool = False) -> list[Delivery]:
        """What arrives of bytes to the robot. `whole`: they end with a frame, so that none of them is kept back."""
        frames = self._language.requests
        pieces = frames.receive(data) + (frames.rest() if whole else [])
        return [delivery for piece in pieces for delivery in self._passed_on(piece, now_s)]

    def reply(self, data: bytes, now_s: float) -> list[Delivery]:
        """What arrives of bytes to the host."""
        return self._replies(self._language.replies.receive(data), now_s)

    def rest_of_reply(self, now_s: float) -> list[Delivery]:
        """What arrives of a reply that is not whole, when it is not waited for any longer."""
        return self._replies(self._language.replies.rest(), now_s)

    def rest_of_request(self, now_s: float) -> list[Delivery]:
        """What arrives of a request that is not whole, when it is not waited for any longer."""
        pieces = self._language.requests.rest()
        return [delivery for piece in pieces for delivery in self._passed_on(piece, now_s)]

    def _passed_on(self, piece: Piece, now_s: float) -> list[Delivery]:
        name, language = self._language.request_name(piece), self._language
        deliveries = self.injector().pass_on(piece.data, name, Direction.REQUEST, now_s, language.nak)
        if any(not delivery.back for delivery in deliveries):
            language.went_through(name)
        return deliveries

    def _replies(self, pieces: Iterable[Piece], now_s: float) -> list[Delivery]:
        language, found = self._language, []
        for piece in pieces:
            name = language.reply_name(piece)
            found += self.injector().pass_on(piece.data, name, Direction.REPLY, now_s, language.nak)
        return found


class InTransit:
    """Deliveries on their way: each arrives when its delay is over, and none before the one sent ahead of it."""

    def __init__(self) -> None:
        self.size = 0
        """Bytes on their way."""
        self._queue: deque[tuple[float, Delivery]] = deque()

    @property
    def next_s(self) -> float | None:
        """When the next one arrives, on the clock of `add`; None where none is on its way."""
        return self._queue[0][0] if self._queue else None

    def add(self, deliveries: Iterable[Delivery], now_s: float) -> None:
        """These are sent now."""
        for delivery in deliveries:
            due_s = now_s + delivery.delay_s
            if self._queue:
                due_s = max(due_s, self._queue[-1][0])
            self._queue.append((due_s, delivery))
            self.size += len(delivery.data)

    def take(self, now_s: float) -> tuple[float, Delivery] | None:
        """What has arrived next by now, and when it did; None: nothing more."""
        if not self._queue or self._queue[0][0] > now_s:
            return None
        due_s, delivery = self._queue.popleft()
        self.size -= len(delivery.data)
        return due_s, delivery


log = logging.getLogger(__name__)

NAP_S = 0.05
"""The longest sleep at once, so that a close from another thread is soon seen."""
_HUNG_UP = "the connection was hung up on purpose, by the plan of faults"


class FaultyStream:
    """See the head of this file. `now`: seconds on any clock; `sleep(seconds)`: lets that clock go on."""

    def __init__(
        self, stream: ByteStream, line: FaultyLine, now: Callable[[], float], sleep: Callable[[float], None]
    ) -> None:
        self._stream = stream
        self._line = line
        self._now = now
        self._sleep = sleep
        self._coming = InTransit()
        self._over: str | None = None
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send what the plan leaves of it, as late as the plan wants. Raises ConnectionLost."""
        self._refuse_if_over()
        for delivery in self._line.request(data, self._now(), whole=True):
            if delivery.delay_s > 0.0:
                self._sleep(delivery.delay_s)
            if delivery.back:
                self._coming.add([Delivery(0.0, delivery.data)], self._now())
            elif delivery.data:
                self._stream.send(delivery.data)
            if delivery.hang_up:
                self._hang_up()

    def receive(self, deadline: Deadline) -> bytes:
        """At least one byte that the plan lets through. Raises ReplyTimeout, or ConnectionLost when it is over."""
        while True:
            if data := self._arrived():
                return data
            self._refuse_if_over()
            if self._coming.next_s is None:
                self._take_in(deadline)
            else:
                self._wait_until(self._coming.next_s, deadline.remaining())

    def close(self) -> None:
        """Let go; what waits in `receive` ends with ConnectionLost. The counts so far stand in the log."""
        if not self._closed:
            self._closed = True
            injector = self._line.injector()
            if injector.counts:
                log.info("faults on %s so far: %s", injector.line, dict(total(injector.counts)))
        self._over = self._over or "this end has closed the connection"
        self._stream.close()

    def _arrived(self) -> bytes:
        """What has come, up to where the connection ends."""
        data = b""
        while arrived := self._coming.take(self._now()):
            _, delivery = arrived
            data += delivery.data
            if delivery.hang_up:
                self._hang_up()
                break
        return data

    def _take_in(self, deadline: Deadline) -> None:
        """Wait for the stream. What is no whole frame when the time is over comes as it is."""
        try:
            deliveries = self._line.reply(self._stream.receive(deadline), self._now())
        except ReplyTimeout:
            deliveries = self._line.rest_of_reply(self._now())
            if not deliveries:
                raise
        self._coming.add(deliveries, self._now())

    def _wait_until(self, moment_s: float, patience_s: float) -> None:
        """Sleep until the moment. Raises ReplyTimeout when patience ends first."""
        give_up_s = self._now() + patience_s
        while not self._over and (left_s := min(moment_s, give_up_s) - self._now()) > 0.0:
            self._sleep(min(left_s, NAP_S))
        if not self._over and give_up_s < moment_s:
            raise ReplyTimeout("what is on its way was delayed on purpose, by the plan of faults")

    def _hang_up(self) -> None:
        self._over = self._over or _HUNG_UP
        self._stream.close()

    def _refuse_if_over(self) -> None:
        if self._over:
            raise ConnectionLost(self._over)
