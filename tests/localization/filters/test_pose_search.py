"""Parts of the search for a pose: codes of the table, weights of hypotheses, the way to tell them apart, priors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.experiments.live_trial import QUIET
from localization.filters.base import LocalizationConfig, Place
from localization.filters.belief import Belief, Floats, independent
from localization.filters.global_localization import ALIKE_WEIGHT, GlobalLocalizer
from localization.filters.health import HealthStatus
from localization.filters.pose_search import (
    EVIDENCE_SHARE,
    EchoRecord,
    EchoReplay,
    Prior,
    SearchRequest,
    _information,
    _maxima,
    _refined,
    advanced,
    informative_turn,
    moved,
    search,
)
from localization.filters.range_table import (
    CODES,
    RangeTable,
    build_range_table,
    connected,
    decoded,
    encoded,
    floor_grid,
)
from localization.filters.registry import finder, table_search, update_for
from localization.filters.sonar_ray import RaySonar, ranges_from, wall_map
from worlds.geometry import polygon_segments
from worlds.robots import N150

RAYS = RaySonar(range_std_floor_in=0.5)
ROOM = polygon_segments([(0.0, 0.0), (120.0, 0.0), (120.0, 120.0), (0.0, 120.0)])
"""A square room: four poses look alike."""
HALL = np.concatenate((ROOM, polygon_segments([(0.0, 200.0), (120.0, 200.0), (120.0, 400.0), (0.0, 400.0)])))
"""The same beside a longer one."""


def table_of(walls: Floats) -> RangeTable:
    return build_range_table(walls, N150, RAYS, N150.radius_in)


def replay_of(walls: Floats) -> EchoReplay:
    return EchoReplay(update_for(walls, N150, RAYS), QUIET)


def ring_at(walls: Floats, pose: tuple[float, float, float], rounds: int = 2) -> list[EchoRecord]:
    """Exact echoes of a standing robot; its encoders are at 0."""
    angles = np.array(N150.sonar_angles_rad)
    ranges = ranges_from(np.array(pose), angles, N150, wall_map(walls)).range_in
    ring = [EchoRecord(np.zeros(3), angle, k, 0.0, round(ranges[k])) for k, angle in enumerate(angles.tolist())]
    return ring * rounds


def test_codes_keep_inches_and_probabilities() -> None:
    rng = np.random.default_rng(0)
    ranges, probabilities = rng.uniform(0.0, 254.0, 500), rng.uniform(0.0, 1.0, 500)
    codes = encoded(ranges, probabilities)
    assert codes.max() < CODES
    inches, stated = decoded(codes.astype(int))
    assert np.abs(inches - ranges).max() <= 0.5
    assert np.abs(stated - probabilities).max() <= 0.5 / 63 + 1e-9
    assert decoded(np.array([0]))[1] == 0.0
    assert decoded(encoded([260.0], [1.0]).astype(int))[1] == 0.0, "beyond the limit nothing is detected"


def test_codes_beside_places_are_those_of_the_displaced_cells() -> None:
    table = table_of(ROOM)
    dx, dy, direction = 2.0 * table.cell_in, -table.cell_in, 17
    ranges, probabilities = table.look_up(
        table.places_in[:, :1] + dx, table.places_in[:, 1:] + dy, np.array([direction])
    )
    expected = encoded(ranges[:, 0], probabilities[:, 0])
    expected[probabilities[:, 0] == 0.0] = 0
    codes = table.codes_beside(dx, dy, direction)
    np.testing.assert_array_equal(np.where(codes < 256, 0, codes), expected)
    # Beyond the margin nothing is known.
    assert not table.codes_beside(1e4, 0.0, direction).any()


def test_floor_is_what_walls_enclose() -> None:
    origin, free = floor_grid(HALL, 9.0, 6.0)
    rows, columns = np.nonzero(free)
    places = origin + 6.0 * np.stack((columns, rows), axis=-1)
    inside = (places > 8.9).all(axis=1) & (places[:, 0] < 111.1) & ((places[:, 1] < 111.1) | (places[:, 1] > 208.9))
    assert inside.all()
    # Both rooms, but only one of them is connected to a point in it.
    assert places[:, 1].max() > 300.0
    one = connected(free, [(int(rows[0]), int(columns[0]))])
    assert 0 < one.sum() < free.sum()
    # A single wall encloses nothing: all around it is floor.
    assert floor_grid(np.array([(0.0, 0.0, 100.0, 0.0), (50.0, 50.0, 50.0, 60.0)]), 9.0, 6.0)[1].any()


def test_replay_of_a_belief_equals_single_updates() -> None:
    """The loop of the filter against update by update, with repeated readings counted."""
    measurement, records = update_for(ROOM, N150, RAYS), ring_at(ROOM, (40.0, 30.0, 0.2), rounds=1)
    start = independent((40.5, 29.5, 0.22), (0.5, 0.5, 0.02))
    belief, nats = replay_of(ROOM).run(start, np.zeros(3), records)
    expected, total = start, 0.0
    for record in records:
        expected, result = measurement.updated(expected, record.sonar, 0.0, record.reading_in)
        total += math.log(result.likelihood)
    np.testing.assert_allclose(belief.mean, expected.mean, atol=1e-9)
    np.testing.assert_allclose(belief.cov, expected.cov, atol=1e-12)
    assert nats == pytest.approx(total)


def test_hypotheses_are_weighed_by_a_share_of_the_evidence() -> None:
    records, replay = ring_at(ROOM, (40.0, 30.0, 0.2), rounds=1), replay_of(ROOM)
    beliefs = [independent(pose, (0.5, 0.5, 0.02)) for pose in [(40.0, 30.0, 0.2), (44.0, 30.0, 0.2)]]
    nats = [replay.run(belief, np.zeros(3), records)[1] for belief in beliefs]
    found = advanced([Place(belief, 0.5) for belief in beliefs], np.zeros(3), records, replay)
    if len(found) == 2:
        odds = found[0].probability / found[1].probability
        assert math.log(odds) == pytest.approx(EVIDENCE_SHARE * abs(nats[0] - nats[1]), rel=1e-6)
    assert np.hypot(*(found[0].belief.mean[:2] - (40.0, 30.0))) < 1.0


class NarrowReplay(EchoReplay):
    """Replay in which a heading of 0.3 explains the echoes best, and none is corrected."""

    def run(self, belief: Belief, *_: object) -> tuple[Belief, float]:
        return belief, -1000.0 * (belief.mean.item(2) - 0.3) ** 2


def test_peaks_are_refined_from_the_best_of_three_headings() -> None:
    replay = NarrowReplay(update_for(ROOM, N150, RAYS), QUIET)
    records = ring_at(ROOM, (40.0, 30.0, 0.3), rounds=1)
    for heading, best in ((0.25, 0.33), (0.31, 0.31), (0.4, 0.32)):
        found, nats = _refined(independent((40.0, 30.0, heading), (0.5, 0.5, 0.06)), records, replay)
        np.testing.assert_allclose(found.mean, (40.0, 30.0, best))
        assert nats == pytest.approx(-1000.0 * (best - 0.3) ** 2)


@pytest.mark.long
def test_a_prior_selects_among_places_that_look_alike() -> None:
    truth = (40.0, 30.0, 0.2)
    records, table, replay = ring_at(ROOM, truth), table_of(ROOM), replay_of(ROOM)
    assert len(search(records, table, replay)) == 4
    prior = Prior(independent((35.0, 25.0, 0.3), (15.0, 15.0, 0.4)), np.zeros(3))
    (found,) = search(records, table, replay, prior=prior)
    assert found.probability == pytest.approx(1.0)
    assert np.hypot(*(found.belief.mean[:2] - truth[:2])) < 1.0


@pytest.mark.long
def test_known_hypotheses_keep_their_weights_in_a_new_search() -> None:
    records, table, replay = ring_at(ROOM, (40.0, 30.0, 0.2)), table_of(ROOM), replay_of(ROOM)
    four = search(records, table, replay)
    weights = (0.7, 0.2, 0.1)
    others = [Place(each.belief, weight) for each, weight in zip(four, weights, strict=False)]
    again = search(records, table, replay, others=others)
    # The fourth comes back, with no more weight than the best.
    assert len(again) == 4
    kept = [each.probability for each in again if any(each.belief is one.belief for one in others)]
    kept.sort(reverse=True)
    assert len(kept) == 3
    np.testing.assert_allclose(np.array(kept[1:]) / kept[0], np.array(weights[1:]) / weights[0])
    (new,) = (each for each in again if not any(each.belief is one.belief for one in others))
    assert new.probability <= kept[0]


def test_peaks_do_not_hold_all_candidates_in_memory() -> None:
    poses = np.random.default_rng(1).uniform(0.0, 300.0, (200, 3))
    peaks = _maxima(poses, 5.0)
    assert len(peaks) > 50
    assert not any(np.shares_memory(peak, poses) for peak in peaks)
    assert all(peak.base is None for peak in peaks)


def test_the_robot_turns_to_where_hypotheses_differ() -> None:
    """Two rooms of one width: only the far end of the longer one tells them apart."""
    long = polygon_segments([(0.0, 0.0), (120.0, 0.0), (120.0, 320.0), (0.0, 320.0)])
    wide = long + np.array([1000.0, 0.0, 1000.0, 0.0])
    wide[:, 1::2] = np.where(wide[:, 1::2] > 0.0, 600.0, 0.0)
    table = table_of(np.concatenate((long, wide)))
    poses = [(60.0, 40.0, 0.0), (1060.0, 40.0, 0.0)]
    two = [Place(independent(pose, (0.5, 0.5, 0.02)), 0.5) for pose in poses]
    turn = informative_turn(two, table)
    assert turn is not None
    # To the left, where the ends are; the heading along the width and those to the right bring none nearer.
    assert 0.4 < turn < math.pi - 0.4
    assert informative_turn(two[:1], table) is None


def test_a_niche_is_worth_more_than_a_long_free_way() -> None:
    """Of two corridors one has a niche, eight feet from the robot; the free way is to the other side."""
    corridor = [(0.0, 0.0), (600.0, 0.0), (600.0, 60.0), (0.0, 60.0)]
    niche = [(600.0, 0.0), (600.0, 90.0), (570.0, 90.0), (570.0, 60.0), (0.0, 60.0), (0.0, 0.0)]
    beside = polygon_segments(niche) + np.array([1000.0, 0.0, 1000.0, 0.0])
    table = table_of(np.concatenate((polygon_segments(corridor), beside)))
    poses, weights = [(490.0, 30.0, math.pi), (1490.0, 30.0, math.pi)], (0.85, 0.15)
    both = [
        Place(independent(pose, (0.5, 0.5, 0.02)), weight) for pose, weight in zip(poses, weights, strict=True)
    ]
    turn = informative_turn(both, table)
    assert turn is not None
    assert abs(turn) > 2.0


def test_expected_information_is_a_lower_bound() -> None:
    """Readings of eight values, exactly: the information is the mean of ln p(z|i) / p(z)."""
    rng = np.random.default_rng(1)
    for sharpness in (0.1, 1.0, 5.0):
        weights, p = rng.dirichlet(np.ones(4)), rng.dirichlet(np.full(8, 1.0 / sharpness), 4)
        overlap = np.sqrt(p[:, None] * p[None]).sum(axis=-1)
        exact = float((weights[:, None] * p * np.log(p / (weights @ p))).sum())
        assert 0.2 * exact < _information(weights, -np.log(overlap)) <= exact
    # Without any overlap it is the entropy of the weights, and nothing where all expect the same.
    apart = np.where(np.eye(4), 0.0, 100.0)
    np.testing.assert_allclose(_information(weights, apart), -(weights * np.log(weights)).sum())
    np.testing.assert_allclose(_information(weights, np.zeros((4, 4))), 0.0, atol=1e-12)


def test_moved_belief_keeps_its_covariance() -> None:
    belief = independent((10.0, 20.0, math.pi / 2), (0.5, 0.5, 0.02))
    there = moved(belief, np.zeros(3), np.array([3.0, 1.0, 0.5]))
    # Three inches ahead, one to the left, as seen from a robot that looks along y.
    np.testing.assert_allclose(there.mean, [9.0, 23.0, math.pi / 2 + 0.5])
    np.testing.assert_allclose(there.cov, belief.cov)


CONFIG = LocalizationConfig(ROOM, N150, QUIET, RAYS, clearance_in=N150.radius_in)


def feed(filter_: GlobalLocalizer, walls: Floats, pose: tuple[float, float, float], rounds: int) -> None:
    for record in ring_at(walls, pose, rounds):
        filter_.update(record.sonar, 0.0, record.reading_in)


def test_a_wide_start_is_a_prior_and_not_sure_of_one_of_several() -> None:
    # The true place and the one a quarter turn on are both within the deviation.
    wide = finder(CONFIG, independent((60.0, 45.0, 0.9), (40.0, 40.0, 1.5)))
    assert wide.health.status is HealthStatus.LOST
    assert "uncertain" in wide.health.reason
    np.testing.assert_allclose(wide.belief.mean[:2], (60.0, 45.0))
    feed(wide, ROOM, (40.0, 30.0, 0.2), 8)
    assert wide.health.status is HealthStatus.LOST
    assert len(wide.places) >= 2


def test_poses_like_the_start_stay_until_they_are_excluded() -> None:
    truth = (40.0, 30.0, 0.2)
    twin, other = np.array([90.0, 40.0, 0.2 + math.pi / 2]), np.array([70.0, 60.0, 0.2])
    sure = finder(CONFIG, independent(truth, (0.2, 0.2, 0.01)), alike=[twin, other])
    assert [round(place.probability, 4) for place in sure.places] == pytest.approx(
        [1.0 / (1.0 + 2 * ALIKE_WEIGHT)] + [ALIKE_WEIGHT / (1.0 + 2 * ALIKE_WEIGHT)] * 2, abs=1e-3
    )
    feed(sure, ROOM, truth, 2)
    assert sure.health.status is HealthStatus.OK
    # The twin fits as well; the other does not.
    assert len(sure.places) == 2
    np.testing.assert_allclose(sure.places[1].belief.mean[:2], twin[:2], atol=1.0)


def test_a_place_that_explains_more_than_the_start_means_lost() -> None:
    truth = np.array([40.0, 30.0, 0.2])
    wrong = finder(CONFIG, independent((70.0, 60.0, 0.2), (0.2, 0.2, 0.01)), alike=[truth])
    feed(wrong, ROOM, (40.0, 30.0, 0.2), 1)
    assert wrong.health.status is HealthStatus.LOST


def test_requests_advance_or_search() -> None:
    poses = table_search(CONFIG)
    records = ring_at(ROOM, (40.0, 30.0, 0.2))
    found = poses.start(SearchRequest(records))()
    assert found is not None
    assert len(found.hypotheses) == 4
    assert found.turn_rad is not None
    ahead = poses.start(SearchRequest(records[:16], found.hypotheses, np.zeros(3), searches=False))()
    assert ahead is not None
    assert len(ahead.hypotheses) == 4
    given: Belief = found.hypotheses[0].belief
    other = poses.start(SearchRequest(records[:24], given=given))()
    assert other is not None
    assert other.alternatives is not None
