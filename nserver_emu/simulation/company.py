"""Several robots on one ground: who is near whom, and the discs that they are to one another. No motion, no sensors.

    every TICK        all are looked at: what sonars see of the others until the next tick
    those near        run one after another, each against the others where they stand just then: they never overlap

Ticks lie on simulated time itself, so what is seen does not depend on how the caller cuts it. Who is first changes
from tick to tick, so that no robot always has the way. Robots that cannot meet within a tick run as if alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from nserver_emu.simulation.instants import PS_PER_S
from nserver_emu.simulation.robot import SimulatedRobot
from worlds.geometry import FloatArray

TICK_PS: Final = PS_PER_S // 100
"""A hundredth of a second: a robot at 20 in/s is seen 0.2 in from where it is at most, a fifth of what sonars tell."""

NEAR_IN: Final = 2.0
"""Gap below which two robots are near: at twice 39 in/s they close 0.8 in within a tick; noise is far below that."""


def discs_of(robots: Mapping[int, SimulatedRobot]) -> FloatArray:
    """The robots as discs (n, 3), rows x y radius in inches, in the order of the mapping."""
    return np.array([robot.disc for robot in robots.values()]).reshape(-1, 3)


def neighbours(discs: FloatArray) -> dict[int, list[int]]:
    """Rows of those that stand near another, and the rows of whom they stand near."""
    gaps = np.hypot(discs[:, None, 0] - discs[:, 0], discs[:, None, 1] - discs[:, 1])
    gaps -= discs[:, None, 2] + discs[:, 2]
    np.fill_diagonal(gaps, np.inf)
    near: dict[int, list[int]] = {}
    for row, other in np.argwhere(gaps < NEAR_IN).tolist():
        near.setdefault(row, []).append(other)
    return near


def look_around(robots: Mapping[int, SimulatedRobot]) -> None:
    """Let all see where the others stand now."""
    discs = discs_of(robots)
    discs.flags.writeable = False
    for row, robot in enumerate(robots.values()):
        robot.see(discs, row)


def run_together(robots: Mapping[int, SimulatedRobot], until_ps: int, tick: int) -> None:
    """Let time pass in all robots until an instant of the tick with this number."""
    crew = list(robots.values())
    near = neighbours(discs_of(robots))
    first = tick % len(crew)
    for row in (*range(first, len(crew)), *range(first)):
        crew[row].stand_beside(_discs(crew, near.get(row, ())))
        crew[row].advance_to(until_ps)
    for row, others in near.items():
        crew[row].stand_beside(_discs(crew, others))


def _discs(crew: Sequence[SimulatedRobot], rows: Sequence[int]) -> FloatArray | None:
    return np.array([crew[row].disc for row in rows]) if rows else None
