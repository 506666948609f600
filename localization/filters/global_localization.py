"""Global localization: a filter that detects when it is lost, and finds the robot again.

    tracking     one hypothesis under an IntegrityMonitor. Where it is suspicious, a search looks for another pose that
                 explains the last echoes better. One that does is compared with it by the echoes from then on
                 (SequentialTest): elsewhere and better --> LOST, searching; nearby and better: the estimate moves
    searching    echoes are collected for a ring and a half, then search() --> several hypotheses, or one
    choosing     each hypothesis is a Kalman filter; improbable ones are dropped as driving tells them apart; one left,
                 with more than MIN_CERTAINTY --> tracking

It begins with tracking from a given belief, with searching from none. The caller reads `health` and `hypotheses` and
decides what to do meanwhile (stand, turn, drive on slowly). No part of it is random.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from math import inf, log
from typing import Final, NamedTuple, Protocol

import numpy as np

from localization.filters.base import Place
from localization.filters.belief import HEADING, POSE, Belief, Floats, add, difference, independent, pack, unpack
from localization.filters.health import FilterHealth, HealthStatus, IntegrityMonitor
from localization.filters.odometry import (
    NO_LAG,
    Lag,
    OdometryNoise,
    add_lag,
    move,
    predict,
    predict_state,
    step_between,
    with_parameters,
    with_pose,
)
from localization.filters.range_table import DIRECTIONS, OUTLIER_PROBABILITY, RangeTable
from localization.filters.sonar_ray import NOMAD
from localization.filters.update import CorrelatedReadings, MeasurementUpdate, Refusal, UpdateResult

LOWEST_IN, NOTHING_IN, RANGE_SPAN_IN = NOMAD.min_range_in, NOMAD.max_range_in, NOMAD.range_span_in
"""Limits: "no nearer", which says little, and "nothing", which contradicts an expected echo."""

# 1. The search: all poses that explain the last echoes.

CELL_STD: Final = 2.0 / 3.0
"""Standard deviation of a reading against that from the middle of its cell, in cells: half a diagonal, and more."""
PEAK_CELLS, PEAK_RAD = 2.5, 0.35
"""A pose nearer than this to a better one belongs to the same peak."""
SLIP_IN, SLIP_RAD = 7.5, 0.5
"""An estimate may have slipped by this: a heading by the width of the cone, 25 degrees, over which an echo stays."""
MAX_PEAKS: Final = 100
EVIDENCE_SHARE: Final = 0.3
"""Of the evidence of an echo in the probability of a hypothesis: neighbouring sonars and following rounds meet the same
walls, so their errors are not independent. With 1 wrong poses in a hall or a maze had 99 %."""
MAX_CANDIDATES: Final = 20_000
"""Poses among which peaks are looked for."""
MAX_PEAK_NATS: Final = 40.0
"""A peak this much less likely than the best is no candidate."""
PEAK_STD, PEAK_HEADING_STD_RAD = 0.6, 0.06
"""Standard deviations of a peak before it is refined: of a cell, in cells and radians."""
SAME_SQUARED: Final = 16.27
"""A pose within this squared distance of a belief is the same: chi-square of 3 degrees of freedom, 99.9 %."""
SAME_IN, SAME_RAD = 3.0, 0.15
"""Refined hypotheses nearer than this are one."""
MIN_WEIGHT: Final = 1e-4
"""Hypotheses with less weight than this, against the best, are dropped."""


class EchoRecord(NamedTuple):
    """An echo, and the pose of the encoders (3,) at its instant, in any frame that is common to all records."""

    encoders: Floats
    sonar_rad: float
    sonar: int
    turret_offset_rad: float
    reading_in: float


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A pose at which the robot may be, as a belief at the last record, and its probability."""

    belief: Belief
    probability: float


class Alternatives(NamedTuple):
    """Beliefs over the pose at the last record that explain the echoes, against a given one.

    Attributes
    ----------
    near, elsewhere
        The best one near the given belief, and the best elsewhere; None where none was found.
    lead_nats
        Log likelihood of the better of the two less that of the given belief; -inf without any.
    """

    near: Belief | None
    elsewhere: Belief | None
    lead_nats: float


