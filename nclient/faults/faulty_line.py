"""One connection under a plan, both ways: cuts what passes into frames, and lets the injector act on each.

    request(bytes), reply(bytes) ──> deliveries          InTransit keeps them in their order until they arrive

Rules: no I/O and no clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from nclient.faults.frames import Piece
from nclient.faults.injector import Delivery, Injector
from nclient.faults.language import Language
from nclient.faults.plan import Direction


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
