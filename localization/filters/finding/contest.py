"""Two places or three, held against each other by what is heard from now on: a sequential test (Wald 1945).

    nats(side)  +=  ln( (1 - BAD_SHARE) p(reading | side) + BAD_SHARE p(reading | bad) )

A rival is the best of all places on a map, so the echoes that chose it say nothing for it: among so many some place
fits any two dozen echoes better than the right one, a few of them bad. Those heard afterwards do. While an estimate is
right, the likelihood ratio of any rival chosen before has a mean of 1 at every echo, so it comes to exceed e^n with a
chance of e^-n at most, however often it is looked at (Ville 1939). That holds if bad echoes are no more than what is
taken for bad; so more are than by a filter that knows its place.

The estimate may have slipped off a little and a place near it be right: that one has its say too, or a third place
could win because both are wrong. Rules: pure; each rival is a belief of its own that moves and hears.
"""

from __future__ import annotations

from enum import Enum
from math import log
from typing import Final

from localization.estimation.belief import Belief, Floats
from localization.estimation.hearing import Hearing
from localization.estimation.motion import OdometryNoise
from localization.estimation.systematic import predict
from localization.filters.finding.search import BAD_SHARE, NOTHING_IN, SPAN_IN, Clue

SURE_NATS: Final = 12.0
"""A side that leads all others by so much has won: wrongly in one contest of 160,000."""


class Side(Enum):
    """Who is right: the estimate, a place near it, or one elsewhere."""

    HERE = "here"
    NEAR = "near"
    ELSEWHERE = "elsewhere"


class Contest:
    """See the head of this file. Rivals are None where there is none; the estimate itself is its filter's to keep."""

    def __init__(
        self, near: Belief | None, elsewhere: Belief | None, hearing: Hearing, odometry: OdometryNoise
    ) -> None:
        self._hearing, self._odometry = hearing, odometry
        rivals = {Side.NEAR: near, Side.ELSEWHERE: elsewhere}
        self._rivals = {side: belief for side, belief in rivals.items() if belief is not None}
        self._nats = dict.fromkeys((Side.HERE, *self._rivals), 0.0)
        self.heard = 0
        """Echoes so far."""

    def belief(self, side: Side) -> Belief:
        """What a rival believes by now. Raises KeyError for a side that is no rival of this contest."""
        return self._rivals[side]

    @property
    def winner(self) -> Side | None:
        """Who leads all others by SURE_NATS; None while nobody does."""
        return max(self._nats, key=self._nats.__getitem__) if self.lead_nats >= SURE_NATS else None

    @property
    def lead_nats(self) -> float:
        """By how much the first leads the second."""
        second, first = sorted(self._nats.values())[-2:]
        return first - second

    def move(self, step: Floats) -> None:
        """The encoders told of a step (2,)."""
        self._rivals = {side: predict(belief, step, self._odometry) for side, belief in self._rivals.items()}

    def hear(self, clue: Clue, likelihood: float) -> None:
        """An echo, and how well the estimate explained it."""
        self.heard += 1
        self._nats[Side.HERE] += _weight(clue.reading_in, likelihood)
        for side, belief in self._rivals.items():
            heard = self._hearing.hear(belief, clue.sonar, clue.turret_offset_rad, clue.reading_in)
            self._rivals[side] = heard.belief
            self._nats[side] += _weight(clue.reading_in, heard.likelihood)


def _weight(reading_in: float, likelihood: float) -> float:
    """In nats, what an echo so likely says."""
    bad = 1.0 if reading_in >= NOTHING_IN else 1.0 / SPAN_IN
    return log((1.0 - BAD_SHARE) * likelihood + BAD_SHARE * bad)