def search(
    records: Sequence[EchoRecord], table: RangeTable, measurement: MeasurementUpdate, odometry: OdometryNoise
) -> list[Hypothesis]:
    """Return all poses that explain the records, the most probable first; none without records or floor.

    A symmetric map gives as many hypotheses as it has places that look alike.
    """
    explained = _explanations(records, table, measurement, odometry)
    return merged([(belief, EVIDENCE_SHARE * score) for belief, score in explained])


def alternatives(
    given: Belief,
    records: Sequence[EchoRecord],
    table: RangeTable,
    measurement: MeasurementUpdate,
    odometry: OdometryNoise,
) -> Alternatives:
    """Return what else explains the records. Near is within the standard deviation of the belief, or a slip from it."""
    # 1. The given belief, widened by a cell of the grid: nearer poses cannot be distinguished from it.
    wide = Belief(given.mean[:POSE], given.cov[:POSE, :POSE] + np.diag(np.square(_peak_std(table))))
    information = np.linalg.inv(wide.cov)
    # 2. The best explanation near it (True) and elsewhere (False).
    best: dict[bool, tuple[Belief, float]] = {}
    for belief, score in _explanations(records, table, measurement, odometry):
        offset = difference(belief.mean, wide.mean)
        near = bool(offset @ information @ offset <= SAME_SQUARED) or _may_have_slipped(offset)
        if near not in best or score > best[near][1]:
            best[near] = belief, score
    # 3. Both sides are compared by the same echoes, replayed.
    lead = max((score for _, score in best.values()), default=-inf) - _replayed(wide, records, measurement, odometry)[1]
    near_by, elsewhere = (best[near][0] if near in best else None for near in (True, False))
    return Alternatives(near_by, elsewhere, lead)


class SearchResult(NamedTuple):
    """Answer of a search: all hypotheses, or the alternatives to a given belief."""

    hypotheses: list[Hypothesis]
    alternatives: Alternatives | None = None


PendingSearch = Callable[[], SearchResult | None]
"""Returns the answer of a search, None while it runs."""


class PoseSearch(Protocol):
    """Searches for poses on a map; an implementation may run beside the filter."""

    @property
    def progress(self) -> str:
        """Reason why a search still waits, in words; "" if it does not."""
        ...

    def density(self, reading_in: float) -> float:
        """Return the probability density of a reading from an unknown pose."""
        ...

    def start(self, records: Sequence[EchoRecord], given: Belief | None = None) -> PendingSearch:
        """Begin a search for all poses that explain the records, or for the alternatives to a given belief."""
        ...


class TableSearch:
    """Search in this process, which answers at once; the table is built at its first use."""

    progress = ""

    def __init__(
        self, table: Callable[[], RangeTable], measurement: MeasurementUpdate, odometry: OdometryNoise
    ) -> None:
        self._build, self._measurement, self._odometry = table, measurement, odometry

    @cached_property
    def table(self) -> RangeTable:
        """The range table of the map."""
        return self._build()

    def density(self, reading_in: float) -> float:
        """Return the probability density of a reading from an unknown pose."""
        return self.table.density(reading_in)

    def start(self, records: Sequence[EchoRecord], given: Belief | None = None) -> PendingSearch:
        """Return the answer of a search."""
        if given is None:
            result = SearchResult(search(records, self.table, self._measurement, self._odometry))
        else:
            found = alternatives(given, records, self.table, self._measurement, self._odometry)
            result = SearchResult([], found)
        return lambda: result


