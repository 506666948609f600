"""Errors injected for one viewer: the others continue, its robots stop, and the log has the error once."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer import controller, scene
from nserver_emu.viewer.clients import ErrorBoundary, ViewerClient
from nserver_emu.viewer.scene import Broadcaster, SceneHistory
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer


class Trouble(Exception):
    """An unexpected error."""


def trouble(*_: object, **__: object) -> Any:
    raise Trouble("on purpose")


def test_an_error_is_logged_once_and_then_counted(caplog: pytest.LogCaptureFixture) -> None:
    error_boundary = ErrorBoundary("rosbridge")
    for _ in range(3):
        with error_boundary.guard("the picture", "viewer 1"):
            trouble()
    (record,) = caplog.records
    assert record.levelno == logging.ERROR
    assert record.getMessage().startswith("rosbridge: the picture of viewer 1")
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], Trouble)
    assert error_boundary.counts == {("the picture", Trouble): 3}


def test_what_is_no_fault_passes() -> None:
    # CancelledError is how asyncio ends a task: it must never be caught.
    with pytest.raises(asyncio.CancelledError), ErrorBoundary().guard("it"):
        raise asyncio.CancelledError


async def test_a_failing_picture_stops_nothing_else(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page, here.page() as other:
        robot = here.daemon.emulator.simulation.robots[1]
        with monkeypatch.context() as broken:
            # Pictures fail from here on, but messages and the drive timeout must work.
            broken.setattr(scene, "_now", trouble)
            await page.send_message(do="drive", id=1, robot=1, args=[50, 0, 0])
            assert (await page.answer(1))["ok"]
            async with asyncio.timeout(5):
                while not robot.is_still((0,)):
                    await asyncio.sleep(0.01)
            await other.send_message(do="call", id=2, robot=1, call="st", args=[])
            assert (await other.answer(2))["ok"]
        first = await other.until(lambda message: message["type"] == "picture")
        later = await other.until(lambda message: message["type"] == "picture")
        assert later["since"] == first["frame"]
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR] == [
        "page: the picture: internal error, all else goes on (logged once)"
    ]


async def test_a_failing_stop_closes_the_connection_instead(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    honest = ViewerClient.call

    def no_stop(client: ViewerClient, name: str, *rest: Any) -> None:
        # Stopping the robot fails; the connection is closed instead, which stops it as well.
        if name == "st":
            trouble()
        honest(client, name, *rest)

    async with serve_viewer(Emulator(simulation())) as here, here.page() as page, here.page() as other:
        robot = here.daemon.emulator.simulation.robots[1]
        monkeypatch.setattr(ViewerClient, "call", no_stop)
        await page.send_message(do="drive", id=1, robot=1, args=[50, 0, 0])
        await page.answer(1)
        async with asyncio.timeout(5):
            while not robot.is_still((0,)):
                await asyncio.sleep(0.01)
        assert here.viewer_server.controller.error_boundary.counts == {("stopping a robot", Trouble): 1}
        for _ in range(3):
            await other.until(lambda message: message["type"] == "picture")
        await page.send_message(do="drive", id=2, robot=1, args=[0, 10, 0])
        assert (await page.answer(2))["ok"]


async def test_an_unexpected_error_is_answered_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        monkeypatch.setattr(controller, "answer_line", trouble)
        await page.send_message(do="control", id=9, command="pause")
        answer = await page.answer(9)
        assert not answer["ok"]
        assert "Trouble('on purpose')" in answer["error"]
        await page.send_message(do="call", id=10, robot=1, call="st", args=[])
        assert (await page.answer(10))["ok"]
    assert "a message of a page of viewer 1" in caplog.text


async def test_leaving_answers_pending_calls_with_an_error() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        (viewer,) = here.viewer_server.broadcaster.viewers
        picture: list[dict[str, Any]] = []
        here.daemon.emulator.clock.paused = True
        here.viewer_server.controller.clients(viewer).call(1, "vm", [0, 100, 0], lambda _: None)
        here.daemon.step(0.2)
        # zr turns for some seconds, and the clock is paused: its reply is pending when the page closes.
        here.viewer_server.controller.clients(viewer).call(1, "zr", [], picture.append)
        assert picture == []
        here.viewer_server.controller.clients(viewer).close()
        assert picture == [{"ok": False, "error": "zr: the connection to the robot was closed"}]
        await page.send_message(do="call", id=10, robot=1, call="st", args=[])
        assert (await page.answer(10))["ok"]


def test_a_picture_that_fails_keeps_no_news_back(monkeypatch: pytest.MonkeyPatch) -> None:
    history = SceneHistory(Emulator(simulation()))
    broadcaster = Broadcaster(history)
    viewer = broadcaster.join(may_act=False)
    broadcaster.take()
    broadcaster.notify("{}")
    monkeypatch.setattr(history, "since", trouble)
    news = broadcaster.next_for(viewer)
    assert next(news) == "{}"
    with pytest.raises(Trouble):
        next(news)
