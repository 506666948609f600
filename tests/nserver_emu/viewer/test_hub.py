"""Viewers as queues: who is quick sees every picture, who is slow the newest, and nobody piles anything up."""

from __future__ import annotations

import json
from typing import Any

from wire_client import simulation

from nserver_emu.server.handlers import Emulator
from nserver_emu.viewer.hub import AHEAD, MOST_NEWS, Hub, Viewer
from nserver_emu.viewer.picture import Album


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
    assert (viewer.news(), other.news()) == (["{}"], [])


def test_who_is_gone_is_forgotten() -> None:
    hub = a_hub()
    viewer = hub.join(may_act=False)
    hub.leave(viewer)
    hub.leave(viewer)
    hub.tell("{}")
    assert not hub.viewers
    assert viewer.news() == []
