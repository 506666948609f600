"""Fault injection into a connection: both directions of a line, delayed deliveries, and a stream with faults.

    request(bytes), reply(bytes) ──> deliveries      class FaultyLine; DelayQueue holds them until they are due

    send(frame)  ──> FaultyLine ──> the stream       receive  <── DelayQueue <── FaultyLine <── the stream

FaultyLine and DelayQueue have no I/O and no clock. FaultyStream is a ByteStream around another one, real or simulated;
it waits with the `sleep` and clock that it is given, which may be simulated time. After a hang-up it stays closed;
its injector with the counts may be used for the next stream.
"""

import logging
from collections import deque
from collections.abc import Callable, Iterable

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.faults.frames import Delivery, Injector, Language, StreamPiece, total
from nclient.faults.plan import Direction
from nclient.transports.stream import ByteStream, Deadline


class FaultyLine:
    """Both directions of a connection with faults.

    Parameters
    ----------
    language
        Protocol of the connection.
    injector
        Returns the injector in force; called for every frame, so that a new plan applies at once.
    """

    def __init__(self, language: Language, injector: Callable[[], Injector]) -> None:
        self.injector = injector
        self._language = language

    @property
    def has_partial_request(self) -> bool:
        """Return True if an incomplete request is buffered."""
        return self._language.requests.pending_bytes > 0

    @property
    def partial_timeout_s(self) -> float | None:
        """Return the time after which an incomplete request is passed on; None for no limit."""
        return self._language.partial_timeout_s

    def request(self, data: bytes, now_s: float, whole: bool = False) -> list[Delivery]:
        """Return the deliveries for bytes to the robot; `whole`: they end with a frame, so that none is buffered."""
        deliveries = self._requests(self._language.requests.receive(data), now_s)
        return deliveries + (self.flush_request(now_s) if whole else [])

    def reply(self, data: bytes, now_s: float) -> list[Delivery]:
        """Return the deliveries for bytes to the host."""
        return self._replies(self._language.replies.receive(data), now_s)

    def flush_reply(self, now_s: float) -> list[Delivery]:
        """Return the deliveries for an incomplete reply after its timeout."""
        return self._replies(self._language.replies.flush(), now_s)

    def flush_request(self, now_s: float) -> list[Delivery]:
        """Return the deliveries for an incomplete request after its timeout."""
        return self._requests(self._language.requests.flush(), now_s)

    def _requests(self, pieces: Iterable[StreamPiece], now_s: float) -> list[Delivery]:
        language, found = self._language, []
        for piece in pieces:
            name = language.request_name(piece)
            deliveries = self.injector().process_frame(piece.data, name, Direction.REQUEST, now_s, language.nak)
            # A refused or dropped request gets no reply from the robot, so none may be expected.
            if any(not delivery.to_sender for delivery in deliveries):
                language.request_delivered(name)
            found += deliveries
        return found

    def _replies(self, pieces: Iterable[StreamPiece], now_s: float) -> list[Delivery]:
        language, found = self._language, []
        for piece in pieces:
            name = language.reply_name(piece)
            found += self.injector().process_frame(piece.data, name, Direction.REPLY, now_s, language.nak)
        return found


class DelayQueue:
    """Queue of delayed deliveries; none overtakes an earlier one."""

    def __init__(self) -> None:
        self.size = 0
        """Number of bytes in the queue."""
        self._queue: deque[tuple[float, Delivery]] = deque()

    @property
    def next_s(self) -> float | None:
        """Return the time at which the next delivery is due, on the clock of `add`; None if the queue is empty."""
        return self._queue[0][0] if self._queue else None

    def add(self, deliveries: Iterable[Delivery], now_s: float) -> None:
        """Add deliveries that are sent now."""
        for delivery in deliveries:
            due_s = now_s + delivery.delay_s
            # A line keeps the order of its bytes: a short delay after a long one ends with it.
            if self._queue:
                due_s = max(due_s, self._queue[-1][0])
            self._queue.append((due_s, delivery))
            self.size += len(delivery.data)

    def take(self, now_s: float) -> tuple[float, Delivery] | None:
        """Remove and return the next due delivery and its time; None if none is due."""
        if not self._queue or self._queue[0][0] > now_s:
            return None
        due_s, delivery = self._queue.popleft()
        self.size -= len(delivery.data)
        return due_s, delivery


