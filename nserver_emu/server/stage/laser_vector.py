"""The laser vector of a reply: a count, and so many readings in tenths; what the laser saw just now.

    words a reading     4 lines x1 y1 x2 y2 | 2 points x y, robot's frame | 1 the camera's row of each column
"""

from __future__ import annotations

from nclient.protocol.terms import LINES, POINTS
from nclient.protocol.units import tenths
from nserver_emu.server.conversation.session import Visit
from nserver_emu.simulation.laser import LineFit, lines, pixels, points
from nserver_emu.simulation.robot import SimulatedRobot


def is_on(mode: int) -> bool:
    """Whether the laser gives anything in this mode: bit 0 tells."""
    return bool(mode & 1)


def laser_vector(robot: SimulatedRobot, visit: Visit, width: int) -> tuple[int, ...]:
    """The vector with so many words a reading, on the terms of this connection; (0,) where nothing is seen."""
    seen = robot.look_with_laser(visit.laser_columns)
    if width not in (POINTS, LINES):
        rows = pixels(seen)
        return (len(rows), *rows)
    found = points(seen, robot.model.body)
    if width == LINES:
        found = lines(found, _line_fit(visit))
    return (len(found), *[tenths(number) for number in found.ravel().tolist()])


def _line_fit(visit: Visit) -> LineFit:
    """How this connection's laser points become lines."""
    if visit.segments is None:
        return LineFit()
    threshold, min_points, gap = visit.segments
    return LineFit(threshold / 10, min_points, gap / 10)
