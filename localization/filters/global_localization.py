"""Where a robot may be that nobody knows the place of: all poses that explain the echoes of the last few seconds.

    1  coarse    every free cell and heading, a ring of echoes each: likelihoods out of the atlas
    2  peaks     the best, and the best that is not near a better one, and so on
    3  refine    each peak as a gaussian as wide as a cell, moved and corrected by the same echoes (filters.hearing)

Symmetry stays: as many hypotheses come out as the map has places that look alike, each with its weight. Rules: pure, no
chance; echoes come with where the encoders stood.

Two places or three, held against each other by what is heard from now on: a sequential test (Wald 1945).

    nats(side)  +=  ln( (1 - BAD_SHARE) p(reading | side) + BAD_SHARE p(reading | bad) )

A rival is the best of all places on a map, so the echoes that chose it say nothing for it: among so many some place
fits any two dozen echoes better than the right one, a few of them bad. Those heard afterwards do. While an estimate is
right, the likelihood ratio of any rival chosen before has a mean of 1 at every echo, so it comes to exceed e^n with a
chance of e^-n at most, however often it is looked at (Ville 1939). That holds if bad echoes are no more than what is
taken for bad; so more are than by a filter that knows its place.

The estimate may have slipped off a little and a place near it be right: that one has its say too, or a third place
could win because both are wrong. Rules: pure; each rival is a belief of its own that moves and hears.

A filter that knows when it is lost, and finds itself again: one estimate, or several while places look alike.

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
from dataclasses import dataclass
from enum import Enum
from math import inf, log
from typing import Final, NamedTuple

import numpy as np

from localization.filters.base import Place
from localization.filters.belief import HEADING, Belief, Floats, add, difference, independent
from localization.filters.health import FilterHealth, HealthStatus, IntegrityMonitor
from localization.filters.odometry import POSE, OdometryNoise, move, predict, step_between, with_parameters, with_pose
from localization.filters.range_table import CELL_IN, DIRECTIONS, RangeTable
from localization.filters.update import CorrelatedReadings, MeasurementUpdate, Refusal, UpdateResult

CELL_STD_IN: Final = 2.0
"""How far a reading may be off what the middle of its cell would hear: a cell's half diagonal, and its heading's."""
HEADINGS: Final = DIRECTIONS
CLIMB_IN, CLIMB_RAD = 2.5 * CELL_IN, 0.35
"""Peaks nearer than this to a better one are its slopes."""
NEAR_IN, NEAR_RAD = CLIMB_IN, 0.5
"""A heading slips by as much as a cone is wide, 25 degrees: an echo is heard over all of it."""
MOST_PEAKS: Final = 40
REFINED_STD: Final = (0.6 * CELL_IN, 0.6 * CELL_IN, 0.06)
SAME_SQUARED: Final = 16.27
"""A place within this squared distance of a belief, by its spread, is the believed one: chi-square of 3, 99.9 %."""
WORTH_KEEPING: Final = 1e-4
"""Hypotheses with less than this share are dropped."""
BAD_SHARE, SPAN_IN = 0.3, 249.0
"""What is taken for bad at this stage: more than by a filter that knows its place, for people may stand about."""


NEAREST_IN, NOTHING_IN = 6.0, 255.0
"""Limits: "no nearer", which says little, and "nothing", which speaks against what ought to be heard."""


class EchoRecord(NamedTuple):
    """An echo, and where the encoders stood (3,) when it was heard, in any frame that is the same for all clues."""

    encoders: Floats
    sonar_rad: float
    sonar: int
    turret_offset_rad: float
    reading_in: float


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A place the robot may be at: a belief over its pose at the last clue, and its share of all that is believed."""

    belief: Belief
    share: float


def search(
    clues: Sequence[EchoRecord], atlas: RangeTable, hearing: MeasurementUpdate, odometry: OdometryNoise
) -> list[Hypothesis]:
    """All places that explain the clues, the likeliest first; none where there is no clue or no floor."""
    return merged(_weighed(clues, atlas, hearing, odometry))


class Alternatives(NamedTuple):
    """Beliefs over the pose at the last clue that a search holds against one: the best place near it and the best
    elsewhere, None where none was found; and by how many nats the better of the two explains the clues better than the
    belief itself, -inf where there is none."""

    near: Belief | None
    elsewhere: Belief | None
    lead_nats: float


def alternatives(
    here: Belief, clues: Sequence[EchoRecord], atlas: RangeTable, hearing: MeasurementUpdate, odometry: OdometryNoise
) -> Alternatives:
    """What else explains the clues. Near is within the spread of the belief `here`, or as far off as it may slip."""
    wide = Belief(here.mean[:POSE], here.cov[:POSE, :POSE] + np.diag(np.square(REFINED_STD)))
    information = np.linalg.inv(wide.cov)
    best: dict[bool, tuple[Belief, float]] = {}
    for place, score in _weighed(clues, atlas, hearing, odometry):
        off = difference(place.mean, wide.mean)
        near = bool(off @ information @ off <= SAME_SQUARED) or _may_slip(off)
        if near not in best or score > best[near][1]:
            best[near] = place, score
    lead = max((score for _, score in best.values()), default=-inf) - _led(wide, clues, hearing, odometry)[1]
    near_by, elsewhere = (best[near][0] if near in best else None for near in (True, False))
    return Alternatives(near_by, elsewhere, lead)


