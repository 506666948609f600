"""Helpers of the notebooks: recorded drives, expected ranges, a run of an own filter."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from localization.course import lab
from localization.filters.own import load_factory
from nclient.state import RobotState
from worlds.io import load_world
from worlds.raycast import cast_ray

mpl.use("agg")
EXAMPLE = Path(__file__).parents[3] / "examples" / "own_filter.py"


def test_legs_are_driven_for_their_time() -> None:
    drive = lab.record("sim:thesis_room?seed=1", [(10.0, 0.0, 1.0), (0.0, 45.0, 1.0)])
    assert drive.has_truth
    # 2 s in periods of 0.1 s.
    assert len(drive.clock_s) == len(drive.truth) == 20
    assert np.diff(drive.clock_s) == pytest.approx(lab.PERIOD_S, abs=0.02)
    # 10 in/s for a second with 5 in/s^2 at each end, then a turn to the left; ideal encoders are the truth.
    assert 3.0 < drive.encoders[-1, 0] - drive.encoders[0, 0] < 11.0
    assert drive.encoders[-1, 2] > drive.encoders[9, 2] + 0.2
    assert drive.encoders == pytest.approx(drive.truth, abs=0.1)
    assert drive.turret_rad == pytest.approx(drive.encoders[:, 2], abs=0.02)


def test_a_function_steers_by_the_state() -> None:
    seen: list[RobotState] = []

    def steer(state: RobotState) -> tuple[float, float]:
        seen.append(state)
        return (5.0 if len(seen) <= 3 else 0.0), 0.0

    drive = lab.record("sim:thesis_room?seed=1", steer, seconds=1.0, sonars=[0])
    assert len(seen) == len(drive.clock_s) == 10
    assert drive.sonars_in.shape == (10, 16)


def test_expected_ranges_are_those_of_rays() -> None:
    world = load_world("thesis_room")
    x, y, heading = 20.0, 15.0, 0.3
    found = lab.expected_ranges((x, y, heading), [0.0, 1.0], world)
    for range_in, angle in zip(found[0], (heading, heading + 1.0), strict=True):
        exact_in = cast_ray(x, y, np.cos(angle), np.sin(angle), world.walls)[0]
        # The oracle casts one ray from the centre; the ring's radius is subtracted.
        assert range_in == pytest.approx(exact_in - lab.RING_IN, abs=1e-9)


def test_an_own_filter_drives_and_its_map_is_drawn() -> None:
    import matplotlib.pyplot as plt

    world = load_world("thesis_room")
    run = lab.run_filter("sim:thesis_room?seed=1", load_factory(f"{EXAMPLE}:MyFilter"), world, [(20.0, 0.0)])
    assert run.reached == 1
    assert not run.stopped
    _, axes = plt.subplots()
    lab.draw_map(axes, world)
    assert axes.get_xlabel() == "x (in)"
    assert axes.get_aspect() == 1.0
    plt.close("all")
