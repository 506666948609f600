"""Faults on purpose strike lines and clients; what is done at the page goes unharmed through every plan."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.viewed_daemon import served

UNCLEAN = Path(__file__).parents[3] / "docs" / "unclean_line.toml"
RULE = '[[rule]]\nname = "a"\nevery = 1\n'
PLANS = [
    RULE + 'do = ["stray"]\ndirection = "reply"\n',
    RULE + 'do = ["drop"]\ndirection = "request"\n',
    RULE + 'do = ["drop"]\ndirection = "reply"\n',
    RULE + 'do = ["corrupt", "drop_byte"]\n',
    RULE + 'do = ["hang_up"]\n',
    RULE + 'do = ["nak"]\n',
    UNCLEAN.read_text(),
]


@pytest.mark.parametrize("plan", PLANS)
def test_no_plan_of_faults_touches_what_is_done_at_the_page(plan: str) -> None:
    async def scenario() -> None:
        async with served(Emulator(simulation())) as here, here.page() as page:
            robot = here.daemon.emulator.simulation.robots[1]
            await page.say(do="drive", id=1, robot=1, args=[50, 0, 0])
            assert (await page.answer(1))["ok"]
            await page.say(do="control", id=2, command="faults set", argument={"text": plan, "file": "p"})
            assert (await page.answer(2))["ok"]
            for number in range(3, 15):
                await page.say(do="drive", id=number, robot=1, args=[50, 0, 0])
                assert (await page.answer(number))["values"] == []
            assert not robot.still((0,))
            await page.say(do="call", id=20, robot=1, call="st", args=[])
            assert (await page.answer(20))["ok"]
            assert robot.still((0,))
            async with here.page() as later:
                await later.say(do="call", id=1, robot=1, call="place_robot", args=[300, 200, 0, 0])
                assert (await later.answer(1))["ok"]
            await page.say(do="control", id=21, command="faults counts")
            counts = (await page.answer(21))["said"]["counts"]
            assert list(counts) == ["nserver"]
            assert all(rule["seen"] == 0 for rule in counts["nserver"].values())

    asyncio.run(scenario())


def test_what_answers_nothing_that_was_asked_costs_the_hand_alone(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        async with served(Emulator(simulation())) as here, here.page() as page:
            await page.say(do="call", id=1, robot=1, call="st", args=[])
            assert (await page.answer(1))["ok"]
            (viewer,) = here.viewing.hub.viewers
            hand = here.viewing.desk.hands(viewer)._hands[1]
            hand._write(bytes([0, 2, 0, 0, 0]))
            assert "answers nothing that was asked" in caplog.text
            assert hand.session.closing
            await page.say(do="call", id=2, robot=1, call="st", args=[])
            assert (await page.answer(2))["ok"]

    asyncio.run(scenario())