def merged(weighted: Sequence[tuple[Belief, float]]) -> list[Hypothesis]:
    """Return hypotheses from beliefs with their log likelihoods: one for each pose, without the improbable."""
    # Greedy: a hypothesis absorbs all that are the same pose and less probable.
    ranked = sorted(weighted, key=lambda pair: -pair[1])
    best = ranked[0][1] if ranked else -inf
    chosen: list[tuple[Belief, float]] = []
    for belief, score in ranked:
        weight = float(np.exp(score - best))
        if weight < MIN_WEIGHT:
            break
        if not any(_is_same(belief, other) for other, _ in chosen):
            chosen.append((belief, weight))
    total = sum(weight for _, weight in chosen)
    return [Hypothesis(belief, weight / total) for belief, weight in chosen]


def _explanations(
    records: Sequence[EchoRecord], table: RangeTable, measurement: MeasurementUpdate, odometry: OdometryNoise
) -> list[tuple[Belief, float]]:
    """Return beliefs over all poses that explain the records, each with its log likelihood."""
    places = table.places_in
    if not records or not len(places):
        return []
    # 1. The likelihood of every free cell and heading, from the table.  2. Its peaks.  3. Each refined by the filter.
    poses, score = _coarse(records, table, places)
    peaks, std = _peaks(poses, score, PEAK_CELLS * table.cell_in), _peak_std(table)
    return [_replayed(independent(peak, std), records, measurement, odometry) for peak in peaks]


def _peak_std(table: RangeTable) -> tuple[float, float, float]:
    return PEAK_STD * table.cell_in, PEAK_STD * table.cell_in, PEAK_HEADING_STD_RAD


def _coarse(records: Sequence[EchoRecord], table: RangeTable, places: Floats) -> tuple[Floats, Floats]:
    """Return all poses (n, 3) of the grid at the last record, and their log likelihoods (n,)."""
    # 1. Every free cell with every heading.
    headings = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    score = np.zeros((len(places), DIRECTIONS))
    # 2. Sum of log likelihoods; readings are independent given the pose.
    inlier, cell_std_in = 1.0 - OUTLIER_PROBABILITY, CELL_STD * table.cell_in
    for record in records:
        if record.reading_in <= LOWEST_IN:
            continue
        # Where the robot was then depends on the heading alone: the same step from all places.
        dx, dy, heading = _displaced(np.stack((0.0 * headings, 0.0 * headings, headings), axis=-1),
                                     records[-1].encoders, record.encoders).T  # fmt: skip
        directions = np.rint((heading + record.sonar_rad) * (DIRECTIONS / (2.0 * np.pi))).astype(np.intp) % DIRECTIONS
        ranges, probability = table.look_up(places[:, :1] + dx, places[:, 1:] + dy, directions)
        if record.reading_in >= NOTHING_IN:
            score += np.log(1.0 - inlier * probability)
            continue
        variance = cell_std_in**2 + (0.01 * ranges) ** 2
        hit = probability * np.exp(-0.5 * (record.reading_in - ranges) ** 2 / variance)
        score += np.log(inlier * hit / np.sqrt(2.0 * np.pi * variance) + OUTLIER_PROBABILITY / RANGE_SPAN_IN)
    # 3. As a list of poses.
    poses = np.empty((*score.shape, 3))
    poses[..., :2], poses[..., HEADING] = places[:, None], headings
    return poses.reshape(-1, 3), score.ravel()


def _displaced(poses: Floats, last: Floats, then: Floats) -> Floats:
    """Return where poses (n, 3) were when the encoders stood at `then`, being at `last` now."""
    # Displacement of the encoders, rotated from their frame into that of each pose.
    back = difference(then, last)
    turn = poses[:, HEADING] - last[HEADING]
    cos, sin = np.cos(turn), np.sin(turn)
    there = np.empty_like(poses)
    there[:, 0] = poses[:, 0] + cos * back[0] - sin * back[1]
    there[:, 1] = poses[:, 1] + sin * back[0] + cos * back[1]
    there[:, HEADING] = poses[:, HEADING] + back[HEADING]
    return there


