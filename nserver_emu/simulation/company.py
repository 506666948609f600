"""Several robots on one ground: who is near whom, and the discs that they are to one another. No motion, no sensors.

    at most a SPAN    who cannot meet another within it runs through it as if alone
    every TICK        the others run one after another, each against those near it as they stand: they never overlap
    a sensor fires    it sees where the others stood at the tick before, worked out afterwards from their tracks

Ticks lie on simulated time itself, so what is seen and who is first does not depend on how the caller cuts it. Who is
first changes from tick to tick, so that no robot always has the way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from nserver_emu.simulation.instants import PS_PER_S, to_s
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.sighting import Sighting
from worlds.geometry import FloatArray

TICK_PS: Final = PS_PER_S // 100
"""A hundredth of a second: a robot at 20 in/s is seen 0.2 in from where it is at most, a fifth of what sonars tell."""

SPAN_PS: Final = 12 * TICK_PS
"""Two firings of a ring at its usual rate, where motion is cut anyway."""

STRAY_IN: Final = 1.2
"""How much nearer than by their wheels two robots may come within a span: four standard deviations of the noise of two
ways of 4 in. Where noise does more, they overlap by that, and are free to part."""


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


def near(robots: Sequence[SimulatedRobot], span_ps: int) -> dict[int, list[int]]:
    """Rows of the robots that may meet others within a span of time, and the rows of those."""
    discs = discs_of(robots)
    discs[:, 2] += [robot.reach_in(to_s(span_ps)) for robot in robots]
    return neighbours(discs, STRAY_IN)


def neighbours(discs: FloatArray, within_in: float) -> dict[int, list[int]]:
    """Rows of the discs (n, 3) that have others nearer than a gap, and the rows of those, both in their order.

    Sorted by x, each is compared with the next, the one after the next ... until all those are too far away.
    """
    order = np.argsort(discs[:, 0])
    x, y, radius = discs[order].T
    reach = within_in + 2.0 * radius.max(initial=0.0)
    near: dict[int, list[int]] = {}
    for apart in range(1, len(discs)):
        dx = x[apart:] - x[:-apart]
        if dx.min() >= reach:
            break
        gaps = np.hypot(dx, y[apart:] - y[:-apart]) - (radius[apart:] + radius[:-apart])
        first = np.flatnonzero(gaps < within_in)
        for row, other in zip(order[first].tolist(), order[first + apart].tolist(), strict=True):
            near.setdefault(row, []).append(other)
            near.setdefault(other, []).append(row)
    return {row: sorted(near[row]) for row in sorted(near)}


def _run_span(crew: Sequence[SimulatedRobot], begin_ps: int, end_ps: int) -> None:
    """Who cannot meet anybody until the end goes there at once, the others from tick to tick."""
    close = list(near(crew, end_ps - begin_ps))
    alone = set(range(len(crew))).difference(close)
    for row in alone:
        crew[row].stand_beside(None)
        crew[row].advance_to(end_ps)
    while close and begin_ps < end_ps:
        tick = begin_ps // TICK_PS
        begin_ps = min(end_ps, (tick + 1) * TICK_PS)
        first = tick % len(crew)
        turns = [row for row in close if row >= first] + [row for row in close if row < first]
        _run_together([crew[row] for row in turns], begin_ps)
    touch([crew[row] for row in close])


def _run_together(crew: Sequence[SimulatedRobot], until_ps: int) -> None:
    """One after another, each against those that are near where they stand just then."""
    beside = near(crew, TICK_PS)
    for row, robot in enumerate(crew):
        if any(robot.moving):
            robot.stand_beside(_discs(crew, beside.get(row, ())))
        robot.advance_to(until_ps)


def touch(crew: Sequence[SimulatedRobot]) -> None:
    """Let bumpers feel where the others of the crew stand now."""
    beside = near(crew, 0)
    for row, robot in enumerate(crew):
        robot.stand_beside(_discs(crew, beside.get(row, ())))


def _discs(crew: Sequence[SimulatedRobot], rows: Sequence[int]) -> FloatArray | None:
    return discs_of(crew[row] for row in rows) if rows else None
