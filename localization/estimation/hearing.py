"""How a gaussian filter takes one reading in: a sense finds what it may be of, a rule of correction says what each of
that would make of the belief, the mixture puts it together.

Rules: pure; a belief in, a belief out, and the reason where a reading said nothing. Whoever hands them over has brought
the belief to the instant at which the sonar fired. States may be longer than a pose (see systematic).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from localization.estimation.belief import Belief
from localization.estimation.candidates import Candidates
from localization.estimation.mixture import absorb
from localization.estimation.observation import SPAN_IN, Judgement, Refusal, told_as
from localization.estimation.updates import Rule, linear


class Sensed(NamedTuple):
    """What a reading may be of, or why it says nothing.

    likelihood    where it is refused: how well the belief explains that
    besides       share of readings that are bad beside those the candidates tell of; for the likelihood alone
    """

    refusal: Refusal
    likelihood: float
    candidates: Candidates | None = None
    besides: float = 0.0


class Sense(Protocol):
    """A kind of sonar, in a map, on a body."""

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Sensed:
        """What sonar number `sonar` may have heard, the turret being turned by so much against the heading."""
        ...


class Heard(NamedTuple):
    """What a reading left: the belief, what became of it, and how well the belief before it explains it: a density per
    inch for a range, a chance for a limit; the same kind for the same reading, whatever the belief."""

    belief: Belief
    judgement: Judgement
    likelihood: float


class Hearing:
    """A kind of sonar, in a map, on a body, with a rule of correction."""

    def __init__(self, sense: Sense, rule: Rule = linear) -> None:
        self._sense, self._rule = sense, rule

    def hear(
        self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float, times: int = 1
    ) -> Heard:
        """Take in what sonar number `sonar` reads, the turret being turned by so much against the heading; the
        `times`-th of its readings that is taken in from this place (repeats)."""
        sensed = self._sense.sense(belief, sonar, turret_offset_rad, reading_in)
        if sensed.candidates is None:
            return Heard(belief, Judgement(sensed.refusal, 0.0, 0.0, 1.0), sensed.likelihood)
        taken = absorb(belief, reading_in, sensed.candidates, self._rule, times)
        judgement = Judgement(told_as(taken.bad_share), taken.innovation_in, taken.nis, taken.bad_share)
        likelihood = (1.0 - sensed.besides) * taken.likelihood + sensed.besides / SPAN_IN
        return Heard(taken.belief, judgement, likelihood)