def _peaks(poses: Floats, score: Floats, distance_in: float) -> list[Floats]:
    """Return the best poses (3,), one for each peak: no two within this distance with nearly the same heading."""
    # Non-maximum suppression: take the best pose, drop its neighbours, repeat.
    order = np.argsort(score)[::-1]
    order = order[score[order] > score[order[0]] - MAX_PEAK_NATS][:MAX_CANDIDATES]
    rest = poses[order]
    found: list[Floats] = []
    while len(rest) and len(found) < MAX_PEAKS:
        peak = rest[0]
        found.append(peak)
        offset = difference(rest, np.broadcast_to(peak, rest.shape))
        distance = np.hypot(offset[:, 0], offset[:, 1])
        rest = rest[~((distance < distance_in) & (np.abs(offset[:, HEADING]) < PEAK_RAD))]
    return found


def _replayed(
    last: Belief, records: Sequence[EchoRecord], measurement: MeasurementUpdate, odometry: OdometryNoise
) -> tuple[Belief, float]:
    """Return a belief, moved back to the first record and filtered along all of them, and its log likelihood."""
    start = _displaced(last.mean[None, :], records[-1].encoders, records[0].encoders)[0]
    return continued(Belief(add(start, np.zeros(POSE)), last.cov), records[0].encoders, records, measurement, odometry)


def continued(
    belief: Belief,
    before: Floats,
    records: Sequence[EchoRecord],
    measurement: MeasurementUpdate,
    odometry: OdometryNoise,
) -> tuple[Belief, float]:
    """Return a belief at the encoders `before` (3,), filtered along records since, and their log likelihood."""
    x, P = unpack(belief)
    score = 0.0
    for record in records:
        distance_in, turn_rad = step_between(before, record.encoders).tolist()
        predict_state(x, P, distance_in, turn_rad, odometry)
        score += log(measurement.apply(x, P, record.sonar, record.turret_offset_rad, record.reading_in).likelihood)
        before = record.encoders
    return pack(x, P), score


def _is_same(one: Belief, other: Belief) -> bool:
    offset = difference(one.mean, other.mean)
    return bool(np.hypot(offset[0], offset[1]) < SAME_IN and abs(offset[HEADING]) < SAME_RAD)


def _may_have_slipped(offset: Floats) -> bool:
    return bool(np.hypot(offset[0], offset[1]) < SLIP_IN and abs(offset[HEADING]) < SLIP_RAD)


# 2. The sequential test between an estimate and its alternatives.

DECISION_NATS: Final = 12.0
"""A side that leads all others by so much has won: wrongly in one test of 160,000."""


class Side(Enum):
    """The sides of a test: the estimate, a pose near it, or one elsewhere."""

    HERE = "here"
    NEAR = "near"
    ELSEWHERE = "elsewhere"


