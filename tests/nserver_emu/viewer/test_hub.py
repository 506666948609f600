"""Viewers as queues: who is quick sees every picture, who is slow the newest, and nobody piles anything up."""

from __future__ import annotations

import json
from typing import Any

import pytest

from nserver_emu.server.config import Setting
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.viewer.hub import AHEAD, MOST_NEWS, Hub, Viewer
from nserver_emu.viewer.scene import LASER_EVERY, Album
from tests.nserver_emu.server.wire_client import simulation
from worlds.world import StartPose


def a_hub() -> Hub:
    return Hub(Album(Emulator(simulation())))


def told(hub: Hub, viewer: Viewer) -> list[dict[str, Any]]:
    return [json.loads(text) for text in hub.next_for(viewer)]


def test_a_quick_viewer_gets_every_picture_from_the_one_before() -> None:
    hub = a_hub()
    viewer = hub.join(may_act=False)
    seen = []
    for _ in range(30):
        hub.take()
        (picture,) = told(hub, viewer)
        assert told(hub, viewer) == []
        seen.append((picture["since"], picture["frame"]))
        viewer.saw(picture["frame"])
    assert seen == [(number, number + 1) for number in range(30)]


def test_a_slow_viewer_gets_the_newest_and_never_a_backlog() -> None:
    hub = a_hub()
    slow = hub.join(may_act=False)
    given = 0
    for _ in range(500):
        hub.take()
        given += len(told(hub, slow))
    assert given == AHEAD
    slow.saw(5)
    (picture,) = told(hub, slow)
    assert (picture["since"], picture["frame"]) == (0, 500)


def test_who_comes_is_not_shown_what_was_when_somebody_looked_last() -> None:
    emulator = Emulator(simulation())
    hub = Hub(Album(emulator))
    hub.take()
    emulator.simulation.robots[1].place(300.0, 200.0, 0.0, 0.0)
    late = hub.join(may_act=False)
    assert told(hub, late) == []
    hub.take()
    (picture,) = told(hub, late)
    assert (picture["since"], picture["robots"]["1"]["actual"][:2]) == (0, [300, 200])
    assert "world" in picture


def test_viewers_at_the_same_picture_share_its_text() -> None:
    hub = a_hub()
    first, second = hub.join(may_act=False), hub.join(may_act=True)
    hub.take()
    (one,), (other,) = hub.next_for(first), hub.next_for(second)
    assert one is other


def test_news_come_in_order_before_the_picture_and_the_oldest_are_left_out() -> None:
    hub = a_hub()
    viewer = hub.join(may_act=False)
    hub.take()
    for number in range(MOST_NEWS + 7):
        hub.tell(json.dumps({"type": "x", "number": number}))
    *news, missed, picture = told(hub, viewer)
    assert [message["number"] for message in news] == list(range(7, MOST_NEWS + 7))
    assert missed == {"type": "missed", "count": 7}
    assert picture["type"] == "picture"
    hub.tell("{}")
    assert told(hub, viewer) == [{}]


def test_traffic_is_for_those_who_watch_it() -> None:
    hub = a_hub()
    viewer, other = hub.join(may_act=False), hub.join(may_act=False)
    before = hub.watch_traffic
    viewer.traffic = True
    assert (before, hub.watch_traffic) == (False, True)
    hub.tell("{}", traffic=True)
    assert (list(viewer.news()), list(other.news())) == (["{}"], [])


def test_who_is_gone_is_forgotten() -> None:
    hub = a_hub()
    viewer = hub.join(may_act=False)
    hub.leave(viewer)
    hub.leave(viewer)
    hub.tell("{}")
    assert not hub.viewers
    assert not viewer.news()


def test_lasers_are_looked_through_for_the_robots_that_somebody_looks_at(monkeypatch: pytest.MonkeyPatch) -> None:
    emulator = Emulator(Setting(others=(("n200", StartPose(70.0, 70.0)), ("n200", None)), robot="n200").simulation())
    hub = Hub(Album(emulator))
    looked: list[SimulatedRobot] = []
    honest = SimulatedRobot.scan_laser

    def look(robot: SimulatedRobot) -> Any:
        looked.append(robot)
        return honest(robot)

    def seen() -> set[int]:
        looked.clear()
        for _ in range(LASER_EVERY):
            hub.take()
        return {number for number, robot in emulator.simulation.robots.items() if robot in looked}

    monkeypatch.setattr(SimulatedRobot, "look_with_laser", look)
    first, second = hub.join(may_act=False), hub.join(may_act=False)
    assert seen() == set()
    first.laser, first.whose_laser = True, 2
    assert seen() == {2}
    second.whose_laser = 3
    assert seen() == {2}
    second.laser = True
    assert seen() == {2, 3}
    told(hub, first)
    second.whose_laser = None
    assert seen() == {1, 2, 3}
    hub.leave(second)
    assert seen() == {2}
    (picture,) = told(hub, first)
    assert list(picture["lasers"]) == ["2"]
