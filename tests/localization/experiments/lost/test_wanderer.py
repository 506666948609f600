"""Driving about: on a roadmap while the estimate is believed, by the sonars ahead while it is not."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np
import pytest

from localization.experiments.lost.wanderer import LOOK_S, STAND, TURN_RAD_S, Wanderer
from localization.navigation import PERIOD_S, Command, Speeds
from localization.planning.roadmap import Roadmap
from worlds.geometry import polygon_segments

ROOM = polygon_segments([(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)])
GOAL = np.array([[80.0, 20.0]])


def wanderer(places: np.typing.NDArray[np.float64] = GOAL) -> Wanderer:
    return Wanderer(Roadmap(ROOM, 12.0), places, Speeds(translation_in_s=5.0), np.random.default_rng(0))


def test_it_plans_standing_then_turns_on_the_spot_then_drives_and_plans_anew_when_it_is_there() -> None:
    one = wanderer()
    assert one.command(np.array([20.0, 20.0, pi])) == STAND
    assert one.command(np.array([20.0, 20.0, pi])).translation_in_s == 0.0
    assert one.command(np.array([20.0, 20.0, -2.0])) == Command(0.0, TURN_RAD_S)
    assert one.command(np.array([20.0, 20.0, 2.0])) == Command(0.0, -TURN_RAD_S)
    assert one.command(np.array([20.0, 20.0, 0.0])) == Command(5.0, 0.0)
    assert one.command(np.array([79.5, 20.0, 0.0])) == STAND


def test_where_there_is_no_way_it_stands_and_tries_the_next_place() -> None:
    one = wanderer(np.array([[2.0, 2.0]]))
    assert one.command(np.array([20.0, 20.0, 0.0])) == STAND
    assert one.command(np.array([20.0, 20.0, 0.0])) == STAND


class Ring(NamedTuple):
    sonars_in: tuple[int, ...]
    steering_rad: float = 1.0
    turret_rad: float = 1.0


def near(*sonars: int) -> tuple[int, ...]:
    return tuple(10 if sonar in sonars else 255 for sonar in range(16))


@pytest.mark.parametrize(("readings", "speed_in_s"), [(near(), 3.0), (near(0), 0.0), (near(15), 0.0), (near(8), 3.0)])
def test_lost_it_looks_around_and_then_drives_where_there_is_room_ahead(
    readings: tuple[int, ...], speed_in_s: float
) -> None:
    heard = Ring(readings)
    one = wanderer()
    turning = [one.grope(heard) for _ in range(round(LOOK_S / PERIOD_S) - 1)]
    assert set(turning) == {Command(0.0, TURN_RAD_S)}
    assert one.grope(heard).translation_in_s == speed_in_s
    one.command(np.array([20.0, 20.0, 0.0]))
    assert one.grope(heard) == Command(0.0, TURN_RAD_S)