class SequentialTest:
    """Compare an estimate with one or two alternatives by the echoes from now on.

        nats(side)  +=  ln( (1 - OUTLIER_PROBABILITY) p(reading | side) + OUTLIER_PROBABILITY p(reading | outlier) )

    An alternative is the best of all poses on a map, so the echoes that selected it are no evidence for it: among so
    many poses some fit any two dozen echoes better than the right one. Echoes from then on are. While the estimate is
    right, the likelihood ratio of any alternative has a mean of 1 at every echo, so it ever exceeds e^n with a
    probability of e^-n at most, if outliers are no more frequent than assumed.

    The estimate may have slipped a little and a pose near it be right: without that side a third pose could win because
    both others are wrong.

    Parameters
    ----------
    near, elsewhere
        The alternatives, None where there is none. The estimate itself is filtered by the caller.

    References
    ----------
    Wald, Sequential tests of statistical hypotheses (1945); Ville, Etude critique de la notion de collectif (1939).
    """

    def __init__(
        self,
        near: Belief | None,
        elsewhere: Belief | None,
        measurement: MeasurementUpdate,
        odometry: OdometryNoise,
    ) -> None:
        self._measurement, self._odometry = measurement, odometry
        beliefs = {Side.NEAR: near, Side.ELSEWHERE: elsewhere}
        self._beliefs = {side: belief for side, belief in beliefs.items() if belief is not None}
        self._nats = dict.fromkeys((Side.HERE, *self._beliefs), 0.0)
        self.echoes = 0
        """Number of echoes so far."""

    def belief(self, side: Side) -> Belief:
        """Return the belief of an alternative.

        Raises
        ------
        KeyError
            This test has no such alternative.
        """
        return self._beliefs[side]

    @property
    def winner(self) -> Side | None:
        """The side that leads all others by DECISION_NATS; None while there is none."""
        return max(self._nats, key=self._nats.__getitem__) if self.lead_nats >= DECISION_NATS else None

    @property
    def lead_nats(self) -> float:
        """Lead of the first side over the second."""
        second, first = sorted(self._nats.values())[-2:]
        return first - second

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict all alternatives after a step that the encoders report."""
        step = np.array((distance_in, turn_rad))
        self._beliefs = {side: predict(belief, step, self._odometry) for side, belief in self._beliefs.items()}

    def update(self, record: EchoRecord, likelihood: float) -> None:
        """Take an echo into account, and its likelihood given the estimate."""
        self.echoes += 1
        self._nats[Side.HERE] += _evidence(record.reading_in, likelihood)
        for side, belief in self._beliefs.items():
            self._beliefs[side], outcome = self._measurement.updated(
                belief, record.sonar, record.turret_offset_rad, record.reading_in
            )
            self._nats[side] += _evidence(record.reading_in, outcome.likelihood)


def _evidence(reading_in: float, likelihood: float) -> float:
    """Return the evidence of an echo of this likelihood, in nats."""
    outlier = 1.0 if reading_in >= NOTHING_IN else 1.0 / RANGE_SPAN_IN
    return log((1.0 - OUTLIER_PROBABILITY) * likelihood + OUTLIER_PROBABILITY * outlier)


# 3. The filter.

MAX_RECORDS: Final = 24
"""Echoes that a search uses: a ring and a half, so that a missing or bad one matters little."""
CAUGHT_UP_UPDATES: Final = 250
"""Updates of late hypotheses for each new echo: about 20 ms."""
MIN_CERTAINTY: Final = 0.99
"""Probability from which one hypothesis is the estimate."""
MIN_LEAD_NATS: Final = 12.0
"""By so much another pose must explain the last echoes better to be tested against the estimate."""
FOUND_STD: Final = (0.5, 0.5, 0.03)
"""Added to a pose that a search found: its echoes selected it, so they say less of it than they seem to."""
UNKNOWN_STD: Final = (1000.0, 1000.0, 3.0)
"""Standard deviations of a belief that knows nothing: inches and radians."""


class GlobalLocalizer:
    """Extended Kalman filter that detects when it is lost, and searches the map; see the head of this file.

    Parameters
    ----------
    belief
        Belief before the first step; None to begin with a search.
    poses
        Searches the map.
    sonar_angles_rad
        Direction of each sonar on the turret.
    parameter_stds
        Standard deviations of the odometry parameters of a pose that was found.
    """

    def __init__(
        self,
        belief: Belief | None,
        measurement: MeasurementUpdate,
        odometry: OdometryNoise,
        poses: PoseSearch,
        sonar_angles_rad: Sequence[float],
        parameter_stds: tuple[float, ...] = (),
        monitor: IntegrityMonitor | None = None,
    ) -> None:
        self._measurement, self._odometry = measurement, odometry
        self._sonar_angles_rad, self._parameter_stds = sonar_angles_rad, parameter_stds
        self._poses = poses
        # A search in progress, and the records since it began.
        self._pending: PendingSearch | None = None
        self._since: list[EchoRecord] = []
        self._searched: Floats = np.zeros(POSE)
        # Hypotheses of a late answer, at the encoders `_searched`.
        self._behind: list[Hypothesis] = []
        self._monitor = monitor or IntegrityMonitor()
        self._encoders, self._correlated = np.zeros(POSE), CorrelatedReadings()
        self._records: deque[EchoRecord] = deque(maxlen=MAX_RECORDS)
        self._new_records = 0
        self._test: SequentialTest | None = None
        self._reason = "the start is unknown"
        self.hypotheses: list[Hypothesis] = [] if belief is None else [Hypothesis(belief, 1.0)]
        """Where the robot may be, the most probable first; none while searching."""

    @property
    def belief(self) -> Belief:
        """The most probable hypothesis; while searching, one that knows nothing."""
        if self.hypotheses:
            return self.hypotheses[0].belief
        return with_parameters(Belief(np.zeros(POSE), np.diag(np.square(UNKNOWN_STD))), self._parameter_stds)

    @property
    def places(self) -> tuple[Place, ...]:
        """All hypotheses."""
        return tuple(Place(hypothesis.belief, hypothesis.probability) for hypothesis in self.hypotheses)

    @property
    def health(self) -> FilterHealth:
        """Health of the estimate."""
        if not self.hypotheses:
            waits = f"; {self._poses.progress}" if self._poses.progress else ""
            return FilterHealth(HealthStatus.LOST, f"searching: {self._reason}{waits}")
        if len(self.hypotheses) > 1:
            best = self.hypotheses[0].probability
            reason = f"{len(self.hypotheses)} places look alike, the likeliest with {best:.0%}"
            return FilterHealth(HealthStatus.LOST, reason)
        return self._monitor.health(self.belief.cov)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict all hypotheses after a step that the encoders report."""
        step = np.array((distance_in, turn_rad))
        self._encoders = move(self._encoders, step)
        self._correlated.move(distance_in, turn_rad)
        self.hypotheses = [
            Hypothesis(predict(hypothesis.belief, step, self._odometry), hypothesis.probability)
            for hypothesis in self.hypotheses
        ]
        if self._test:
            self._test.predict(distance_in, turn_rad)

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by a lag."""
        return add_lag(predict(self.belief, np.array((distance_in, turn_rad)), self._odometry), lag)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct every hypothesis by a reading, and reweight them."""
        # 1. Record the echo; without a hypothesis it serves the search.
        direction = turret_offset_rad + self._sonar_angles_rad[sonar]
        self._records.append(EchoRecord(self._encoders, direction, sonar, turret_offset_rad, reading_in))
        self._new_records += 1
        if self._pending or self._behind:
            self._since.append(self._records[-1])
        if not self.hypotheses:
            return self._search()
        # 2. Correct every hypothesis.
        count = self._correlated.count(sonar, turret_offset_rad) + 1
        outcomes = [
            self._measurement.updated(hypothesis.belief, sonar, turret_offset_rad, reading_in, count)
            for hypothesis in self.hypotheses
        ]
        result = outcomes[0][1]
        if result.refusal is Refusal.NONE:
            self._correlated.record(sonar, turret_offset_rad)
        # 3. One hypothesis: monitor it. Several: weigh them by the likelihood of the reading.
        if len(outcomes) == 1:
            belief, outcome = outcomes[0]
            self.hypotheses = [Hypothesis(belief, 1.0)]
            self._watch(self._records[-1], outcome.likelihood, result)
            return result
        self.hypotheses = merged(
            [
                (belief, log(before.probability) + EVIDENCE_SHARE * log(outcome.likelihood))
                for before, (belief, outcome) in zip(self.hypotheses, outcomes, strict=True)
            ]
        )
        if self.hypotheses[0].probability > MIN_CERTAINTY:
            self.hypotheses = [Hypothesis(self.hypotheses[0].belief, 1.0)]
            self._monitor.reset()
        return result

    def _watch(self, record: EchoRecord, likelihood: float, result: UpdateResult) -> None:
        """Monitor the one hypothesis; give it up once it is lost."""
        if record.reading_in <= LOWEST_IN:
            return
        is_limit = result.refusal is Refusal.LIMIT
        self._monitor.add_evidence(likelihood, self._poses.density(record.reading_in), None if is_limit else result)
        if self._test:
            self._test.update(record, likelihood)
            self._decide(self._test)
        elif self._pending:
            self._take_alternatives()
        if self._monitor.is_lost:
            self._give_up(self._monitor.reason)
        elif self._monitor.is_suspicious and not self._test and not self._pending and (
            self._new_records >= MAX_RECORDS // 2
        ):
            self._look_for_alternatives()

    def _look_for_alternatives(self) -> None:
        """Search for poses that explain more."""
        self._new_records = 0
        self._begin(self.belief)
        self._take_alternatives()

    def _take_alternatives(self) -> None:
        """Test alternatives that a search has found against the estimate."""
        found = self._answer()
        if found is None or found.alternatives is None or found.alternatives.lead_nats < MIN_LEAD_NATS:
            return
        near, elsewhere = (
            belief and self._caught_up(with_pose(_widened(belief), self.belief))[0]
            for belief in found.alternatives[:2]
        )
        self._test = SequentialTest(near, elsewhere, self._measurement, self._odometry)

    def _begin(self, given: Belief | None = None) -> None:
        """Begin a search by the last records."""
        self._pending, self._since = self._poses.start(list(self._records), given), []
        self._searched = self._records[-1].encoders

    def _answer(self) -> SearchResult | None:
        """Return the answer of a search once."""
        found = self._pending() if self._pending else None
        if found is not None:
            self._pending = None
        return found

    def _caught_up(self, belief: Belief) -> tuple[Belief, float]:
        """Return a belief at the last record of a search, filtered along the records since, and their likelihood."""
        return continued(belief, self._searched, self._since, self._measurement, self._odometry)

    def _decide(self, test: SequentialTest) -> None:
        """End a test that is decided, or has lasted long enough."""
        winner = test.winner
        if winner is Side.ELSEWHERE:
            self._give_up(f"another place explains the readings better, by e^{test.lead_nats:.0f}")
        elif winner is Side.NEAR:
            self.hypotheses = [Hypothesis(test.belief(Side.NEAR), 1.0)]
            self._monitor.reset()
        if winner is not None or test.echoes >= MAX_RECORDS // 2:
            self._test = None

    def _give_up(self, reason: str) -> None:
        """Begin a search, with the echoes from now on."""
        self._reason = reason
        self._monitor.reset()
        self._test = self._pending = None
        self.hypotheses, self._behind = [], []
        self._new_records = 0

    def _search(self) -> UpdateResult:
        """Begin a search when there are enough records, and take its answer."""
        if self._pending is None and not self._behind and self._new_records >= MAX_RECORDS:
            self._new_records = MAX_RECORDS // 2
            self._begin()
        found = self._answer()
        if found is not None:
            self._behind = [
                Hypothesis(with_parameters(_widened(place.belief), self._parameter_stds), place.probability)
                for place in found.hypotheses
            ]
        if self._behind:
            self._catch_up()
        return UpdateResult(Refusal.LIMIT, 0.0, 0.0, 1.0)

    def _catch_up(self) -> None:
        """Filter the hypotheses of a late answer along some of the records since; they count once none is left."""
        # 1. More records than come, and a bounded number of updates: improbable hypotheses are dropped on the way.
        count = max(2, CAUGHT_UP_UPDATES // len(self._behind))
        records, self._since = self._since[:count], self._since[count:]
        if records:
            advanced = [
                (continued(each.belief, self._searched, records, self._measurement, self._odometry), each.probability)
                for each in self._behind
            ]
            self._searched = records[-1].encoders
            self._behind = merged(
                [(belief, log(probability) + EVIDENCE_SHARE * nats) for (belief, nats), probability in advanced]
            )
        # 2. All are up to date.
        if not self._since:
            self.hypotheses, self._behind = self._behind, []
            self._monitor.reset()


def _widened(belief: Belief) -> Belief:
    """Return a belief over a pose, FOUND_STD wider."""
    return Belief(belief.mean, belief.cov + np.diag(np.square(FOUND_STD)))
