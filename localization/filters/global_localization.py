"""Global localization: a filter that detects when it is lost, and finds the robot again.

    tracking     one hypothesis under an IntegrityMonitor. Where it is suspicious, a search looks for another pose that
                 explains the last echoes better. One that does is compared with it by the echoes from then on
                 (SequentialTest): elsewhere and better --> LOST, searching; nearby and better: the estimate moves
    searching    echoes are collected for a ring and a half, then a search of the map gives several hypotheses
    choosing     the hypotheses are filtered along the echoes since, ring by ring, and weighed by them; the improbable
                 ones are dropped, and further searches by the whole history add what was missed. One left with more
                 than MIN_CERTAINTY, by a search and by the echoes after it --> tracking

It begins with tracking from a given belief; with searching without one, or where the belief is wide. Searching and
choosing are the work of a `pose_search.PoseSearch`, beside the updates. The caller reads `health` and `places` and
decides what to do meanwhile (stand, turn, drive on slowly). No part of it is random.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import Enum
from math import log
from typing import Final

import numpy as np

from localization.filters import pose_search, update
from localization.filters.base import Filter, Place
from localization.filters.belief import POSE, Belief, Floats, wrap_angle
from localization.filters.health import FilterHealth, HealthStatus, IntegrityMonitor
from localization.filters.odometry import NO_LAG, Lag, OdometryNoise, add_lag, move, predict, with_parameters, with_pose
from localization.filters.pose_search import LAST_RECORDS, EchoRecord, PoseSearch, SearchRequest, moved
from localization.filters.range_table import OUTLIER_PROBABILITY
from localization.filters.update import MeasurementUpdate, Refusal, UpdateResult

# 1. The sequential test between an estimate and its alternatives.

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

    def __init__(self, near: Belief | None, elsewhere: Belief | None, measurement: MeasurementUpdate,
                 odometry: OdometryNoise) -> None:  # fmt: skip
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
    outlier = 1.0 if reading_in >= pose_search.NOTHING_IN else 1.0 / pose_search.RANGE_SPAN_IN
    return log((1.0 - OUTLIER_PROBABILITY) * likelihood + OUTLIER_PROBABILITY * outlier)


# 2. The filter.

MAX_HISTORY: Final = 320
"""Records that a search uses: the last twenty seconds."""
MIN_ADVANCED: Final = 16
"""Records by which hypotheses are advanced at once: a ring."""
SEARCH_INTERVAL: Final = 96
"""Records between two searches of the map while several hypotheses are left."""
MAX_BEHIND: Final = 32
"""Records along which an update filters one hypothesis at most: 5 ms."""
MIN_CERTAINTY: Final = 0.995
"""Probability from which one hypothesis is the estimate."""
MAX_PLACES: Final = 10
"""Hypotheses that are reported."""
ALIKE_WEIGHT: Final = 0.01
"""Of a pose that looks like a given start, against the start: that who gave it took the wrong door."""
MIN_LEAD_NATS: Final = 12.0
"""By so much another pose must explain the last echoes better to be tested against the estimate."""
FOUND_STD: Final = (0.5, 0.5, 0.03)
"""Added to a pose that a search found: its echoes selected it, so they say less of it than they seem to."""
UNKNOWN_STD: Final = (1000.0, 1000.0, 3.0)
"""Standard deviations of a belief that knows nothing: inches and radians."""
WIDE_IN, WIDE_RAD = 12.0, 0.5
"""Standard deviations of a belief that may cover several poses: more than a filter of one hypothesis converges from."""


def is_wide(belief: Belief) -> bool:
    """Return True if a belief may cover several poses."""
    return bool((belief.std[:POSE] > (WIDE_IN, WIDE_IN, WIDE_RAD)).any())


class GlobalLocalizer(Filter):
    """Extended Kalman filter that detects when it is lost, and searches the map; see the head of this file.

    Parameters
    ----------
    belief
        Belief before the first step; None to begin with a search. A wide belief is the prior of a search.
    poses
        Searches the map.
    sonar_angles_rad
        Direction of each sonar on the turret.
    parameter_stds
        Standard deviations of the odometry parameters of a pose that was found.
    alike
        Poses (3,) that look like that of the belief; they stay beside the estimate until readings exclude them.
    """

    def __init__(self, belief: Belief | None, measurement: MeasurementUpdate, odometry: OdometryNoise,
                 poses: PoseSearch, sonar_angles_rad: Sequence[float], parameter_stds: tuple[float, ...] = (),
                 monitor: IntegrityMonitor | None = None, alike: Sequence[Floats] = ()) -> None:  # fmt: skip
        self._measurement, self._odometry = measurement, odometry
        self._replay = pose_search.EchoReplay(measurement, odometry)
        self._replay.load()
        self._sonar_angles_rad, self._parameter_stds = sonar_angles_rad, parameter_stds
        self._poses = poses
        self._monitor = monitor or IntegrityMonitor()
        self._encoders, self._used = np.zeros(POSE), update.new_used()
        self._last: deque[EchoRecord] = deque(maxlen=LAST_RECORDS)
        self._new_records = 0
        self._test: SequentialTest | None = None
        self._reason = "the start is unknown"
        # 1. A request in progress, the records since, and the encoders at its last record.
        self._pending: pose_search.PendingSearch | None = None
        self._since: list[EchoRecord] = []
        self._requested: Floats = np.zeros(POSE)
        # 2. While lost: the history, the hypotheses at `_requested`, and whether a search and an advance agree.
        self._history: deque[EchoRecord] = deque(maxlen=MAX_HISTORY)
        self._hypotheses: list[Place] = []
        self._turn: tuple[float, float] | None = None
        self._is_search, self._is_confirmed = True, False
        self._until_search = 0
        # 3. The estimate, None while lost; a wide one is where the search begins.
        wide = belief is not None and is_wide(belief)
        self._estimate = None if wide else belief
        self._prior = pose_search.Prior(belief.pose, self._encoders) if wide and belief is not None else None
        if wide:
            self._reason = "the start is too uncertain"
        self._alike: list[Place] = []
        if self._estimate is not None:
            cov = self._estimate.cov[:POSE, :POSE]
            self._alike = [
                Place(with_pose(Belief(np.array(pose), cov), self._estimate), ALIKE_WEIGHT)
                for pose in alike[:MAX_PLACES]
            ]

    @property
    def places(self) -> tuple[Place, ...]:
        """Poses that are possible, the most probable first, or the estimate; none while searching."""
        if self._estimate is not None:
            total = 1.0 + sum(each.probability for each in self._alike)
            beside = [Place(each.belief, each.probability / total) for each in self._alike]
            return (Place(self._estimate, 1.0 / total), *beside)
        # Moved on by the encoders: filtered along the echoes since they are a little later.
        return tuple(
            Place(moved(each.belief, self._requested, self._encoders), each.probability)
            for each in self._hypotheses[:MAX_PLACES]
        )

    @property
    def belief(self) -> Belief:
        """The most probable hypothesis; while searching, one that knows nothing."""
        if self._estimate is not None:
            return self._estimate
        if self._hypotheses:
            return moved(self._hypotheses[0].belief, self._requested, self._encoders)
        if self._prior:
            return with_parameters(moved(*self._prior, self._encoders), self._parameter_stds)
        return with_parameters(Belief(np.zeros(POSE), np.diag(np.square(UNKNOWN_STD))), self._parameter_stds)

    @property
    def informative_turn_rad(self) -> float | None:
        """Turn from the present heading towards where the hypotheses differ soonest; None without such a direction."""
        if self._estimate is not None or self._turn is None:
            return None
        turn_rad, heading = self._turn
        return float(wrap_angle(turn_rad + heading - self._encoders.item(2)))

    @property
    def health(self) -> FilterHealth:
        """Health of the estimate."""
        if self._estimate is not None:
            return self._monitor.health(self._estimate.cov)
        if not self._hypotheses:
            waits = f"; {self._poses.progress}" if self._poses.progress else ""
            return FilterHealth(HealthStatus.LOST, f"searching: {self._reason}{waits}")
        best = self._hypotheses[0].probability
        if len(self._hypotheses) == 1:
            return FilterHealth(HealthStatus.LOST, "one place found, to be confirmed")
        reason = f"{len(self._hypotheses)} places look alike, the likeliest with {best:.0%}"
        return FilterHealth(HealthStatus.LOST, reason)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the estimate after a step that the encoders report."""
        step = np.array((distance_in, turn_rad))
        self._encoders = move(self._encoders, step)
        update.move_on(self._used, distance_in, turn_rad)
        if self._estimate is not None:
            self._estimate = predict(self._estimate, step, self._odometry)
            self._alike = [Place(predict(each.belief, step, self._odometry), each.probability) for each in self._alike]
        if self._test:
            self._test.predict(distance_in, turn_rad)

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by a lag."""
        return add_lag(predict(self.belief, np.array((distance_in, turn_rad)), self._odometry), lag)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the estimate by a reading; without an estimate, search by it."""
        # 1. Record the echo.
        direction = turret_offset_rad + self._sonar_angles_rad[sonar]
        record = EchoRecord(self._encoders, direction, sonar, turret_offset_rad, reading_in)
        self._last.append(record)
        self._new_records += 1
        if self._estimate is None:
            self._choose(record)
            return UpdateResult(Refusal.LIMIT, 0.0, 0.0, 1.0)
        if self._pending:
            self._since.append(record)
        # 2. Correct and monitor the estimate.
        count = update.count_used(self._used, sonar, turret_offset_rad) + 1
        self._estimate, result = self._measurement.updated(self._estimate, sonar, turret_offset_rad, reading_in, count)
        if result.refusal is Refusal.NONE:
            update.record_used(self._used, sonar, turret_offset_rad, count)
        self._compare(record, count, result.likelihood)
        if self._estimate is not None:
            self._watch(record, result)
        return result

    # tracking

    def _compare(self, record: EchoRecord, count: int, likelihood: float) -> None:
        """Weigh the poses that look like the estimate by an echo, against the estimate."""
        beside = []
        for each in self._alike:
            belief, result = self._measurement.updated(each.belief, record.sonar, record.turret_offset_rad,
                                                       record.reading_in, count)
            weight = each.probability * (result.likelihood / likelihood) ** pose_search.EVIDENCE_SHARE
            if weight >= ALIKE_WEIGHT * pose_search.MIN_WEIGHT:
                beside.append(Place(belief, weight))
        self._alike = sorted(beside, key=lambda each: -each.probability)
        if self._alike and self._alike[0].probability > 1.0:
            self._give_up("a place that looks like the start explains the readings better")

    def _watch(self, record: EchoRecord, result: UpdateResult) -> None:
        """Monitor the estimate; give it up once it is lost."""
        if record.reading_in <= pose_search.LOWEST_IN:
            return
        is_limit, likelihood = result.refusal is Refusal.LIMIT, result.likelihood
        self._monitor.add_evidence(likelihood, self._poses.density(record.reading_in), None if is_limit else result)
        if self._test:
            self._test.update(record, likelihood)
            self._decide(self._test)
        elif self._pending:
            self._take_alternatives()
        if self._monitor.is_lost:
            self._give_up(self._monitor.reason)
        elif self._monitor.is_suspicious and not self._test and not self._pending and (
            self._new_records >= LAST_RECORDS // 2
        ):
            self._new_records = 0
            self._request(SearchRequest([*self._last], given=self._estimate))
            self._take_alternatives()

    def _take_alternatives(self) -> None:
        """Test alternatives that a search has found against the estimate."""
        answer, since, estimate = self._answer(), self._since, self._estimate
        found = answer.alternatives if answer else None
        # An answer so late that an update could not bring it up to date is dropped: the next one will be quick.
        if found is None or estimate is None or found.lead_nats < MIN_LEAD_NATS or len(since) > MAX_BEHIND:
            return
        near, elsewhere = (
            belief and self._replay.run(with_pose(_widened(belief), estimate), self._requested, since)[0]
            for belief in found[:2]
        )
        self._test = SequentialTest(near, elsewhere, self._measurement, self._odometry)

    def _decide(self, test: SequentialTest) -> None:
        """End a test that is decided, or has lasted long enough."""
        winner = test.winner
        if winner is Side.ELSEWHERE:
            self._give_up(f"another place explains the readings better, by e^{test.lead_nats:.0f}")
        elif winner is Side.NEAR:
            self._estimate, self._alike = test.belief(Side.NEAR), []
            self._monitor.reset()
        if winner is not None or test.echoes >= LAST_RECORDS // 2:
            self._test = None

    def _give_up(self, reason: str) -> None:
        """Begin a search, with the echoes from now on."""
        self._reason = reason
        self._monitor.reset()
        self._test = self._pending = self._estimate = self._prior = self._turn = None
        self._hypotheses, self._alike = [], []
        self._history.clear()
        self._since = []

    # searching and choosing

    def _request(self, request: SearchRequest) -> None:
        """Begin a request; records from now on come after it."""
        self._pending, self._since = self._poses.start(request), []
        self._requested, self._is_search = request.records[-1].encoders, request.searches

    def _answer(self) -> pose_search.SearchResult | None:
        """Return the answer of a request once."""
        found = self._pending() if self._pending else None
        if found is not None:
            self._pending = None
        return found

    def _choose(self, record: EchoRecord) -> None:
        """Take the answer of a request, decide by it, and make the next one."""
        self._history.append(record)
        self._since.append(record)
        self._until_search -= 1
        if self._pending is None:
            self._ask()
        if answer := self._answer():
            self._take(answer)

    def _take(self, answer: pose_search.SearchResult) -> None:
        """Take hypotheses; the estimate is one that two answers agree upon."""
        before, self._hypotheses = self._hypotheses, answer.hypotheses
        self._turn = None if answer.turn_rad is None else (answer.turn_rad, self._requested.item(2))
        best = self._hypotheses[0] if self._hypotheses else None
        is_certain = best is not None and best.probability > MIN_CERTAINTY
        # 1. Certain by the echoes after a search, not by those alone that selected it.
        if best and is_certain and self._is_confirmed and not self._is_search and len(self._since) <= MAX_BEHIND:
            belief, _ = self._replay.run(_widened(best.belief), self._requested, self._since)
            self._estimate, self._hypotheses, self._prior = belief, [], None
            self._monitor.reset()
            self._since, self._new_records = [], 0
        # 2. A search confirms what it finds alone.
        elif self._is_search:
            self._is_confirmed = is_certain
        elif is_certain and not self._is_confirmed and before:
            self._until_search = 0

    def _ask(self) -> None:
        """Advance the hypotheses by a ring, or search again; first when there are enough records."""
        # After an answer that took longer than the history, while a table was built, everything begins again.
        if len(self._since) > MAX_HISTORY:
            self._hypotheses = []
        if not self._hypotheses:
            if len(self._history) >= LAST_RECORDS and len(self._since) >= LAST_RECORDS // 2:
                self._until_search = SEARCH_INTERVAL
                self._search()
        elif len(self._since) >= MIN_ADVANCED:
            if self._until_search <= 0:
                self._until_search = SEARCH_INTERVAL
                self._search()
            else:
                self._request(SearchRequest(self._since, self._hypotheses, self._requested, searches=False))

    def _search(self) -> None:
        before = self._requested if self._hypotheses else None
        self._request(
            SearchRequest([*self._history], self._hypotheses, before, self._since, prior=self._prior,
                          parameter_stds=self._parameter_stds)
        )  # fmt: skip


def _widened(belief: Belief) -> Belief:
    """Return a belief over a pose, or a longer state, the pose FOUND_STD wider."""
    cov = belief.cov.copy()
    cov[range(POSE), range(POSE)] += np.square(FOUND_STD)
    return Belief(belief.mean, cov)
