"""Faults on purpose strike lines and clients; what is done at the page goes unharmed through every plan."""

from __future__ import annotations

from pathlib import Path

import pytest

from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer

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


@pytest.mark.long
@pytest.mark.parametrize("plan", PLANS)
async def test_no_plan_of_faults_touches_what_is_done_at_the_page(plan: str) -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        robot = here.daemon.emulator.simulation.robots[1]
        await page.send_message(do="drive", id=1, robot=1, args=[50, 0, 0])
        assert (await page.answer(1))["ok"]
        await page.send_message(do="control", id=2, command="faults set", argument={"text": plan, "file": "p"})
        # From here on every frame of lines and clients is affected; the page's own calls are not.
        assert (await page.answer(2))["ok"]
        for number in range(3, 15):
            await page.send_message(do="drive", id=number, robot=1, args=[50, 0, 0])
            assert (await page.answer(number))["values"] == []
        assert not robot.is_still((0,))
        await page.send_message(do="call", id=20, robot=1, call="st", args=[])
        assert (await page.answer(20))["ok"]
        assert robot.is_still((0,))
        async with here.page() as later:
            await later.send_message(do="call", id=1, robot=1, call="place_robot", args=[300, 200, 0, 0])
            assert (await later.answer(1))["ok"]
        await page.send_message(do="control", id=21, command="faults counts")
        counts = (await page.answer(21))["said"]["counts"]
        assert list(counts) == ["nserver"]
        # No rule has seen a frame of the page.
        assert all(rule["seen"] == 0 for rule in counts["nserver"].values())


async def test_an_unexpected_reply_closes_only_that_connection(caplog: pytest.LogCaptureFixture) -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        await page.send_message(do="call", id=1, robot=1, call="st", args=[])
        assert (await page.answer(1))["ok"]
        (viewer,) = here.viewer_server.broadcaster.viewers
        client = here.viewer_server.controller.clients(viewer)._clients[1]
        # A reply of type 2 that nothing has requested.
        client._write(bytes([0, 2, 0, 0, 0]))
        assert "answers no request" in caplog.text
        assert client.session.closing
        await page.send_message(do="call", id=2, robot=1, call="st", args=[])
        assert (await page.answer(2))["ok"]