def _weighed(
    clues: Sequence[EchoRecord], atlas: RangeTable, hearing: MeasurementUpdate, odometry: OdometryNoise
) -> list[tuple[Belief, float]]:
    """Beliefs of all places that explain the clues, each with its log likelihood."""
    places = atlas.places_in
    if not clues or not len(places):
        return []
    poses, score = _coarse(clues, atlas, places)
    return [_refined(peak, clues, hearing, odometry) for peak in _peaks(poses, score)]


def merged(weighed: Sequence[tuple[Belief, float]]) -> list[Hypothesis]:
    """Hypotheses of beliefs with their log likelihoods: those at the same place are one, the unlikely none."""
    ranked = sorted(weighed, key=lambda pair: -pair[1])
    best = ranked[0][1] if ranked else -inf
    kept: list[tuple[Belief, float]] = []
    for belief, score in ranked:
        weight = float(np.exp(score - best))
        if weight < WORTH_KEEPING:
            break
        if not any(_same(belief, other) for other, _ in kept):
            kept.append((belief, weight))
    total = sum(weight for _, weight in kept)
    return [Hypothesis(belief, weight / total) for belief, weight in kept]


def _same(one: Belief, other: Belief) -> bool:
    off = difference(one.mean, other.mean)
    return bool(np.hypot(off[0], off[1]) < CELL_IN and abs(off[HEADING]) < 0.15)


