"""Published estimates are validated, shown on all pages, and answered with the requested goal."""

from __future__ import annotations

import json
from typing import Any, get_args

import pytest

from localization.filters.health import HealthStatus
from localization.filters.update import Refusal
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.controller import ViewerController
from nserver_emu.viewer.http_port import Access
from nserver_emu.viewer.messages import (
    MAX_PLACES,
    MAX_REASON,
    STALE_S,
    InvalidMessage,
    Trust,
    parse_estimate,
    parse_published,
)
from nserver_emu.viewer.messages import Refusal as RefusalName
from nserver_emu.viewer.scene import Broadcaster, SceneHistory
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer

GOOD: dict[str, Any] = {
    # One valid estimate; the tests below change one field of it at a time.
    "robot": 1, "clock_s": 1.5, "pose": [1, 2, 0.1], "turret": 0.2, "cov": [[1, 0, 0], [0, 2, 0], [0, 0, 3]],
    "odometry": [1, 2, 3], "truth": None, "waypoints": [[5, 6]], "passed": 0, "trust": "LOST", "reason": "2 look alike",
    "places": [{"pose": [1, 2, 0.1], "share": 0.7}, {"pose": [9, 8, -3], "share": 0.3}],
    "echoes": [{"sonar": 3, "reading_in": 40, "refusal": "gate", "innovation_in": 0, "nis": 0}],
}  # fmt: skip


def test_refusals_have_the_filter_s_own_names() -> None:
    assert [rejection_reason.name.lower() for rejection_reason in Refusal] == list(get_args(RefusalName))
    assert [trust.value for trust in HealthStatus] == list(get_args(Trust))


def test_what_is_right_comes_through() -> None:
    message = parse_estimate(json.dumps(GOOD | {"more": 1}))
    # Unknown keys are dropped, the covariance is flattened row by row.
    assert message == GOOD | {"cov": [1, 0, 0, 0, 2, 0, 0, 0, 3], "began": False}
    assert parse_estimate(json.dumps(GOOD | {"truth": [1, 2, 3]}))["truth"] == [1, 2, 3]


@pytest.mark.parametrize(
    "change",
    [{"pose": [1, 2]}, {"pose": None}, {"clock_s": "x"}, {"clock_s": float("nan")}, {"cov": [1, 2, 3]}, {"robot": None},
     {"echoes": [{"sonar": 1}]}, {"echoes": [GOOD["echoes"][0] | {"refusal": "whim"}]}, {"waypoints": [[1, 2, 3]]},
     # Covariances: a negative variance, a correlation above 1, and (below) not symmetric.
     {"pose": [1e308, 0, 0]}, {"cov": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}, {"cov": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]},
     {"echoes": [GOOD["echoes"][0] | {"sonar": 64}]}, {"echoes": [GOOD["echoes"][0] | {"sonar": -1e23}]},
     {"robot": 1e30}, {"passed": -1}, {"passed": True}, {"clock_s": "1"}, {"turret": True}, {"clock_s": 10**400},
     {"cov": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, {"cov": [[1, 0, 2], [0, 1, 0], [2, 0, 1]]},
     {"echoes": [GOOD["echoes"][0] | {"reading_in": -1}]}, {"echoes": [GOOD["echoes"][0] | {"reading_in": 1e6}]},
     {"echoes": [GOOD["echoes"][0] | {"nis": -0.1}]}, {"echoes": [GOOD["echoes"][0] | {"refusal": ["gate"]}]},
     {"trust": "ok"}, {"trust": None}, {"trust": ["OK"]}, {"reason": None}, {"reason": 7}, {"reason": ["x"]},
     {"places": None}, {"places": [{"pose": [1, 2, 3]}]}, {"places": [{"pose": [1, 2], "share": 0.5}]},
     {"places": [{"pose": [1, 2, 1e300], "share": 0.5}]}, {"places": [{"pose": [1, 2, 3], "share": -0.1}]},
     {"places": [{"pose": [1, 2, 3], "share": 1.1}]}, {"places": [{"pose": [1, 2, 3], "share": True}]},
     {"places": [{"pose": [1, 2, 3], "share": 0.6}] * 2}, {"places": {"pose": [1, 2, 3]}}, {"places": [[1, 2, 3]]}],
)  # fmt: skip
def test_anything_else_is_refused(change: dict[str, Any]) -> None:
    # The error names the field that was changed.
    with pytest.raises(InvalidMessage, match=rf"estimate: {next(iter(change))}"):
        parse_estimate(json.dumps(GOOD | change))


@pytest.mark.parametrize("missing", sorted(GOOD))
def test_each_part_is_wanted(missing: str) -> None:
    with pytest.raises(InvalidMessage, match=missing):
        parse_estimate(json.dumps({name: value for name, value in GOOD.items() if name != missing}))


def test_places_and_reason_are_truncated() -> None:
    places = [{"pose": [k, 0, 0], "share": 0.01} for k in range(3 * MAX_PLACES)]
    message = parse_estimate(json.dumps(GOOD | {"places": places, "reason": "x" * 1000, "trust": "OK"}))
    assert [place["pose"][0] for place in message["places"]] == list(range(MAX_PLACES))
    assert message["reason"] == "x" * MAX_REASON
    assert parse_estimate(json.dumps(GOOD | {"places": [], "reason": ""}))["places"] == []


@pytest.mark.parametrize("text", ["", "[]", "7", "[" * 100_000])
def test_no_text_is_more_than_a_refusal(text: str) -> None:
    with pytest.raises(InvalidMessage):
        parse_estimate(text)


