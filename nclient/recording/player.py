"""Answers as a recorded robot did: bytes in, the recorded bytes out, or a clear word where something else is asked.

    strict   questions come in the recorded order; what keeps a robot fed (gs, conf_tm) may be left out
    loose    each question is answered as the next one like it was
    both     leaving is always allowed; conf_tm, which clients set by themselves, is answered with the last state

Rules: no I/O and no clock: each answer tells how long after its question it came, and whoever plays waits or does not.
"""

from __future__ import annotations

from typing import Final

from nclient.errors import RecordingError
from nclient.recording.script import Asked, Exchange, Piece, Questions, Script, state_before

STRICT, LOOSE = "strict", "loose"
ORDERS: Final = (STRICT, LOOSE)
_FEEDING: Final = frozenset({"gs", "conf_tm"})
"""What clients say by themselves at moments of their own choice: a program need not repeat it."""
_LEAVING: Final = "disconnect_robot"
_TIMEOUT: Final = "conf_tm"


class Player:
    """One connection, played once. `order`: one of ORDERS."""

    def __init__(self, script: Script, order: str = STRICT) -> None:
        self._script = script
        self._loose = order == LOOSE
        self._questions = Questions(script.line, script.model)
        self._next = 0

    @property
    def greeting(self) -> list[Piece]:
        """What the robot says unasked, as one comes."""
        return self._script.greeting

    @property
    def left(self) -> int:
        """Recorded questions that have not been passed yet."""
        return len(self._script.exchanges) - self._next

    def answers(self, data: bytes) -> list[Piece]:
        """What was answered to what these bytes ask. Raises RecordingError where it was not asked (there and then)."""
        return [piece for question in self._questions.receive(data) for piece in self._answer(question)]

    def _answer(self, question: Asked) -> list[Piece]:
        at = self._found(question)
        if at is None:
            if question.name == _LEAVING:
                return []
            state = state_before(self._script, self._next) if question.name == _TIMEOUT else b""
            if state:
                return [Piece(0.0, state)]
            raise self._missing(question)
        self._next = at + 1
        return self._script.exchanges[at].answer

    def _found(self, question: Asked) -> int | None:
        for at, exchange in enumerate(self._script.exchanges[self._next :], start=self._next):
            if exchange.asked == question:
                return at
            if not self._loose and exchange.asked.name not in _FEEDING:
                return None
        return None

    def _missing(self, question: Asked) -> RecordingError:
        name, expected = self._script.name, self._expected()
        if expected is None:
            return RecordingError(f"{name}: it ends here, and the program asks {question}; record a longer run")
        if self._loose:
            return RecordingError(
                f"{name}: {question} was not asked again from line {expected.line} on; record a run that asks it"
            )
        return RecordingError(
            f"{name}, line {expected.line}: recorded was {expected.asked}, the program asks {question}; "
            f"order={LOOSE} answers as the next one like it was, or record the run anew"
        )

    def _expected(self) -> Exchange | None:
        """The next one that must come; where only what may be left out is left, the first of that."""
        left = self._script.exchanges[self._next :]
        return next((each for each in left if each.asked.name not in _FEEDING), left[0] if left else None)


class PlayedPeer:
    """A player as what answers in this process, at once: MemoryStream's other end."""

    def __init__(self, player: Player) -> None:
        self._player = player
        self._out = bytearray(b"".join(piece.data for piece in player.greeting))

    def send(self, data: bytes) -> None:
        """Take in bytes, and answer them. Raises RecordingError, see Player."""
        for piece in self._player.answers(data):
            self._out += piece.data

    def receive(self) -> bytes:
        """What has been answered."""
        answered = bytes(self._out)
        self._out.clear()
        return answered

    def close(self) -> None:
        """The client is gone."""
