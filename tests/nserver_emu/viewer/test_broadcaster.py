"""Viewers as queues: a fast one gets every picture, a slow one the newest, and none accumulates a backlog."""

from __future__ import annotations

import json
from typing import Any

import pytest

from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.viewer.scene import LASER_INTERVAL, MAX_MESSAGES, MAX_UNDRAWN, Broadcaster, SceneHistory, Viewer
from tests.nserver_emu.server.wire_client import simulation
from worlds.world import StartPose


def a_hub() -> Broadcaster:
    return Broadcaster(SceneHistory(Emulator(simulation())))


def messages_for(broadcaster: Broadcaster, viewer: Viewer) -> list[dict[str, Any]]:
    return [json.loads(text) for text in broadcaster.next_for(viewer)]


def test_a_quick_viewer_gets_every_picture_from_the_one_before() -> None:
    broadcaster = a_hub()
    viewer = broadcaster.join(may_act=False)
    seen = []
    for _ in range(30):
        broadcaster.take()
        (picture,) = messages_for(broadcaster, viewer)
        assert messages_for(broadcaster, viewer) == []
        seen.append((picture["since"], picture["frame"]))
        viewer.mark_drawn(picture["frame"])
    # Each picture is the difference to the one that the viewer has drawn.
    assert seen == [(number, number + 1) for number in range(30)]


def test_a_slow_viewer_gets_the_newest_and_never_a_backlog() -> None:
    broadcaster = a_hub()
    slow = broadcaster.join(may_act=False)
    pictures = 0
    for _ in range(500):
        broadcaster.take()
        pictures += len(messages_for(broadcaster, slow))
    # 500 pictures, and none acknowledged: only MAX_UNDRAWN are sent.
    assert pictures == MAX_UNDRAWN
    # Acknowledging the fifth one makes room; its difference is no longer known, so all is sent (since 0).
    slow.mark_drawn(5)
    (picture,) = messages_for(broadcaster, slow)
    assert (picture["since"], picture["frame"]) == (0, 500)


def test_a_new_viewer_gets_no_stale_picture() -> None:
    emulator = Emulator(simulation())
    # A picture from before the viewer came is old: it waits for the next one.
    broadcaster = Broadcaster(SceneHistory(emulator))
    broadcaster.take()
    emulator.simulation.robots[1].place(300.0, 200.0, 0.0, 0.0)
    late = broadcaster.join(may_act=False)
    assert messages_for(broadcaster, late) == []
    broadcaster.take()
    (picture,) = messages_for(broadcaster, late)
    assert (picture["since"], picture["robots"]["1"]["actual"][:2]) == (0, [300, 200])
    assert "world" in picture


def test_viewers_at_the_same_picture_share_its_text() -> None:
    broadcaster = a_hub()
    first, second = broadcaster.join(may_act=False), broadcaster.join(may_act=True)
    broadcaster.take()
    (one,), (other,) = broadcaster.next_for(first), broadcaster.next_for(second)
    # The same object: encoded once for both.
    assert one is other


def test_messages_precede_the_picture_and_the_oldest_are_dropped() -> None:
    broadcaster = a_hub()
    viewer = broadcaster.join(may_act=False)
    broadcaster.take()
    # Seven messages more than the queue holds.
    for number in range(MAX_MESSAGES + 7):
        broadcaster.notify(json.dumps({"type": "x", "number": number}))
    *news, missed, picture = messages_for(broadcaster, viewer)
    assert [message["number"] for message in news] == list(range(7, MAX_MESSAGES + 7))
    assert missed == {"type": "missed", "count": 7}
    assert picture["type"] == "picture"
    broadcaster.notify("{}")
    assert messages_for(broadcaster, viewer) == [{}]


def test_only_viewers_that_watch_get_traffic() -> None:
    broadcaster = a_hub()
    viewer, other = broadcaster.join(may_act=False), broadcaster.join(may_act=False)
    before = broadcaster.watch_traffic
    viewer.traffic = True
    assert (before, broadcaster.watch_traffic) == (False, True)
    broadcaster.notify("{}", traffic=True)
    assert (list(viewer.take_messages()), list(other.take_messages())) == (["{}"], [])


def test_a_viewer_that_left_gets_nothing() -> None:
    broadcaster = a_hub()
    viewer = broadcaster.join(may_act=False)
    broadcaster.viewers.discard(viewer)
    broadcaster.viewers.discard(viewer)
    broadcaster.notify("{}")
    assert not broadcaster.viewers
    assert not viewer.take_messages()


def test_lasers_are_measured_only_for_watched_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    config = SimulationConfig(others=(("n200", StartPose(70.0, 70.0)), ("n200", None)), robot="n200")
    emulator = Emulator(config.simulation())
    broadcaster = Broadcaster(SceneHistory(emulator))
    looked: list[SimulatedRobot] = []
    honest = SimulatedRobot.scan_laser

    def look(robot: SimulatedRobot) -> Any:
        looked.append(robot)
        return honest(robot)

    def seen() -> set[int]:
        looked.clear()
        # The laser is measured in every LASER_INTERVAL-th picture.
        for _ in range(LASER_INTERVAL):
            broadcaster.take()
        return {number for number, robot in emulator.simulation.robots.items() if robot in looked}

    monkeypatch.setattr(SimulatedRobot, "scan_laser", look)
    first, second = broadcaster.join(may_act=False), broadcaster.join(may_act=False)
    assert seen() == set()
    first.laser, first.laser_robot = True, 2
    assert seen() == {2}
    # A robot is chosen, but its laser is not shown.
    second.laser_robot = 3
    assert seen() == {2}
    second.laser = True
    assert seen() == {2, 3}
    messages_for(broadcaster, first)
    # No robot: all of them.
    second.laser_robot = None
    assert seen() == {1, 2, 3}
    broadcaster.viewers.discard(second)
    assert seen() == {2}
    (picture,) = messages_for(broadcaster, first)
    assert list(picture["lasers"]) == ["2"]
