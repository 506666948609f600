"""A map is published while it is learned, in the frame of the page, uncertain walls marked."""

from __future__ import annotations

import json
from dataclasses import replace
from math import cos, radians, sin
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from localization.live.run import GroundTruth, Publisher
from localization.mapping.association import MapEstimate
from localization.mapping.live import LiveMapper
from localization.mapping.output import MapPublisher, is_uncertain
from localization.mapping.survey import SurveyStep
from localization.mapping.walls import MAX_STD_IN, extract_walls
from nclient.state import RobotState
from nserver_emu.viewer.messages import parse_published
from tests.localization.mapping.drives import ROOM, true_path

WORLD = np.array((200.0, -50.0, radians(30.0)))
"""Where the room of the drive lies on the page."""


class Page:
    """A connection that collects messages."""

    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []

    def publish(self, message: dict[str, Any]) -> None:
        assert parse_published(json.dumps(message))[0] == "map"
        self.messages.append(message)

    def close(self) -> None: ...


def placed(x: float, y: float) -> tuple[float, float]:
    c, s = cos(WORLD[2]), sin(WORLD[2])
    return float(WORLD[0] + c * x - s * y), float(WORLD[1] + s * x + c * y)


def publish_drive(estimate: MapEstimate, truth: list[tuple[float, float, float]] | None) -> list[dict[str, Any]]:
    """Publish half a minute of the drive of `estimate`, true poses each second or none, and its end."""
    now_s, page = [0.0], Page()
    publisher = MapPublisher(cast(Publisher, page), lambda: now_s[0])
    publisher.ground_truth = cast(
        GroundTruth, SimpleNamespace(robot_id=2, at=lambda clock_s: truth and truth[int(clock_s)])
    )
    mapper = cast(LiveMapper, SimpleNamespace(rounds=1, estimate=estimate))
    for second in range(30):
        now_s[0] = float(second)
        state = cast(RobotState, SimpleNamespace(clock_s=now_s[0], x_in=5.0, y_in=6.0, steering_rad=0.5))
        for pose in (None, np.zeros(3), np.zeros(3)):
            publisher.add(SurveyStep(now_s[0], state, pose), mapper)
    publisher.finish(estimate, "Written to room.toml.")
    publisher.close()
    return page.messages


def test_walls_lie_where_the_true_path_places_them(estimate: MapEstimate) -> None:
    messages = publish_drive(estimate, [(*placed(x, y), heading) for _, x, y, heading in true_path()[::10]])
    assert len(messages) == 31, "one message a second, and the last one"
    assert {message["outcome"] for message in messages[:-1]} == {""}
    last = messages[-1]
    assert (last["robot"], last["outcome"]) == (2, "Written to room.toml.")
    corners = np.array([placed(*corner) for corner in ROOM])
    ends = np.array([wall["ends"] for wall in last["walls"]]).reshape(-1, 2)
    assert len(ends) == 8
    assert np.hypot(*(ends[:, None] - corners).transpose(2, 0, 1)).min(axis=1).max() < 0.6
    assert not any(wall["is_uncertain"] for wall in last["walls"])


def test_map_of_a_real_robot_begins_at_its_encoders(estimate: MapEstimate) -> None:
    first = publish_drive(estimate, None)[0]
    assert first["pose"] == pytest.approx([5.0, 6.0, 0.5])


def test_poorly_known_walls_are_uncertain(estimate: MapEstimate) -> None:
    wall = extract_walls(estimate)[0]
    assert not is_uncertain(wall)
    assert is_uncertain(replace(wall, std_in=1.1 * MAX_STD_IN))
    assert is_uncertain(replace(wall, std_rad=radians(1.5)))
    assert is_uncertain(replace(wall, low=wall.high - 0.4 * wall.length_in))
