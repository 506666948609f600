"""Doors and walkers at run time: each change can be undone by its reply, and a wrong one changes nothing."""

from __future__ import annotations

from typing import Any

import pytest

from nclient.errors import ControlError
from nserver_emu.server.handlers.runtime_settings import change_door, change_walker, door_words, put_world
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.simulation import Simulation
from worlds.io import format_world
from worlds.world import MAX_DOORS, MAX_WALKERS, Polygon, StartPose, World

ROOM = Polygon(((0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (0.0, 100.0)))


@pytest.fixture
def emulator() -> Emulator:
    """Return an emulator of a room with a robot."""
    simulation = Simulation(World("room", rooms=(ROOM,)))
    simulation.add_robot(1, StartPose(50.0, 50.0))
    return Emulator(simulation)


def test_doors_are_added_opened_moved_and_removed(emulator: Emulator) -> None:
    # 1. A closed door is a wall; an open one is not.
    gate = {"put": [[100.0, 0.0], [100.0, 60.0]], "name": "gate", "open": False}
    walls = len(emulator.simulation.world.walls)
    assert change_door(emulator, gate) == {"doors": 1, "was": None, "is": gate}
    assert len(emulator.simulation.world.walls) == walls + 1
    assert change_door(emulator, door_words("gate open")) == {"doors": 1, "was": gate, "is": gate | {"open": True}}
    assert len(emulator.simulation.world.walls) == walls
    # The name alone is the other state.
    assert change_door(emulator, door_words("gate"))["is"]["open"] is False
    # 2. It is moved by a vector, and back by the reply's "was".
    moved = change_door(emulator, {"door": "gate", "by": [5, 0]})
    assert moved["is"]["put"] == [[105, 0], [105, 60]]
    assert change_door(emulator, {"door": "gate", "to": moved["was"]["put"]})["is"] == gate
    assert change_door(emulator, {"door": "gate", "remove": True}) == {"doors": 0, "was": gate, "is": None}
    # A name may have spaces: the last word alone is the state.
    assert door_words("the front door close") == {"door": "the front door", "open": False}


def test_walkers_are_added_moved_and_removed(emulator: Emulator) -> None:
    ada = {"put": [[100.0, 20.0], [180.0, 20.0]], "name": "Ada", "speed": 30.0, "radius": 8.0, "closed": False}
    assert change_walker(emulator, ada) == {"walkers": 1, "was": None, "is": ada}
    # 30 in/s from (100, 20): after 1 s at x = 130.
    emulator.pass_time(1.0)
    x, y, radius = emulator.simulation.walkers[0].disc
    assert (x, y, radius) == pytest.approx((130.0, 20.0, 8.0))
    # Somebody else comes, and the first one walks on.
    change_walker(emulator, {"put": [[100, 80], [180, 80]]})
    emulator.pass_time(1.0)
    assert emulator.simulation.walkers[0].disc[0] == pytest.approx(160.0)
    # A walker is found by its route.
    moved = change_walker(emulator, {"walker": ada["put"], "by": [0, 10]})
    assert moved["is"]["put"] == [[100, 30], [180, 30]]
    assert change_walker(emulator, {"walker": moved["is"]["put"]})["walkers"] == 1
    assert [walker.disc[1] for walker in emulator.simulation.walkers] == [80.0]


@pytest.mark.parametrize(
    ("change", "words"),
    [({}, "such as"), ({"put": [[1, 1], [9, 9]]}, "such as"), ({"put": 5, "name": "a"}, "such as"),
     ({"put": [[1, 1]], "name": "a"}, "two ends"), ({"put": [[30, 50], [70, 50]], "name": "a"}, "touch robot"),
     ({"put": [[1, 1], [9, 9]], "name": " "}, "name"), ({"put": [[1, 1], [9, 9]], "name": "gate"}, "other door"),
     ({"door": "gat"}, "gate"), ({"door": "gate", "by": [1e9, 0]}, "on the map"), ({"door": ["x"]}, "no door"),
     ({"door": "gate", "to": [[30, 50], [70, 50]]}, "touch"), ({"door": "gate", "open": "no"}, "such as")],
)  # fmt: skip
def test_wrong_door_changes_nothing(emulator: Emulator, change: dict[str, Any], words: str) -> None:
    change_door(emulator, {"put": [[100, 0], [100, 60]], "name": "gate"})
    world = emulator.simulation.world
    with pytest.raises(ControlError, match=words):
        change_door(emulator, change)
    assert emulator.simulation.world is world


@pytest.mark.parametrize(
    ("change", "words"),
    [({}, "such as"), ({"put": "x"}, "such as"), ({"put": [[100, 20]]}, "2 to"), ({"put": [[9, 20], [9e9, 20]]}, "map"),
     ({"put": [[100, 20], [100, 20.1]]}, "apart"), ({"put": [[100, 20], [180, 20]], "speed": 1e3}, "speed"),
     ({"put": [[100, 20], [180, 20]], "radius": 0}, "radius"), ({"put": [[100, 20], [300, 20]]}, "clear of walls"),
     ({"put": [[100, 20], [180, 20]], "closed": 1}, "such as"),
     ({"put": [[50, 60], [180, 20]]}, "stands where"), ({"walker": [[1, 2], [3, 4]]}, "none with this route")],
)  # fmt: skip
def test_wrong_walker_changes_nothing(emulator: Emulator, change: dict[str, Any], words: str) -> None:
    world = emulator.simulation.world
    with pytest.raises(ControlError, match=words):
        change_walker(emulator, change)
    assert emulator.simulation.world is world


def test_doors_and_walkers_are_limited(emulator: Emulator) -> None:
    # All doors are open, so they do not block each other or the robot.
    for k in range(MAX_DOORS):
        change_door(emulator, {"put": [[150, 0], [150, 9]], "name": str(k), "open": True})
    with pytest.raises(ControlError, match="maximum"):
        change_door(emulator, {"put": [[150, 0], [150, 9]], "name": "one more"})
    for _ in range(MAX_WALKERS):
        change_walker(emulator, {"put": [[100, 20], [180, 20]]})
    with pytest.raises(ControlError, match="maximum"):
        change_walker(emulator, {"put": [[100, 20], [180, 20]]})


def test_robots_and_walkers_do_not_start_in_one_place(emulator: Emulator) -> None:
    change_walker(emulator, {"put": [[100, 50], [180, 50]]})
    with pytest.raises(ValueError, match="walker"):
        emulator.simulation.add_robot(2, StartPose(110.0, 50.0))
    # The world as text has the walker, whose start is then occupied by a robot.
    text = format_world(emulator.simulation.world)
    change_walker(emulator, {"walker": [[100, 50], [180, 50]]})
    emulator.simulation.place(1, 100.0, 50.0, 0.0, 0.0)
    with pytest.raises(ControlError, match="walker"):
        put_world(emulator, text, "busy.toml")
