"""What a localizer publishes is checked, shown to all, and answered with where to go."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from viewed_daemon import served
from wire_client import simulation

from localization.observation import Refusal
from nserver_emu.server.handlers import Emulator
from nserver_emu.viewer.localization import REFUSALS, published
from nserver_emu.viewer.protocol import BadMessage

GOOD: dict[str, Any] = {
    "robot": 1, "clock_s": 1.5, "pose": [1, 2, 0.1], "turret": 0.2, "cov": [[1, 0, 0], [0, 2, 0], [0, 0, 3]],
    "odometry": [1, 2, 3], "truth": None, "waypoints": [[5, 6]], "passed": 0,
    "echoes": [{"sonar": 3, "reading_in": 40, "refusal": "gate", "innovation_in": 0, "nis": 0}],
}  # fmt: skip


def test_refusals_have_the_filter_s_own_names() -> None:
    assert [refusal.name.lower() for refusal in Refusal] == list(REFUSALS)


def test_what_is_right_comes_through() -> None:
    told = published(json.dumps(GOOD | {"more": 1}))
    assert told == GOOD | {"cov": [1, 0, 0, 0, 2, 0, 0, 0, 3]}
    assert published(json.dumps(GOOD | {"truth": [1, 2, 3]}))["truth"] == [1, 2, 3]


@pytest.mark.parametrize(
    "change",
    [{"pose": [1, 2]}, {"pose": None}, {"clock_s": "x"}, {"clock_s": float("nan")}, {"cov": [1, 2, 3]}, {"robot": None},
     {"echoes": [{"sonar": 1}]}, {"echoes": [GOOD["echoes"][0] | {"refusal": "whim"}]}, {"waypoints": [[1, 2, 3]]}],
)  # fmt: skip
def test_anything_else_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BadMessage, match="what is published is robot"):
        published(json.dumps(GOOD | change))


@pytest.mark.parametrize("text", ["", "[]", "7", "[" * 100_000])
def test_no_text_is_more_than_a_refusal(text: str) -> None:
    with pytest.raises(BadMessage):
        published(text)


def test_it_is_posted_with_the_token_and_seen_by_who_looks_then_or_later() -> None:
    async def scenario() -> None:
        async with served(Emulator(simulation())) as here, here.page(here.viewing.watch_token) as page:
            address = f"{here.origin}/publish"
            async with here.web.post(address, params={"token": here.viewing.token}, json=GOOD) as answer:
                assert await answer.json() == {"waypoints": None, "set": 0}
            shown = await page.until(lambda message: message["type"] == "localization")
            assert shown["pose"] == GOOD["pose"]
            async with here.page() as late:
                await late.until(lambda message: message["type"] == "localization")
                await late.say(do="waypoints", points=[[7, 8]])
                await late.until(lambda message: message["type"] == "waypoints")
            async with here.web.post(address, params={"token": here.viewing.token}, json=GOOD) as answer:
                assert await answer.json() == {"waypoints": [[7, 8]], "set": 1}
            for token, body, status in (
                (here.viewing.watch_token, GOOD, 403), ("", GOOD, 403), (here.viewing.token, {}, 400),
            ):  # fmt: skip
                async with here.web.post(address, params={"token": token}, json=body) as answer:
                    assert answer.status == status

    asyncio.run(scenario())
