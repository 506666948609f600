"""Several robots on one ground: who is near whom, and the discs that they are to one another. No motion, no sensors.

    at most a SPAN    who cannot meet within it another that moves runs through it at once; who stands is in the way
    half of it, ...   the same for those who are left
    every TICK        whoever is left now run one after another, each against those near it: they never overlap
    a sensor fires    it sees where the others stood at the tick before, worked out afterwards from their tracks

Ticks lie on simulated time itself, so what is seen and who is first does not depend on how the caller cuts it. Who is
first changes from tick to tick, so that no robot always has the way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import hypot
from typing import Final

import numpy as np

from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import PS_PER_S, to_s
from nserver_emu.simulation.spatial_hash import STAYS, Reach
from nserver_emu.simulation.visibility import Sighting
from worlds.geometry import FloatArray

TICK_PS: Final = PS_PER_S // 100
"""A hundredth of a second: a robot at 20 in/s is seen 0.2 in from where it is at most, a fifth of what sonars tell."""

SPAN_PS: Final = 12 * TICK_PS
"""Two firings of a ring at its usual rate, where motion that draws chance is cut anyway."""

SLACK_IN: Final = 0.01
"""Robots come no nearer to others than this unless they are looked at: bumpers feel 1e-3 in, rounding is 1e-11."""

Pair = tuple[int, int]
"""Rows of two robots, the smaller first."""


class Company:
    """What the robots of one world are to one another; their sensors look through it."""

    def __init__(self) -> None:
        self._sightings: dict[int, Sighting] = {}

    def at(self, instant_ps: int) -> Sighting:
        """Where all stood at the last tick before an instant; known once `run` has come to its end."""
        tick = (instant_ps - 1) // TICK_PS
        known = self._sightings.get(tick)
        return self._sightings.setdefault(tick, Sighting()) if known is None else known

    def look_around(self, robots: Mapping[int, SimulatedRobot], now_ps: int) -> None:
        """From now on these are the robots, and this is where all see them."""
        for row, robot in enumerate(robots.values()):
            robot.join(self, row)
            robot.begin_track()
        self._sightings = {(now_ps - 1) // TICK_PS: Sighting(discs_of(robots.values()))}

    def run(self, robots: Mapping[int, SimulatedRobot], begin_ps: int, end_ps: int) -> None:
        """Let time pass in all robots, which stand at the one instant, until the other."""
        while begin_ps < end_ps:
            until_ps = min(end_ps, begin_ps + SPAN_PS)
            _run_span(list(robots.values()), begin_ps, until_ps)
            self._settle(robots, until_ps)
            begin_ps = until_ps

    def _settle(self, robots: Mapping[int, SimulatedRobot], now_ps: int) -> None:
        """Work out what was seen up to now, and keep what is to be seen until the next tick."""
        last = self.at(now_ps)
        for tick, sighting in self._sightings.items():
            if not len(sighting.discs):
                sighting.discs = discs_of(robots.values(), tick * TICK_PS)
        self._sightings = {(now_ps - 1) // TICK_PS: last}
        for robot in robots.values():
            robot.begin_track()


def discs_of(robots: Iterable[SimulatedRobot], instant_ps: int | None = None) -> FloatArray:
    """Robots as discs (n, 3), rows x y radius in inches, now or at an instant since the last span began."""
    if instant_ps is None:
        return np.array([robot.disc for robot in robots]).reshape(-1, 3)
    return np.array([robot.disc_at(instant_ps) for robot in robots])


def near(robots: Sequence[SimulatedRobot], span_ps: int) -> list[Pair]:
    """Those that may meet within a span of time, in their order."""
    discs = discs_of(robots)
    span_s = to_s(span_ps)
    discs[:, 2] += [robot.reach_in(span_s) for robot in robots]
    return neighbours(discs, SLACK_IN)


def neighbours(discs: FloatArray, within_in: float) -> list[Pair]:
    """Those of the discs (n, 3) that are nearer to each other than a gap, in their order.

    Sorted by x, each is compared with the next, the one after the next ... until all those are too far away.
    """
    order = np.argsort(discs[:, 0])
    x, y, radius = discs[order].T
    reach = within_in + 2.0 * radius.max(initial=0.0)
    pairs: list[Pair] = []
    for apart in range(1, len(discs)):
        dx = x[apart:] - x[:-apart]
        if dx.min() >= reach:
            break
        gaps = np.hypot(dx, y[apart:] - y[:-apart]) - (radius[apart:] + radius[:-apart])
        first = np.flatnonzero(gaps < within_in)
        rows = np.sort(np.column_stack((order[first], order[first + apart])))
        pairs += [(row, other) for row, other in rows.tolist()]
    return sorted(pairs)


def touch(crew: Sequence[SimulatedRobot], pairs: Iterable[Pair] | None = None) -> None:
    """Let bumpers feel where the others of the crew stand now; of some pairs, if no others can touch."""
    rows = range(len(crew)) if pairs is None else sorted({row for pair in pairs for row in pair})
    beside = _beside(_may_meet(crew, near(crew, 0) if pairs is None else pairs, dict.fromkeys(rows, STAYS)))
    for row in rows:
        _stand(crew, row, beside.get(row, ()))


def _run_span(crew: Sequence[SimulatedRobot], begin_ps: int, end_ps: int) -> None:
    """Who cannot meet anybody until the end goes there at once, the others by and by."""
    pairs = near(crew, end_ps - begin_ps)
    for row in set(range(len(crew))).difference(*pairs):
        _stand(crew, row, ())
        crew[row].advance_to(end_ps)
    _run_pairs(crew, pairs, begin_ps, end_ps)
    for row in {row for pair in pairs for row in pair}:
        crew[row].advance_to(end_ps)
    touch(crew, pairs)


def _run_pairs(crew: Sequence[SimulatedRobot], pairs: Iterable[Pair], begin_ps: int, end_ps: int) -> None:
    """Let time pass in all who are in pairs and move; in no others can they meet. Who stands may wait.

    Who moves and may meet another that moves is held back: it takes its turns in each tick, and in longer spans those
    that are held back go the first half and then the second, as if these were all there is.
    """
    span_s = to_s(end_ps - begin_ps)
    reach = {row: crew[row].reach(span_s) for row in {row for pair in pairs for row in pair}}
    moving = {row for row in reach if reach[row] is not STAYS}
    pairs = _may_meet(crew, [pair for pair in pairs if not moving.isdisjoint(pair)], reach)
    beside = _beside(pairs)
    held = {row for pair in pairs if moving.issuperset(pair) for row in pair}
    for row in moving - held:
        _advance(crew, row, beside.get(row, ()), end_ps)
    ticks = range(begin_ps // TICK_PS + 1, -(-end_ps // TICK_PS))
    if held and ticks:
        left = [pair for pair in pairs if not held.isdisjoint(pair)]
        middle_ps = ticks[len(ticks) // 2] * TICK_PS
        _run_pairs(crew, left, begin_ps, middle_ps)
        _run_pairs(crew, left, middle_ps, end_ps)
        return
    first = begin_ps // TICK_PS % len(crew)
    for row in sorted(held, key=lambda row: (row < first, row)):
        _advance(crew, row, beside[row], end_ps)


def _advance(crew: Sequence[SimulatedRobot], row: int, others: Iterable[int], end_ps: int) -> None:
    """Let time pass in one robot, the others as they stand."""
    _stand(crew, row, others)
    crew[row].advance_to(end_ps)


def _stand(crew: Sequence[SimulatedRobot], row: int, others: Iterable[int]) -> None:
    """Let one robot be stopped and felt by those others, and by no more."""
    crew[row].stand_beside([crew[other].disc for other in others])


def _may_meet(crew: Sequence[SimulatedRobot], pairs: Iterable[Pair], reach: Mapping[int, Reach]) -> list[Pair]:
    """Those of the pairs that may meet where each comes no farther than its reach."""
    met: list[Pair] = []
    for row, other in pairs:
        (x, y, radius), (u, v, beside) = crew[row].disc, crew[other].disc
        dx, dy = u - x, v - y
        apart = hypot(dx, dy)
        gap = apart - radius - beside - SLACK_IN
        if gap > 0.0:
            dx, dy = dx / apart, dy / apart
            gap -= reach[row].towards(dx, dy) + reach[other].towards(-dx, -dy)
        if gap <= 0.0:
            met.append((row, other))
    return met


def _beside(pairs: Iterable[Pair]) -> dict[int, list[int]]:
    """The rows of all who are in pairs, and who is in one with each, in their order."""
    beside: dict[int, list[int]] = {}
    for row, other in pairs:
        beside.setdefault(row, []).append(other)
        beside.setdefault(other, []).append(row)
    return beside
