"""The benchmark of viewers: what is counted as theirs, and that they look."""

from __future__ import annotations

import asyncio

import pytest
import viewer
from viewer import Share, Taken, share


def test_what_steps_alone_would_have_taken_is_not_the_viewers() -> None:
    alone = Taken(whole_s=1.0, stepping_s=0.8, steps=1000, wall_s=1.0)
    assert share(alone, alone) == Share(0.0, 0.0)
    half = Taken(whole_s=0.5, stepping_s=0.4, steps=500, wall_s=2.0)
    assert share(alone, half) == pytest.approx(Share(0.0, 0.0))


def test_the_pages_work_and_slower_steps_are_told_apart_and_their_sum_is_the_pace_lost() -> None:
    alone = Taken(whole_s=1.0, stepping_s=0.8, steps=1000, wall_s=1.0)
    watched = Taken(whole_s=1.0, stepping_s=0.80, steps=900, wall_s=1.0)
    found = share(alone, watched)
    assert found.page == pytest.approx(1.0 - 0.80 - 0.2 * 0.9)
    assert found.steps == pytest.approx(0.80 - 0.8 * 0.9)
    assert sum(found) == pytest.approx(1.0 - (900 / 1.0) / (1000 / 1.0))


@pytest.mark.long
def test_a_round_is_measured() -> None:
    found = asyncio.run(viewer.measure(rounds=1, seconds=0.5, count=3))
    assert found["pictures_a_second"] > 2.0
    assert found["share"] == pytest.approx(found["share_page"] + found["share_steps"])
    assert -1.0 < found["share"] < 1.0
    assert found["alone_steps_a_processor_s"] > 0.0
