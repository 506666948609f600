"""Several robots of one daemon, each found by its number."""

from __future__ import annotations

from math import asin, atan, hypot

import pytest

from nclient.connector import connect
from tests.programs.forked import Forked


@pytest.mark.long
def test_the_laser_shows_the_arc_of_the_other_robot_over_tcp() -> None:
    words = ("--robot", "n200", "--robot", "n150", "--start", "20,45", "--start", "70,45")
    with Forked("nserver", "--port", "0", *words) as program:
        try:
            host = program.stdout.readline().split()[-1]
            with connect(f"nserver://{host}/1?model=n200", timeout_s=10) as robot:
                points = robot.read_laser().laser_points_in
        finally:
            program.kill()
    # Robot 2 is 50 in ahead of robot 1; its radius is 9.72 in.
    arc = [(x, y) for x, y in points if x < 60.0]
    assert all(abs(hypot(x - 50.0, y) - 9.72) < 0.08 for x, y in arc)
    # The laser is 9 in ahead of the axis: the tangents to the disc from there.
    half_arc = asin(9.72 / (50.0 - 9.0))
    assert max(atan(y / (x - 9.0)) for x, y in arc) == pytest.approx(half_arc, abs=0.005)
    assert min(atan(y / (x - 9.0)) for x, y in arc) == pytest.approx(-half_arc, abs=0.005)
    behind = [(x, y) for x, y in points if x >= 60.0]
    # The wall at x = 102.17, seen from x = 20.
    assert all(abs(x - 82.17) < 0.06 for x, _ in behind)
    assert len(arc) + len(behind) == len(points) == 482


@pytest.mark.long
def test_each_robot_is_found_by_its_number() -> None:
    words = ("--robot", "n150", "--robot", "scout", "--start", "0,0", "--start", "60,50,90")
    with Forked("nserver", "--port", "0", "--robots", "3", *words) as program:
        try:
            host = program.stdout.readline().split()[-1]
            with connect(f"nserver://{host}/2?model=scout", timeout_s=10) as second:
                second.refresh()
                # x 60, y 50 in, steering 90 deg; the turret begins in the same direction.
                assert tuple(second.state.raw[34:38]) == (600, 500, 900, 900)
            with connect(f"nserver://{host}/3", timeout_s=10) as third:
                third.refresh()
                assert tuple(third.state.raw[34:36]) != (0, 0)
        finally:
            program.kill()