def _coarse(clues: Sequence[EchoRecord], atlas: RangeTable, places: Floats) -> tuple[Floats, Floats]:
    """All poses (n, 3) of the grid at the last clue, and their log likelihoods (n,)."""
    turns = np.arange(HEADINGS) * (2.0 * np.pi / HEADINGS)
    poses = np.empty((len(places) * HEADINGS, 3))
    poses[:, :2] = np.repeat(places, HEADINGS, axis=0)
    poses[:, HEADING] = np.tile(turns, len(places))
    score = np.zeros(len(poses))
    floor = BAD_SHARE / SPAN_IN
    for clue in clues:
        there = _carried(poses, clues[-1].encoders, clue.encoders)
        if clue.reading_in <= NEAREST_IN:
            continue
        ranges, chances = atlas.look_up(there, clue.sonar_rad)
        variance = CELL_STD_IN**2 + (0.01 * ranges) ** 2
        if clue.reading_in >= NOTHING_IN:
            score += np.log(1.0 - (1.0 - BAD_SHARE) * chances)
            continue
        hit = chances * np.exp(-0.5 * (clue.reading_in - ranges) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        score += np.log((1.0 - BAD_SHARE) * hit + floor)
    return poses, score


def _carried(poses: Floats, last: Floats, then: Floats) -> Floats:
    """Where poses (n, 3) were when the encoders stood at `then`, being at `last` now."""
    back = difference(then, last)
    turn = poses[:, HEADING] - last[HEADING]
    cos, sin = np.cos(turn), np.sin(turn)
    there = np.empty_like(poses)
    there[:, 0] = poses[:, 0] + cos * back[0] - sin * back[1]
    there[:, 1] = poses[:, 1] + sin * back[0] + cos * back[1]
    there[:, HEADING] = poses[:, HEADING] + back[HEADING]
    return there


def _peaks(poses: Floats, score: Floats) -> list[Floats]:
    """The best poses (3,), none on the slope of a better one."""
    order = np.argsort(score)[::-1]
    order = order[score[order] > score[order[0]] - 25.0][:20_000]
    left = poses[order]
    found: list[Floats] = []
    while len(left) and len(found) < MOST_PEAKS:
        peak = left[0]
        found.append(peak)
        off = difference(left, np.broadcast_to(peak, left.shape))
        near = (np.hypot(off[:, 0], off[:, 1]) < CLIMB_IN) & (np.abs(off[:, HEADING]) < CLIMB_RAD)
        left = left[~near]
    return found


def _may_slip(off: Floats) -> bool:
    return bool(np.hypot(off[0], off[1]) < NEAR_IN and abs(off[HEADING]) < NEAR_RAD)


def _refined(
    peak: Floats, clues: Sequence[EchoRecord], hearing: MeasurementUpdate, odometry: OdometryNoise
) -> tuple[Belief, float]:
    """A peak, as wide as a cell, led along the clues."""
    return _led(independent(peak, REFINED_STD), clues, hearing, odometry)


def _led(
    last: Belief, clues: Sequence[EchoRecord], hearing: MeasurementUpdate, odometry: OdometryNoise
) -> tuple[Belief, float]:
    """A belief carried from the last clue to the first and led along all of them: what it is then, and how likely all
    that was heard is by it, as a logarithm."""
    start = _carried(last.mean[None, :], clues[-1].encoders, clues[0].encoders)[0]
    belief = Belief(add(start, np.zeros(3)), last.cov)
    score, before = 0.0, clues[0].encoders
    for clue in clues:
        belief = predict(belief, step_between(before, clue.encoders), odometry)
        heard = hearing.hear(belief, clue.sonar, clue.turret_offset_rad, clue.reading_in)
        belief, before = heard.belief, clue.encoders
        score += log(heard.likelihood)
    return belief, score


SURE_NATS: Final = 12.0
"""A side that leads all others by so much has won: wrongly in one contest of 160,000."""


class Side(Enum):
    """Who is right: the estimate, a place near it, or one elsewhere."""

    HERE = "here"
    NEAR = "near"
    ELSEWHERE = "elsewhere"


class SequentialTest:
    """See the head of this file. Rivals are None where there is none; the estimate itself is its filter's to keep."""

    def __init__(
        self, near: Belief | None, elsewhere: Belief | None, hearing: MeasurementUpdate, odometry: OdometryNoise
    ) -> None:
        self._hearing, self._odometry = hearing, odometry
        alternatives = {Side.NEAR: near, Side.ELSEWHERE: elsewhere}
        self._rivals = {side: belief for side, belief in alternatives.items() if belief is not None}
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

    def hear(self, clue: EchoRecord, likelihood: float) -> None:
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


class GlobalLocalizer:
    """See the head of this file. `ears`: the direction of each sonar on the turret, radians."""

    def __init__(
        self,
        belief: Belief | None,
        hearing: MeasurementUpdate,
        odometry: OdometryNoise,
        atlas: Callable[[], RangeTable],
        ears: Sequence[float],
        constants: tuple[float, ...] = (),
        watch: IntegrityMonitor | None = None,
    ) -> None:
        self._hearing, self._odometry, self._ears, self._constants = hearing, odometry, ears, constants
        self._draw_atlas = atlas
        self._atlas: RangeTable | None = None
        self._watch = watch or IntegrityMonitor()
        self._encoders, self._repeats = np.zeros(3), CorrelatedReadings()
        self._clues: deque[EchoRecord] = deque(maxlen=CLUES)
        self._fresh = 0
        self._contest: SequentialTest | None = None
        self._why = "nothing was told of the place"
        self.hypotheses: list[Hypothesis] = [] if belief is None else [Hypothesis(belief, 1.0)]
        """Where the robot may be, the likeliest first; none while searching."""

    @property
    def belief(self) -> Belief:
        """The likeliest hypothesis; as good as nothing while searching."""
        if self.hypotheses:
            return self.hypotheses[0].belief
        return with_parameters(Belief(np.zeros(3), np.diag(np.square(NOWHERE_STD))), self._constants)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where the robot may be."""
        return tuple(Place(known.belief, known.share) for known in self.hypotheses)

    @property
    def health(self) -> FilterHealth:
        """How far that can be believed."""
        if not self.hypotheses:
            return FilterHealth(HealthStatus.LOST, f"searching: {self._why}")
        if len(self.hypotheses) > 1:
            count = len(self.hypotheses)
            return FilterHealth(
                HealthStatus.LOST, f"{count} places look alike, the likeliest with {self.hypotheses[0].share:.0%}"
            )
        return self._watch.health(self.belief)

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

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """A reading: every hypothesis takes it in; those it speaks against lose their share."""
        direction = turret_offset_rad + self._ears[sonar]
        self._clues.append(EchoRecord(self._encoders, direction, sonar, turret_offset_rad, reading_in))
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

    def _look_on(self, clue: EchoRecord, likelihood: float, judgement: UpdateResult) -> None:
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
        found = alternatives(self.belief, list(self._clues), self._map, self._hearing, self._odometry)
        if found.lead_nats >= BETTER_NATS:
            near, elsewhere = (place and with_pose(_wider(place), self.belief) for place in found[:2])
            self._contest = SequentialTest(near, elsewhere, self._hearing, self._odometry)

    def _decide(self, contest: SequentialTest) -> None:
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

    def _search(self) -> UpdateResult:
        if self._fresh >= CLUES:
            self._fresh = CLUES // 2
            found = search(list(self._clues), self._map, self._hearing, self._odometry)
            self.hypotheses = [
                Hypothesis(with_parameters(_wider(place.belief), self._constants), place.share) for place in found
            ]
            self._watch.reset()
        return UpdateResult(Refusal.LIMIT, 0.0, 0.0, 1.0)

    @property
    def _map(self) -> RangeTable:
        """Drawn when first needed."""
        if self._atlas is None:
            self._atlas = self._draw_atlas()
        return self._atlas


def _wider(belief: Belief) -> Belief:
    """A belief over a pose, by FOUND_STD wider."""
    return Belief(belief.mean, belief.cov + np.diag(np.square(FOUND_STD)))
