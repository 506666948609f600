"""Search of a map for all poses that explain a history of echoes, and for what else explains the last ones.

    search          table --> likelihood of every cell and heading --> peaks --> each filtered along the history
    advanced        hypotheses filtered along the echoes since, and weighed by them
    alternatives    the best pose near a given belief, and the best elsewhere

None of it is part of an update of the robot's filter: a `PoseSearch` does it, in a worker process where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from math import inf, log
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.filters import compiled
from localization.filters.base import Place
from localization.filters.belief import HEADING, POSE, Belief, Floats, add, difference, independent, pack, unpack
from localization.filters.filter_loop import StateInput, filter_config, filter_ring, new_memory
from localization.filters.health import HealthLimits
from localization.filters.odometry import OdometryNoise, step_between, with_parameters
from localization.filters.range_table import CODES, DIRECTIONS, OUTLIER_PROBABILITY, RangeTable, decoded
from localization.filters.sonar_ray import NOMAD
from localization.filters.update import MeasurementUpdate, Outcome

LOWEST_IN, NOTHING_IN, RANGE_SPAN_IN = NOMAD.min_range_in, NOMAD.max_range_in, NOMAD.range_span_in
"""Limits: "so near or nearer", which says little, and "nothing", which contradicts an expected echo."""
CELL_STD: Final = 2.0 / 3.0
"""Standard deviation of a reading against that from the middle of its cell, in cells: half a diagonal, and more."""
ODOMETRY_STD: Final = 0.05
"""Error of the encoders along a history, as a fraction of the distance: wheels of other diameters, and slips."""
PEAK_CELLS, PEAK_RAD = 2.5, 0.35
"""A pose nearer than this to a better one belongs to the same peak."""
SLIP_IN, SLIP_RAD = 7.5, 0.5
"""An estimate may have slipped by this: a heading by the width of the cone, 25 degrees, over which an echo stays."""
HEADINGS_RAD: Final[Floats] = np.arange(DIRECTIONS, dtype=np.float64) * (2.0 * np.pi / DIRECTIONS)
"""Headings of the grid."""
MAX_PEAKS: Final = 100
MAX_CANDIDATES: Final = 20_000
"""Poses among which peaks are looked for."""
MAX_FINE_SQUARES: Final = 500
"""Coarse places around which a search of a large map looks closer."""
EVIDENCE_SHARE: Final = 0.3
"""Of the evidence of an echo in the probability of a hypothesis: neighbouring sonars and following rounds meet the same
walls, so their errors are not independent. With 1 wrong poses in a hall or a maze had 99 %."""
MAX_PEAK_NATS: Final = 40.0
"""A peak this much less likely than the best is no candidate."""
PEAK_STD, PEAK_HEADING_STD_RAD = 0.6, 0.06
"""Standard deviations of a peak before it is refined: of a cell, in cells and radians."""
PEAK_TURNS_RAD: Final = (0.0, -0.08, 0.08)
"""A peak is refined from its own heading and beside it: over much of a cone the likelihood is flat, and a filter that
begins off the right heading stays there. Peaks at equal places, each off by chance, would not be equally probable."""
COARSE_RECORDS: Final = 72
"""Records that decide the peaks: the last ring and a half, and an even choice of the older ones."""
LAST_RECORDS: Final = 24
"""A ring and a half of echoes, so that a missing or bad one matters little."""
REFINED_RECORDS: Final = 48
"""Records along which all peaks are filtered first."""
MAX_REFINED: Final = 60
"""Hypotheses that are filtered along the whole history."""
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


class Prior(NamedTuple):
    """A belief over the pose (3,) when the encoders stood at `encoders` (3,)."""

    belief: Belief
    encoders: Floats


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


class EchoReplay:
    """Filter beliefs along records, by the loop of the extended Kalman filter.

    The measurement is by a model with an update of its own.
    """

    def __init__(self, measurement: MeasurementUpdate, odometry: OdometryNoise) -> None:
        assert measurement.direct is not None
        self._direct, self.odometry = measurement.direct, odometry

    @cached_property
    def _compiled(self) -> compiled.CompiledFilter | None:
        """The compiled loop, where that is wanted."""
        return compiled.filter_of(filter_config(self.odometry, self._direct, HealthLimits()))

    def load(self) -> None:
        """Load compiled code now, which takes longer than an update may."""
        bool(self._compiled)

    def run(self, belief: Belief, before: Floats, records: Sequence[EchoRecord]) -> tuple[Belief, float]:
        """Return a belief at the encoders `before` (3,), filtered along records since, and their log likelihood."""
        x: Any
        P: Any
        x, P = (belief.mean.copy(), belief.cov.copy()) if self._compiled else unpack(belief)
        nats = sum(log(likelihood) for _, _, _, _, likelihood, _ in self._outcomes(x, P, before, records))
        return pack(x, P), nats

    def _outcomes(self, x: list[float], P: list[list[float]], before: Floats,
                  records: Sequence[EchoRecord]) -> list[Outcome]:
        """Filter x, P along records in place, and return the outcome of each."""
        # The number of a record is its instant, so a ring's poses are looked up and not interpolated.
        direct, outcomes = self._direct, list[Outcome]()
        memory = new_memory(x, P, as_array=self._compiled is not None)
        at = (-1.0, *before.tolist(), 0.0)
        for first in range(0, len(records), LAST_RECORDS):
            part = records[first : first + LAST_RECORDS]
            poses = [at] + [
                (float(first + k), *each.encoders.tolist(), each.encoders.item(HEADING) + each.turret_offset_rad)
                for k, each in enumerate(part)
            ]
            echoes = [(float(first + k), each.sonar, each.reading_in) for k, each in enumerate(part)]
            if self._compiled:
                state = StateInput(at, poses, echoes, 0.0, detects_slips=False)
                outcomes += self._compiled.filter(memory, state, POSE)[0]
            else:
                outcomes += filter_ring(x, P, memory.used, [], at, poses, echoes, self.odometry, direct,
                                        direct.update)[0]
            at = poses[-1]
        return outcomes


# 1. All poses.


def search(records: Sequence[EchoRecord], table: RangeTable, replay: EchoReplay, parameter_stds: tuple[float, ...] = (),
           others: Sequence[Place] = (), prior: Prior | None = None) -> list[Place]:  # fmt: skip
    """Return all poses that explain the records, the most probable first; none without records or floor.

    A symmetric map gives as many hypotheses as it has places that look alike.

    Parameters
    ----------
    records
        The history, its last records first of all.
    parameter_stds
        Standard deviations of the odometry parameters of the beliefs.
    others
        Hypotheses so far, at the last record. They keep the weights that echoes before the records gave them; new ones
        are weighed against them by the records.
    prior
        What is known of the pose without the records. Default: nothing.
    """
    if not records:
        return []
    # 1. The last records decide among all peaks.
    last = records[-REFINED_RECORDS:]
    refined = [_refined(belief, last, replay) for belief in _peaks(records, table, prior)]
    refined.sort(key=lambda pair: -pair[1])
    best = [with_parameters(belief, parameter_stds) for belief, _ in refined[:MAX_REFINED]]
    # 2. The whole history, and what was known before it, decide among the best of them.
    weighted = []
    for belief in best:
        explained, nats = _replayed(belief, records, replay)
        weighted.append((explained, EVIDENCE_SHARE * nats + _log_prior(explained, records[-1].encoders, prior)))
    if not others or not weighted:
        return merged(weighted)
    # 3. The hypotheses so far stay; what the records explain elsewhere is added, its weight by that of those found
    #    again and never above the best: echoes that select a pose are no evidence for it.
    best_nats = log(others[0].probability)
    pairs = [(each, next((k for k in others if _is_same(each[0], k.belief)), None)) for each in weighted]
    again = [score - log(same.probability) for (_, score), same in pairs if same]
    offset = float(np.median(again)) if again else max(score for _, score in weighted) - best_nats
    new = [(belief, min(score - offset, best_nats)) for (belief, score), same in pairs if not same]
    return merged([*((other.belief, log(other.probability)) for other in others), *new])


def advanced(hypotheses: Sequence[Place], before: Floats, records: Sequence[EchoRecord],
             replay: EchoReplay) -> list[Place]:
    """Return hypotheses at the encoders `before` (3,), filtered along records since and weighed by them."""
    replayed = [replay.run(hypothesis.belief, before, records) for hypothesis in hypotheses]
    return merged([
        (belief, log(hypothesis.probability) + EVIDENCE_SHARE * nats)
        for hypothesis, (belief, nats) in zip(hypotheses, replayed, strict=True)
    ])


def merged(weighted: Sequence[tuple[Belief, float]]) -> list[Place]:
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
    return [Place(belief, weight / total) for belief, weight in chosen]


def moved(belief: Belief, last: Floats, then: Floats) -> Belief:
    """Return a belief at the encoders `last` (3,) as of the encoders `then`; its covariance stays."""
    mean = belief.mean.copy()
    mean[:POSE] = _displaced(mean[None, :POSE], last, then)[0]
    return Belief(add(mean, np.zeros_like(mean)), belief.cov)


def _replayed(last: Belief, records: Sequence[EchoRecord], replay: EchoReplay) -> tuple[Belief, float]:
    """Return a belief, moved back to the first record and filtered along all of them, and its log likelihood."""
    # What the encoders may have missed on the way back is added to its variance.
    steps = step_between(*(np.array([record.encoders for record in part]) for part in (records[:-1], records[1:])))
    distance_in, turn_rad = np.abs(steps.reshape(-1, 2)).sum(axis=0).tolist()
    start = moved(last, records[-1].encoders, records[0].encoders)
    cov = start.cov.copy()
    drift_rad = replay.odometry.drift_std * distance_in**0.5 + replay.odometry.rotation_std * turn_rad**0.5
    across_in = ODOMETRY_STD * distance_in + 0.5 * drift_rad * distance_in
    cov[range(POSE), range(POSE)] += np.square((across_in, across_in, drift_rad))
    return replay.run(Belief(start.mean, cov), records[0].encoders, records)


def _refined(peak: Belief, records: Sequence[EchoRecord], replay: EchoReplay) -> tuple[Belief, float]:
    """Return `_replayed` from the heading of PEAK_TURNS_RAD that explains the records best."""
    starts = [Belief(add(peak.mean, np.array((0.0, 0.0, turn_rad))), peak.cov) for turn_rad in PEAK_TURNS_RAD]
    return max((_replayed(start, records, replay) for start in starts), key=lambda pair: pair[1])


def _log_prior(belief: Belief, last: Floats, prior: Prior | None) -> float:
    """Return the log density of a belief at the encoders `last`, by what was known before."""
    if prior is None:
        return 0.0
    then = moved(belief, last, prior.encoders)
    offset = difference(then.mean[:POSE], prior.belief.mean[:POSE])
    S = prior.belief.cov[:POSE, :POSE] + then.cov[:POSE, :POSE]
    return float(-0.5 * offset @ np.linalg.solve(S, offset))


def _is_same(one: Belief, other: Belief) -> bool:
    offset = difference(one.mean, other.mean)
    return bool(np.hypot(offset[0], offset[1]) < SAME_IN and abs(offset[HEADING]) < SAME_RAD)


# 2. The likelihood of every cell and heading, and its peaks.


def _peaks(records: Sequence[EchoRecord], table: RangeTable, prior: Prior | None = None) -> list[Belief]:
    """Return beliefs over the pose (3,) at the last record, one for each peak of the likelihood, the best first."""
    if not records or not len(table.coarse_places):
        return []
    # 1. The coarse places with all headings; on a small map all places.
    chosen = _chosen(records)
    place, row = _coarse(chosen, records[-1], table, prior)
    # 2. The places around the best of them.
    if table.coarse_cells > 1:
        place, row = _finer(place, row, table)
        nats = _fine(place, row, chosen, records[-1], table)
        nats += _log_density(place, row, records[-1], table, prior)
        best = np.argsort(-nats, kind="stable")
        best = best[nats[best] >= nats[best[0]] - MAX_PEAK_NATS]
        place, row = place[best], row[best]
    poses = np.column_stack((table.places_in[place], HEADINGS_RAD[row]))
    std = _peak_std(table)
    return [independent(peak, std) for peak in _maxima(poses, PEAK_CELLS * table.cell_in)]


def _peak_std(table: RangeTable, cells: int = 1) -> tuple[float, float, float]:
    std_in = PEAK_STD * table.cell_in * cells
    return std_in, std_in, PEAK_HEADING_STD_RAD


Weighed = list[tuple[EchoRecord, float]]
"""Records that decide the peaks, each with the distance driven since (in)."""
Numbers = npt.NDArray[np.intp]


def _chosen(records: Sequence[EchoRecord]) -> Weighed:
    """Return the records that decide the peaks: no limits "so near or nearer"."""
    chosen = [*_spread(records[:-LAST_RECORDS], COARSE_RECORDS - LAST_RECORDS), *records[-LAST_RECORDS:]]
    steps = [0.0] + [float(np.hypot(*(b.encoders - a.encoders)[:2])) for a, b in pairwise(chosen)]
    since_in = (sum(steps) - np.cumsum(steps)).tolist()
    return [pair for pair in zip(chosen, since_in, strict=True) if pair[0].reading_in > LOWEST_IN]


def _shifts(record: EchoRecord, last: EchoRecord) -> tuple[Floats, Floats, Numbers]:
    """Return for each heading at the last record the step from there to a record, and the direction of its sonar.

    Where the robot was then depends on the heading alone: the same step from all places.
    """
    dx, dy, heading = _displaced(np.stack((0.0 * HEADINGS_RAD, 0.0 * HEADINGS_RAD, HEADINGS_RAD), axis=-1),
                                 last.encoders, record.encoders).T  # fmt: skip
    directions = np.rint((heading + record.sonar_rad) * (DIRECTIONS / (2.0 * np.pi))).astype(np.intp) % DIRECTIONS
    return dx, dy, directions


def _coarse(chosen: Weighed, last: EchoRecord, table: RangeTable, prior: Prior | None) -> tuple[Numbers, Numbers]:
    """Return places and rows of HEADINGS_RAD (k,) of the best coarse poses, the best first."""
    # 1. Sum of log likelihoods; readings are independent given the pose.
    places = table.coarse_places
    score = np.zeros((DIRECTIONS, len(places)), dtype=np.float32)
    for record, driven_in in chosen:
        nats = _log_likelihoods(record.reading_in, table.cell_in * table.coarse_cells, driven_in)
        shifts = (part.tolist() for part in _shifts(record, last))
        for row, (x_in, y_in, direction) in enumerate(zip(*shifts, strict=True)):
            score[row] += nats[table.codes_beside(x_in, y_in, direction)]
    # Heading by heading: an array of all poses would be large on a large map.
    for row in range(DIRECTIONS if prior else 0):
        score[row] += _log_density(places, np.full(len(places), row), last, table, prior, table.coarse_cells)
    # 2. The best, and those not much worse.
    nats = score.ravel()
    count = min(MAX_CANDIDATES, len(nats))
    lowest = np.partition(nats, len(nats) - count)[len(nats) - count]
    order = np.flatnonzero(nats >= max(float(lowest), float(nats.max()) - MAX_PEAK_NATS))
    order = order[np.argsort(-nats[order], kind="stable")][:count]
    row_of, place_of = np.divmod(order, len(places))
    return places[place_of], row_of


def _finer(place: Numbers, row: Numbers, table: RangeTable) -> tuple[Numbers, Numbers]:
    """Return places and rows of HEADINGS_RAD (n,) of all poses for which the best coarse ones stand."""
    _, first = np.unique(place, return_index=True)
    best = np.sort(first)[:MAX_FINE_SQUARES]
    is_chosen = np.isin(place, place[best])
    place, row = place[is_chosen], row[is_chosen]
    # Places in the order of their squares: those of one follow one another.
    order = np.argsort(table.representative[:-1], kind="stable")
    bounds = table.representative[:-1][order]
    begin, end = (np.searchsorted(bounds, place, side) for side in ("left", "right"))
    counts = end - begin
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return order[np.repeat(begin, counts) + within], np.repeat(row, counts)


def _fine(place: Numbers, row: Numbers, chosen: Weighed, last: EchoRecord, table: RangeTable) -> Floats:
    """Return the log likelihoods (n,) of poses at places with headings of these rows."""
    # 1. The places where the robot was at each record: an array of all of them would be large.
    shifts = [_shifts(record, last) for record, _ in chosen]
    needed = np.zeros(len(table.is_known), dtype=np.bool_)
    for dx, dy, _ in shifts:
        needed[table.beside(place, dx[row], dy[row])] = True
    table.require(np.flatnonzero(needed))
    # 2. As in `_coarse`.
    total = np.zeros(len(place))
    for (record, driven_in), (dx, dy, directions) in zip(chosen, shifts, strict=True):
        nats = _log_likelihoods(record.reading_in, table.cell_in, driven_in)
        total += nats[table.codes[directions[row], table.beside(place, dx[row], dy[row])]]
    return total


def _log_density(place: Numbers, row: Numbers, last: EchoRecord, table: RangeTable, prior: Prior | None,
                 cells: int = 1) -> Floats:
    """Return the log densities (n,) of poses at places with headings of these rows, by what was known before.

    A place stands for a square of so many cells.
    """
    if prior is None:
        return np.zeros(len(place))
    poses = np.column_stack((table.places_in[place], HEADINGS_RAD[row]))
    width = np.square(_peak_std(table, cells))
    offset = difference(_displaced(poses, last.encoders, prior.encoders), prior.belief.mean[:POSE])
    information = np.linalg.inv(prior.belief.cov[:POSE, :POSE] + np.diag(width))
    density: Floats = -0.5 * np.einsum("ni,ij,nj->n", offset, information, offset)
    return density


def _spread(records: Sequence[EchoRecord], count: int) -> Sequence[EchoRecord]:
    """Return at most `count` of the records, evenly chosen."""
    if len(records) <= count:
        return records
    return [records[k] for k in np.linspace(0, len(records) - 1, count).astype(int).tolist()]


def _log_likelihoods(reading_in: float, cell_in: float, driven_in: float) -> npt.NDArray[np.float32]:
    """Return the log likelihood of a reading for each code of a table, the robot then `driven_in` away."""
    ranges, probability = decoded(np.arange(CODES))
    inlier = 1.0 - OUTLIER_PROBABILITY
    if reading_in >= NOTHING_IN:
        return np.log(1.0 - inlier * probability).astype(np.float32)
    variance = (CELL_STD * cell_in) ** 2 + (0.01 * ranges) ** 2 + (ODOMETRY_STD * driven_in) ** 2
    hit = probability * np.exp(-0.5 * (reading_in - ranges) ** 2 / variance)
    nats = np.log(inlier * hit / np.sqrt(2.0 * np.pi * variance) + OUTLIER_PROBABILITY / RANGE_SPAN_IN)
    return nats.astype(np.float32)


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


def _maxima(poses: Floats, distance_in: float) -> list[Floats]:
    """Return the best of poses (n, 3), the best first, one for each peak.

    No two are within this distance with nearly the same heading.
    """
    # Non-maximum suppression: take the best pose, drop its neighbours, repeat.
    found: list[Floats] = []
    rest = poses
    while len(rest) and len(found) < MAX_PEAKS:
        # A copy: a view would hold all of the rest in memory, 50 MB for 100 peaks.
        peak = rest[0].copy()
        found.append(peak)
        offset = difference(rest, np.broadcast_to(peak, rest.shape))
        distance = np.hypot(offset[:, 0], offset[:, 1])
        rest = rest[~((distance < distance_in) & (np.abs(offset[:, HEADING]) < PEAK_RAD))]
    return found


# 3. Alternatives to a belief.


def alternatives(given: Belief, records: Sequence[EchoRecord], table: RangeTable, replay: EchoReplay) -> Alternatives:
    """Return what else explains the records. Near is within the standard deviation of the belief, or a slip from it."""
    # 1. The given belief, widened by a cell of the grid: nearer poses cannot be distinguished from it.
    wide = Belief(given.mean[:POSE], given.cov[:POSE, :POSE] + np.diag(np.square(_peak_std(table))))
    information = np.linalg.inv(wide.cov)
    # 2. The best explanation near it (True) and elsewhere (False).
    best: dict[bool, tuple[Belief, float]] = {}
    for peak in _peaks(records, table):
        belief, score = _replayed(peak, records, replay)
        offset = difference(belief.mean, wide.mean)
        may_have_slipped = np.hypot(offset[0], offset[1]) < SLIP_IN and abs(offset[HEADING]) < SLIP_RAD
        near = bool(offset @ information @ offset <= SAME_SQUARED or may_have_slipped)
        if near not in best or score > best[near][1]:
            best[near] = belief, score
    # 3. Both sides are compared by the same echoes, replayed.
    lead = max((score for _, score in best.values()), default=-inf) - _replayed(wide, records, replay)[1]
    near_by, elsewhere = (best[near][0] if near in best else None for near in (True, False))
    return Alternatives(near_by, elsewhere, lead)


# 4. Searches as the filter starts them.


class SearchRequest(NamedTuple):
    """Order for a search.

    Attributes
    ----------
    records
        Echoes in order of time: the history of a search, or those since the hypotheses.
    hypotheses, before
        Hypotheses so far, and the encoders (3,) that they belong to.
    since
        For a search, the last of the records, which come after these hypotheses.
    searches
        True to search the map, False to advance the hypotheses only.
    given
        Belief to find alternatives to; then the rest but the records has no meaning.
    """

    records: list[EchoRecord]
    hypotheses: list[Place] = []  # noqa: RUF012
    before: Floats | None = None
    since: list[EchoRecord] = []  # noqa: RUF012
    searches: bool = True
    given: Belief | None = None
    prior: Prior | None = None
    parameter_stds: tuple[float, ...] = ()


class SearchResult(NamedTuple):
    """Answer of a search: hypotheses at the last record, or the alternatives to a given belief.

    `turn_rad` is the turn from the heading of the robot towards where the hypotheses differ soonest.
    """

    hypotheses: list[Place]
    alternatives: Alternatives | None = None
    turn_rad: float | None = None


PendingSearch = Callable[[], SearchResult | None]
"""Returns the answer of a search, None while it runs."""


class PoseSearch(Protocol):
    """Searches for poses on a map; an implementation may run beside the filter."""

    @property
    def progress(self) -> str:
        """Reason why a search still waits, in words; "" if it does not."""

    def density(self, reading_in: float) -> float:
        """Return the probability density of a reading from an unknown pose."""

    def start(self, request: SearchRequest) -> PendingSearch:
        """Begin a search."""


class TableSearch:
    """Search in this process, which answers at once; the table is built at its first use.

    `store` is called with the table after each search that computed more of it.
    """

    progress = ""

    def __init__(self, table: Callable[[], RangeTable], measurement: MeasurementUpdate, odometry: OdometryNoise,
                 store: Callable[[RangeTable], None] = lambda _: None) -> None:  # fmt: skip
        self._build, self._replay, self._store = table, EchoReplay(measurement, odometry), store

    @cached_property
    def table(self) -> RangeTable:
        """The range table of the map."""
        return self._build()

    def density(self, reading_in: float) -> float:
        """Return the probability density of a reading from an unknown pose."""
        return self.table.density(reading_in)

    def start(self, request: SearchRequest) -> PendingSearch:
        """Return the answer of a search."""
        before = np.count_nonzero(self.table.is_known)
        result = self._answer(request)
        if np.count_nonzero(self.table.is_known) > before:
            self._store(self.table)
        return lambda: result

    def _answer(self, request: SearchRequest) -> SearchResult:
        records, before = request.records, request.before
        if request.given is not None:
            return SearchResult([], alternatives(request.given, records, self.table, self._replay))
        if not request.searches:
            assert before is not None
            found = advanced(request.hypotheses, before, records, self._replay)
        else:
            others = [] if before is None else advanced(request.hypotheses, before, request.since, self._replay)
            found = search(records, self.table, self._replay, request.parameter_stds, others, request.prior)
        return SearchResult(found, turn_rad=informative_turn(found, self.table))


# 5. Where the hypotheses differ.

TURNS: Final = 12
"""Directions of driving that are compared."""
DRIVE_STEP_IN, DRIVE_STEPS = 12.0, 20
"""Straight drives are judged at these points."""
COMPARED: Final = 8
"""So many of the most probable hypotheses are compared."""
START_IN, TURN_IN = 36.0, 20.0
"""Costs of any drive, and of a radian of turning before it, in inches of driving."""
BEYOND_IN: Final = 1000.0
"""Where no expected reading separates the hypotheses, something that does is as far away as this on average."""


def informative_turn(hypotheses: Sequence[Place], table: RangeTable) -> float | None:
    """Return the turn (rad) to the straight drive on which readings are expected to separate the hypotheses soonest.

    The value of a drive is the information on the hypotheses that its readings are expected to bring, over its length.
    What is not expected may be beyond: a free way has a small value in any case.

    Returns
    -------
    float or None
        None for fewer than two hypotheses, or no free way.
    """
    best = hypotheses[:COMPARED]
    if len(best) < 2:
        return None
    weights = np.array([each.probability for each in best])
    weights /= weights.sum()
    poses = np.array([each.belief.mean[:POSE] for each in best])
    entropy = -float((weights * np.log(weights)).sum())
    along = DRIVE_STEP_IN * np.arange(1, DRIVE_STEPS + 1)
    chosen, highest = None, 0.0
    for turn in ((np.arange(TURNS) - TURNS // 2 + 1) * (2.0 * np.pi / TURNS)).tolist():
        # 1. The drive ends where most of the robot's possible poses meet a wall.
        heading = poses[:, HEADING] + turn
        x = poses[:, 0] + along[:, None] * np.cos(heading)
        y = poses[:, 1] + along[:, None] * np.sin(heading)
        free = np.logical_and.accumulate(table.places_at(x.ravel(), y.ravel()).reshape(x.shape) >= 0)
        steps = int(np.count_nonzero(free[:, 0] & (free @ weights >= 0.5)))
        if not steps:
            continue
        # 2. The information by all readings up to each point; a hypothesis that meets a wall adds none there.
        apart = _distances(x[:steps], y[:steps], heading, table)
        apart *= free[:steps, :, None] & free[:steps, None]
        nats = _information(weights, np.cumsum(apart, axis=0))
        # 3. Over the length of the drive.
        value = nats + (entropy - nats) * along[:steps] / BEYOND_IN
        value /= START_IN + along[:steps] + TURN_IN * abs(turn)
        if value.max() > highest:
            chosen, highest = turn, float(value.max())
    return chosen


def _information(weights: Floats, distances: Floats) -> Floats:
    """Return a lower bound (...) of the information on hypotheses with weights (n,), in nats.

    Parameters
    ----------
    distances
        (..., n, n) Bhattacharyya distances between the readings that the hypotheses expect.

    References
    ----------
    Kolchinsky and Tracey, Estimating mixture entropy with pairwise distances (2017), equation 9.
    """
    return -np.log(np.exp(-distances) @ weights) @ weights


def _distances(x_in: Floats, y_in: Floats, heading: Floats, table: RangeTable) -> Floats:
    """Return the Bhattacharyya distances (k, n, n) between the rings that hypotheses expect at points (k, n) of drives.

    A reading is an echo near the expected range, or any other. A pose is known to a cell, so an echo differs from what
    another hypothesis expects only as far as it does from that of all neighbouring cells.
    """
    sonars = np.arange(0, DIRECTIONS, DIRECTIONS // 24)
    rows = np.rint(heading * (DIRECTIONS / (2.0 * np.pi))).astype(np.intp)[:, None] + sonars
    side_in = table.cell_in * table.coarse_cells
    closest, inlier = np.full((*x_in.shape, x_in.shape[1], len(sonars)), np.inf), 1.0 - OUTLIER_PROBABILITY
    range_in, probability = table.look_up(x_in[..., None], y_in[..., None], rows % DIRECTIONS)
    for dx, dy in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)):
        beside_in, beside = table.look_up(x_in[..., None] + dx * side_in, y_in[..., None] + dy * side_in,
                                          rows % DIRECTIONS)
        # The overlap of two Gaussians, each as wide as a cell, and of the rest.
        apart = (range_in[:, :, None] - beside_in[:, None]) / side_in
        one, other = inlier * probability[:, :, None], inlier * beside[:, None]
        overlap = np.sqrt(one * other) * np.exp(-np.square(apart) / 8.0) + np.sqrt((1.0 - one) * (1.0 - other))
        closest = np.minimum(closest, -np.log(overlap))
    distances: Floats = EVIDENCE_SHARE * closest.sum(axis=-1)
    return np.minimum(distances, np.swapaxes(distances, -1, -2))
