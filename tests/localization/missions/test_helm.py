"""The helm: a period at a time, touches that others stop, a robot that stands at the end."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from localization.missions.controller import Helm
from localization.navigation.path_follower import Velocities
from nclient.errors import BumperHit, ConnectionLost

MakeHelm = Callable[..., Helm]


def test_a_period_drives_and_is_watched(helm_at: MakeHelm) -> None:
    helm, clocks = helm_at("thesis_room"), []
    helm.watchers.append(lambda sight: clocks.append(sight.estimate.clock_s))
    start = helm.clock_s
    for _ in range(10):
        sight = helm.period(Velocities(5.0, 0.0))
    assert sight.state.x_in == pytest.approx(5.0, abs=0.6)
    assert clocks == pytest.approx([start + 0.1 * (k + 1) for k in range(10)])
    with helm:
        helm.period(Velocities(5.0, 0.0))
    assert helm.robot.refresh().translation_in_s == 0.0


def test_where_states_come_far_apart_it_goes_no_farther_between_two_than_in_half_a_second(helm_at: MakeHelm) -> None:
    helm = helm_at("thesis_room", step_s=0.55)
    ways = [helm.period(Velocities(5.0, 0.0)).state.x_in for _ in range(6)]
    assert ways[-1] - ways[-2] == pytest.approx(2.5, abs=0.2)


def test_a_cause_is_told_and_not_that_the_robot_could_not_be_stopped(
    helm_at: MakeHelm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> None:
        raise ConnectionLost("not back yet")

    helm = helm_at("thesis_room")
    with monkeypatch.context() as patched:
        patched.setattr(helm.robot, "stop", gone)
        with pytest.raises(ConnectionLost, match="the cause"), helm:
            raise ConnectionLost("the cause")
        with pytest.raises(ConnectionLost, match="not back"), helm:
            pass


def test_a_touch_that_others_stop_is_seen_by_the_next_question(
    helm_at: MakeHelm, monkeypatch: pytest.MonkeyPatch
) -> None:
    helm = helm_at("thesis_room")

    def hit(**_: float) -> None:
        raise BumperHit("vm", (0,))

    monkeypatch.setattr(helm.robot, "drive", hit)
    before = helm.clock_s
    assert helm.period(Velocities(5.0, 0.0)).estimate.clock_s > before


def test_a_fence_is_a_wall_to_the_planner(helm_at: MakeHelm) -> None:
    helm = helm_at("thesis_room")
    walls = len(helm.planner.walls)
    helm.fence(helm.planner.walls[:2] + 5.0)
    assert len(helm.planner.walls) == walls + 2
