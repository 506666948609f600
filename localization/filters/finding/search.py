"""Where a robot may be that nobody knows the place of: all poses that explain the echoes of the last few seconds.

    1  coarse    every free cell and heading, a ring of echoes each: likelihoods out of the atlas
    2  peaks     the best, and the best that is not near a better one, and so on
    3  refine    each peak as a gaussian as wide as a cell, moved and corrected by the same echoes (filters.hearing)

Symmetry stays: as many hypotheses come out as the map has places that look alike, each with its weight. Rules: pure, no
chance; echoes come with where the encoders stood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log
from typing import Final, NamedTuple

import numpy as np

from localization.estimation.belief import HEADING, Belief, Floats, add, difference, independent
from localization.estimation.hearing import Hearing
from localization.estimation.motion import OdometryNoise, step_between
from localization.estimation.systematic import POSE, predict
from localization.filters.finding.atlas import CELL_IN, DIRECTIONS, Atlas

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


class Clue(NamedTuple):
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


def search(clues: Sequence[Clue], atlas: Atlas, hearing: Hearing, odometry: OdometryNoise) -> list[Hypothesis]:
    """All places that explain the clues, the likeliest first; none where there is no clue or no floor."""
    return merged(_weighed(clues, atlas, hearing, odometry))


class Rivals(NamedTuple):
    """Beliefs over the pose at the last clue that a search holds against one: the best place near it and the best
    elsewhere, None where none was found; and by how many nats the better of the two explains the clues better than the
    belief itself, -inf where there is none."""

    near: Belief | None
    elsewhere: Belief | None
    lead_nats: float


def rivals(
    here: Belief, clues: Sequence[Clue], atlas: Atlas, hearing: Hearing, odometry: OdometryNoise
) -> Rivals:
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
    return Rivals(near_by, elsewhere, lead)


def _weighed(
    clues: Sequence[Clue], atlas: Atlas, hearing: Hearing, odometry: OdometryNoise
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


def _coarse(clues: Sequence[Clue], atlas: Atlas, places: Floats) -> tuple[Floats, Floats]:
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
    peak: Floats, clues: Sequence[Clue], hearing: Hearing, odometry: OdometryNoise
) -> tuple[Belief, float]:
    """A peak, as wide as a cell, led along the clues."""
    return _led(independent(peak, REFINED_STD), clues, hearing, odometry)


def _led(
    last: Belief, clues: Sequence[Clue], hearing: Hearing, odometry: OdometryNoise
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
