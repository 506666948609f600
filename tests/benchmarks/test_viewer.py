"""The viewer benchmark: attribution of time, and the activity of its viewers."""

from __future__ import annotations

import pytest
import viewer
from viewer import Share, Taken, share


def test_time_of_steps_is_not_attributed_to_viewers() -> None:
    alone = Taken(whole_s=1.0, stepping_s=0.8, steps=1000, wall_s=1.0)
    assert share(alone, alone) == Share(0.0, 0.0)
    half = Taken(whole_s=0.5, stepping_s=0.4, steps=500, wall_s=2.0)
    assert share(alone, half) == pytest.approx(Share(0.0, 0.0))


def test_cost_of_pages_and_slower_steps_is_separated() -> None:
    alone = Taken(whole_s=1.0, stepping_s=0.8, steps=1000, wall_s=1.0)
    watched = Taken(whole_s=1.0, stepping_s=0.80, steps=900, wall_s=1.0)
    found = share(alone, watched)
    # Cost of the pages: the whole time less that of the steps, and less the other work, 0.2 s for 1000 steps.
    assert found.page == pytest.approx(1.0 - 0.80 - 0.2 * 0.9)
    assert found.steps == pytest.approx(0.80 - 0.8 * 0.9)
    assert sum(found) == pytest.approx(1.0 - (900 / 1.0) / (1000 / 1.0))


@pytest.mark.long
async def test_round_is_measured() -> None:
    found = await viewer.measure(rounds=1, seconds=0.5, count=3)
    assert found["pictures_a_second"] > 2.0
    assert found["share"] == pytest.approx(found["share_page"] + found["share_steps"])
    assert -1.0 < found["share"] < 1.0
    assert found["alone_steps_a_processor_s"] > 0.0
