"""A filter that knows when it is lost, and finds itself again: one estimate, or several while places look alike.

    tracking     one hypothesis; a watch looks on, and where that has doubts a search looks whether another place
                 explains the last echoes better. One that does is held against it by the echoes heard from then on
                 (contest); elsewhere and right: ── LOST ──> searching, near by and right: the estimate is set right
    searching    echoes are collected for a ring and a half, then search ──> several hypotheses, or one
    choosing     each hypothesis is a filter of its own; the unlikely are dropped as driving tells them apart; one left
                 (more than SURE of all) ──> tracking

It begins tracking where it is told a place, searching where it is told none. Rules: no robot, no clock; whoever drives
reads `verdict` and `hypotheses` and decides what to do meanwhile (stand, turn, drive on slowly).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import log
from typing import Final

import numpy as np

from localization.estimation.belief import Belief, Floats
from localization.estimation.hearing import Hearing
from localization.estimation.motion import OdometryNoise, move
from localization.estimation.observation import Judgement, Refusal
from localization.estimation.repeats import Repeats
from localization.estimation.systematic import moved_to, predict, with_constants
from localization.filters.finding.atlas import Atlas
from localization.filters.finding.contest import Contest, Side
from localization.filters.finding.search import NEAREST_IN, Clue, Hypothesis, merged, rivals, search
from localization.filters.method import Place
from localization.filters.watch import Trust, Verdict, Watch

CLUES: Final = 24
"""Echoes that a search looks at: a ring and a half, so that a missed or a bad one is not missed much."""
SURE: Final = 0.99
"""Share from which one hypothesis is the estimate."""
BETTER_NATS: Final = 12.0
"""By so much another place must explain the last echoes better, for a doubted one to be held against it."""
FOUND_STD: Final = (0.5, 0.5, 0.03)
"""How much less is known of a place that was found than its few echoes say: they chose it, and count for that."""
NOWHERE_STD: Final = (1000.0, 1000.0, 3.0)
"""How uncertain a belief is that knows nothing: inches and radians."""


class Finder:
    """See the head of this file. `ears`: the direction of each sonar on the turret, radians."""

    def __init__(
        self,
        belief: Belief | None,
        hearing: Hearing,
        odometry: OdometryNoise,
        atlas: Callable[[], Atlas],
        ears: Sequence[float],
        constants: tuple[float, ...] = (),
        watch: Watch | None = None,
    ) -> None:
        self._hearing, self._odometry, self._ears, self._constants = hearing, odometry, ears, constants
        self._draw_atlas = atlas
        self._atlas: Atlas | None = None
        self._watch = watch or Watch()
        self._encoders, self._repeats = np.zeros(3), Repeats()
        self._clues: deque[Clue] = deque(maxlen=CLUES)
        self._fresh = 0
        self._contest: Contest | None = None
        self._why = "nothing was told of the place"
        self.hypotheses: list[Hypothesis] = [] if belief is None else [Hypothesis(belief, 1.0)]
        """Where the robot may be, the likeliest first; none while searching."""

    @property
    def belief(self) -> Belief:
        """The likeliest hypothesis; as good as nothing while searching."""
        if self.hypotheses:
            return self.hypotheses[0].belief
        return with_constants(Belief(np.zeros(3), np.diag(np.square(NOWHERE_STD))), self._constants)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where the robot may be."""
        return tuple(Place(known.belief, known.share) for known in self.hypotheses)

    @property
    def verdict(self) -> Verdict:
        """How far that can be believed."""
        if not self.hypotheses:
            return Verdict(Trust.LOST, f"searching: {self._why}")
        if len(self.hypotheses) > 1:
            count = len(self.hypotheses)
            return Verdict(Trust.LOST, f"{count} places look alike, the likeliest with {self.hypotheses[0].share:.0%}")
        return self._watch.verdict(self.belief)

    def move(self, step: Floats) -> None:
        """The encoders told of a step (2,)."""
        self._encoders = move(self._encoders, step)
        self._repeats.move(step)
        self.hypotheses = [
            Hypothesis(predict(known.belief, step, self._odometry), known.share) for known in self.hypotheses
        ]
        if self._contest:
            self._contest.move(step)

    def ahead(self, step: Floats) -> Belief:
        """The belief after such a step, which is not taken."""
        return predict(self.belief, step, self._odometry)

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> Judgement:
        """A reading: every hypothesis takes it in; those it speaks against lose their share."""
        direction = turret_offset_rad + self._ears[sonar]
        self._clues.append(Clue(self._encoders, direction, sonar, turret_offset_rad, reading_in))
        self._fresh += 1
        if not self.hypotheses:
            return self._search()
        times = self._repeats.before(sonar, turret_offset_rad) + 1
        heard = [
            self._hearing.hear(known.belief, sonar, turret_offset_rad, reading_in, times) for known in self.hypotheses
        ]
        judgement = heard[0].judgement
        if judgement.refusal is Refusal.NONE:
            self._repeats.take(sonar, turret_offset_rad)
        if len(heard) == 1:
            self.hypotheses = [Hypothesis(heard[0].belief, 1.0)]
            self._look_on(self._clues[-1], heard[0].likelihood, judgement)
            return judgement
        known = zip(self.hypotheses, heard, strict=True)
        self.hypotheses = merged([(new.belief, log(old.share) + log(new.likelihood)) for old, new in known])
        if self.hypotheses[0].share > SURE:
            self.hypotheses = [Hypothesis(self.hypotheses[0].belief, 1.0)]
            self._watch.reset()
        return judgement

    def _look_on(self, clue: Clue, likelihood: float, judgement: Judgement) -> None:
        """Watch one estimate; lost, it is given up."""
        if clue.reading_in <= NEAREST_IN:
            return
        limit = judgement.refusal is Refusal.LIMIT
        self._watch.hear(likelihood, self._map.density(clue.reading_in), None if limit else judgement)
        if self._contest:
            self._contest.hear(clue, likelihood)
            self._decide(self._contest)
        if self._watch.lost:
            self._give_up(self._watch.reason)
        elif self._watch.doubtful and not self._contest and self._fresh >= CLUES // 2:
            self._doubt()

    def _doubt(self) -> None:
        """Look for places that explain more; one that does is heard along from now on."""
        self._fresh = 0
        found = rivals(self.belief, list(self._clues), self._map, self._hearing, self._odometry)
        if found.lead_nats >= BETTER_NATS:
            near, elsewhere = (place and moved_to(_wider(place), self.belief) for place in found[:2])
            self._contest = Contest(near, elsewhere, self._hearing, self._odometry)

    def _decide(self, contest: Contest) -> None:
        """End a contest that is won, or has lasted long enough."""
        winner = contest.winner
        if winner is Side.ELSEWHERE:
            self._give_up(f"another place explains what is heard better, by e^{contest.lead_nats:.0f}")
        elif winner is Side.NEAR:
            self.hypotheses = [Hypothesis(contest.belief(Side.NEAR), 1.0)]
            self._watch.reset()
        if winner is not None or contest.heard >= CLUES // 2:
            self._contest = None

    def _give_up(self, why: str) -> None:
        """Begin the search, with what is heard from now on."""
        self._why = why
        self._watch.reset()
        self._contest = None
        self.hypotheses = []
        self._fresh = 0

    def _search(self) -> Judgement:
        if self._fresh >= CLUES:
            self._fresh = CLUES // 2
            found = search(list(self._clues), self._map, self._hearing, self._odometry)
            self.hypotheses = [
                Hypothesis(with_constants(_wider(place.belief), self._constants), place.share) for place in found
            ]
            self._watch.reset()
        return Judgement(Refusal.LIMIT, 0.0, 0.0, 1.0)

    @property
    def _map(self) -> Atlas:
        """Drawn when first needed."""
        if self._atlas is None:
            self._atlas = self._draw_atlas()
        return self._atlas


def _wider(belief: Belief) -> Belief:
    """A belief over a pose, by FOUND_STD wider."""
    return Belief(belief.mean, belief.cov + np.diag(np.square(FOUND_STD)))