def test_an_old_estimate_is_not_sent_to_new_pages() -> None:
    controller = ViewerController(Daemon(Emulator(simulation())), Broadcaster(SceneHistory(Emulator(simulation()))))
    controller.publish(json.dumps(GOOD), 100.0)

    def ages(now: float) -> list[Any]:
        message = [json.loads(text) for text in controller.connect_page(now, Access(may_act=False)).take_messages()]
        return [message["age_s"] for message in message if message["type"] == "localization"]

    # Estimates carry their age, and are dropped when they are stale.
    assert ages(112.3) == [12.3]
    assert ages(100.0 + STALE_S) == []


def test_a_new_localizer_discards_old_waypoints() -> None:
    controller = ViewerController(Daemon(Emulator(simulation())), Broadcaster(SceneHistory(Emulator(simulation()))))
    viewer = controller.broadcaster.join(may_act=False)
    controller.set_waypoints(1, [[7, 8]])
    # The new localizer has waypoints of its own, so those set before are cleared; `set` counts the changes.
    assert controller.publish(json.dumps(GOOD | {"began": True}), 1.0) == {"waypoints": [], "set": 2}
    message = [json.loads(text) for text in viewer.take_messages()]
    assert [(one["type"], one.get("points")) for one in message] == [
        ("waypoints", [[7, 8]]), ("waypoints", []), ("localization", None)
    ]  # fmt: skip
    assert "began" not in message[-1]
    assert controller.publish(json.dumps(GOOD | {"began": True}), 2.0) == {"waypoints": [], "set": 2}
    controller.set_waypoints(1, [[1, 2]])
    assert controller.publish(json.dumps(GOOD), 3.0) == {"waypoints": [[1, 2]], "set": 3}


def test_a_new_localizer_gets_waypoints_set_while_it_started() -> None:
    controller = ViewerController(Daemon(Emulator(simulation())), Broadcaster(SceneHistory(Emulator(simulation()))))
    without = GOOD | {"waypoints": [], "began": True}
    controller.set_waypoints(1, [[7, 8]])
    assert controller.publish(json.dumps(without), 1.0) == {"waypoints": [[7, 8]], "set": 1}
    # The next localizer does not drive to what this one has received.
    assert controller.publish(json.dumps(without), 2.0) == {"waypoints": [], "set": 2}


async def test_a_posted_estimate_reaches_present_and_later_pages() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page(here.viewer_server.watch_token) as page:
        address = f"{here.origin}/publish"
        async with here.web.post(address, params={"token": here.viewer_server.token}, json=GOOD) as answer:
            assert await answer.json() == {"waypoints": None, "set": 0}
        shown = await page.until(lambda message: message["type"] == "localization")
        assert shown["pose"] == GOOD["pose"]
        async with here.page() as late:
            await late.until(lambda message: message["type"] == "localization")
            await late.send_message(do="waypoints", robot=1, points=[[7, 8]])
            await late.until(lambda message: message["type"] == "waypoints")
        async with here.web.post(address, params={"token": here.viewer_server.token}, json=GOOD) as answer:
            assert await answer.json() == {"waypoints": [[7, 8]], "set": 1}
        for token, body, status in (
            (here.viewer_server.watch_token, GOOD, 403), ("", GOOD, 403), (here.viewer_server.token, {}, 400),
        ):  # fmt: skip
            async with here.web.post(address, params={"token": token}, json=body) as answer:
                assert answer.status == status
        for strange in (json.dumps(GOOD | {"robot": 9}).encode(), b"\xff"):
            async with here.web.post(address, params={"token": here.viewer_server.token}, data=strange) as answer:
                assert answer.status == 400


MAP: dict[str, Any] = {
    "robot": 1, "elapsed_s": 8.0, "pose": [1, 2, 0.1], "outcome": "", "points": [[5, 6]],
    "walls": [{"ends": [[0, 0], [9, 0]], "is_uncertain": False}, {"ends": [[9, 0], [9, 7]], "is_uncertain": True}],
}  # fmt: skip


def test_learned_map_comes_through_beside_estimates() -> None:
    controller = ViewerController(Daemon(Emulator(simulation())), Broadcaster(SceneHistory(Emulator(simulation()))))
    controller.set_waypoints(1, [[7, 8]])
    controller.publish(json.dumps(GOOD | {"waypoints": []}), 1.0)
    # It neither gets waypoints of localizers nor ends them.
    assert controller.publish(json.dumps(MAP | {"began": True}), 2.0) == {"waypoints": [[7, 8]], "set": 1}
    viewer = controller.connect_page(3.0, Access(may_act=False))
    shown = [json.loads(text) for text in viewer.take_messages()]
    assert [message for message in shown if message["type"] == "map"] == [MAP | {"type": "map", "age_s": 1.0}]
    assert [message["type"] for message in shown].count("localization") == 1


@pytest.mark.parametrize(
    "change",
    [{"walls": None}, {"walls": [{"ends": [[0, 0]], "is_uncertain": True}]}, {"walls": [[0, 0, 9, 0]]},
     {"walls": [{"ends": [[0, 0], [9, 1e99]], "is_uncertain": True}]}, {"points": [[1]]}, {"outcome": None},
     {"pose": [1, 2]}, {"elapsed_s": "x"}, {"robot": -1}],
)  # fmt: skip
def test_wrong_maps_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InvalidMessage, match=rf"map: {next(iter(change))}"):
        parse_published(json.dumps(MAP | change))