log = logging.getLogger(__name__)

MAX_SLEEP_S = 0.05
"""Maximum duration of one sleep, so that a close from another thread is noticed soon."""
_HUNG_UP = "the connection was closed on purpose by the fault plan"


class FaultyStream:
    """A ByteStream with faults.

    Parameters
    ----------
    stream
        The stream to wrap.
    line
        Line with the injector.
    now
        Returns seconds on any clock.
    sleep
        Waits a number of seconds on that clock.
    """

    def __init__(
        self, stream: ByteStream, line: FaultyLine, now: Callable[[], float], sleep: Callable[[float], None]
    ) -> None:
        self._stream = stream
        self._line = line
        self._now = now
        self._sleep = sleep
        # Deliveries to the host that are not due yet, and the reason of the end once the stream is over.
        self._coming = DelayQueue()
        self._over: str | None = None
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send data as the plan changes and delays it. Raises ConnectionLost."""
        self._refuse_if_over()
        for delivery in self._line.request(data, self._now(), whole=True):
            # 1. A delayed request blocks the sender, as a slow line does.
            if delivery.delay_s > 0.0:
                self._sleep(delivery.delay_s)
            # 2. A refusal goes back as if the robot had sent it.
            if delivery.to_sender:
                self._coming.add([Delivery(0.0, delivery.data)], self._now())
            elif delivery.data:
                self._stream.send(delivery.data)
            if delivery.hang_up:
                self._hang_up()

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte that the plan lets pass. Raises ReplyTimeout, or ConnectionLost after a hang-up."""
        while True:
            # 1. Bytes that are due.
            if data := self._arrived():
                return data
            self._refuse_if_over()
            # 2. Nothing in transit: read from the stream; otherwise wait for what is.
            if self._coming.next_s is None:
                self._take_in(deadline)
            else:
                self._wait_until(self._coming.next_s, deadline.remaining())

    def close(self) -> None:
        """Close the stream and log the counts so far; a waiting `receive` raises ConnectionLost."""
        if not self._closed:
            self._closed = True
            injector = self._line.injector()
            if injector.counts:
                log.info("faults on %s so far: %s", injector.line, dict(total(injector.counts)))
        self._over = self._over or "this end has closed the connection"
        self._stream.close()

    def _arrived(self) -> bytes:
        """Return the due bytes, up to a hang-up."""
        data = b""
        while arrived := self._coming.take(self._now()):
            _, delivery = arrived
            data += delivery.data
            if delivery.hang_up:
                self._hang_up()
                break
        return data

    def _take_in(self, deadline: Deadline) -> None:
        """Receive from the stream; after the deadline an incomplete frame is delivered as it is."""
        try:
            deliveries = self._line.reply(self._stream.receive(deadline), self._now())
        except ReplyTimeout:
            # A dropped byte leaves a frame incomplete: the host gets what has arrived, as on a real line.
            deliveries = self._line.flush_reply(self._now())
            if not deliveries:
                raise
        self._coming.add(deliveries, self._now())

    def _wait_until(self, due_s: float, timeout_s: float) -> None:
        """Sleep until a time. Raises ReplyTimeout if the timeout ends first."""
        give_up_s = self._now() + timeout_s
        while not self._over and (left_s := min(due_s, give_up_s) - self._now()) > 0.0:
            self._sleep(min(left_s, MAX_SLEEP_S))
        if not self._over and give_up_s < due_s:
            raise ReplyTimeout("a delivery is delayed on purpose by the fault plan")

    def _hang_up(self) -> None:
        self._over = self._over or _HUNG_UP
        self._stream.close()

    def _refuse_if_over(self) -> None:
        if self._over:
            raise ConnectionLost(self._over)
