"""Moving, removing and restoring an obstacle; the result undoes a change exactly."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from nclient.errors import ControlError
from nserver_emu.server.handlers.runtime_settings import change_obstacle
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed
from tests.nserver_emu.server.wire_client import meet, simulation
from worlds.world import Polygon, World

# A twelve-sided pillar whose corners have more decimals than tenths, or the page, show.
TWELVE = tuple(
    (60.123456789 + 9 * math.cos(k * math.tau / 12), 50.1 + 9 * math.sin(k * math.tau / 12)) for k in range(12)
)
ROOM = Polygon(((-30.0, -30.0), (120.0, -30.0), (120.0, 120.0), (-30.0, 120.0)), "hall")
TABLE = Polygon(((20.25, 80.0), (30.1, 80.0), (30.1, 90.0)), "table")
# The page shows three decimals; within 0.002 in they identify the obstacle.
DISPLAYED = [[round(x, 3), round(y, 3)] for x, y in TWELVE]


def a_stage(allowed: int = 50) -> Emulator:
    emulator = Emulator(simulation(), allowed=Allowed(obstacles=allowed))
    emulator.simulation.change_world(World("w", "t", (ROOM,), obstacles=(Polygon(TWELVE, "pillar"), TABLE)))
    return emulator


def test_obstacles_with_many_corners_move_and_are_removed() -> None:
    emulator = a_stage()
    result = change_obstacle(emulator, {"corners": DISPLAYED, "by": [1.5, -0.25]})
    moved = emulator.simulation.world.obstacles
    assert moved == (Polygon(tuple((x + 1.5, y - 0.25) for x, y in TWELVE), "pillar"), TABLE)
    assert result == {"obstacles": 2, "was": [list(corner) for corner in TWELVE], "name": "pillar", "at": 0,
                    "is": [list(corner) for corner in moved[0].corners_in]}  # fmt: skip
    # The old corners find nothing any more.
    with pytest.raises(ControlError, match=r"none with .*corners"):
        change_obstacle(emulator, {"corners": DISPLAYED})
    result = change_obstacle(emulator, {"corners": [[x + 1.5, y - 0.25] for x, y in DISPLAYED]})
    assert (result["obstacles"], result["is"]) == (1, None)
    assert emulator.simulation.world.obstacles == (TABLE,)


def test_the_result_undoes_a_change_exactly() -> None:
    emulator = a_stage()
    before = emulator.simulation.world.obstacles
    # 1. Moved; the reply passes through JSON, as on its path to a page and back.
    moved = json.loads(json.dumps(change_obstacle(emulator, {"corners": DISPLAYED, "by": [0.1, 0.7]})))
    # 2. Meanwhile a client adds an obstacle.
    meet(emulator)[0].ask("add_obstacle", 3, 700, 0, 800, 0, 800, 100)
    theirs = emulator.simulation.world.obstacles[2]
    # 3. Undo: exactly the old corners, and the client's obstacle stays.
    change_obstacle(emulator, {"corners": moved["is"], "to": moved["was"]})
    assert emulator.simulation.world.obstacles == (*before, theirs)
    # 4. Removed, and put back at its old index.
    gone = json.loads(json.dumps(change_obstacle(emulator, {"corners": DISPLAYED})))
    assert emulator.simulation.world.obstacles == (TABLE, theirs)
    put = {"put": gone["was"], "name": gone["name"], "at": gone["at"]}
    assert change_obstacle(emulator, put) == {**gone, "obstacles": 3, "was": None, "is": gone["was"]}
    assert emulator.simulation.world.obstacles == (*before, theirs)


def test_a_new_obstacle_is_last_by_default() -> None:
    emulator = a_stage()
    assert change_obstacle(emulator, {"put": [[80, 0], [90, 0], [90, 9]]})["at"] == 2
    assert change_obstacle(emulator, {"put": [[80, 20], [90, 20], [90, 29]], "name": "b", "at": 99})["at"] == 3
    assert [thing.name for thing in emulator.simulation.world.obstacles] == ["pillar", "table", "", "b"]


CORNERS = [list(corner) for corner in TWELVE]
ONE = [[80, 0], [90, 0], [90, 9]]


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({}, "obstacle: such as"), ({"corners": 3}, "obstacle: such as"),
        ({"corners": [[1, "x"]]}, "obstacle: such as"),
        ({"corners": [[1e999, 0]]}, "obstacle: such as"), ({"corners": [[10**400, 0]]}, "obstacle: such as"),
        ({"corners": CORNERS, "by": [1]}, "obstacle: such as"), ({"corners": CORNERS, "by": [1e9, 0]}, "leave the map"),
        ({"corners": CORNERS, "by": [-60, -50]}, "overlap a robot"),
        ({"corners": CORNERS[:11], "by": [1, 0]}, "none with these corners"),
        ({"corners": CORNERS, "to": 3}, "obstacle: such as"), ({"corners": CORNERS, "to": [[0, 0], [9, 9]]}, "no area"),
        ({"corners": CORNERS, "to": [[0, 0], [9, 9], [9, 0], [0, 9]]}, "sides that cross"),
        ({"put": [[-5, -5], [5, -5], [5, 5]]}, "overlap a robot"), ({"put": None}, "obstacle: such as"),
        ({"put": ONE, "name": 3}, "obstacle: such as"), ({"put": ONE, "at": -1}, "obstacle: such as"),
        ({"put": ONE, "at": True}, "obstacle: such as"), ({"put": ONE, "at": 0.5}, "obstacle: such as"),
        ({"put": [[80, 0], [90, 0]]}, "no area"), ({"put": []}, "no area"),
    ],
)  # fmt: skip
def test_an_obstacle_that_cannot_be_changed_so_stays(wanted: dict[str, Any], words: str) -> None:
    emulator = a_stage()
    before = emulator.simulation.world
    with pytest.raises(ControlError, match=words):
        change_obstacle(emulator, wanted)
    assert emulator.simulation.world is before


def test_no_more_are_put_than_may_be() -> None:
    emulator = a_stage(allowed=2)
    with pytest.raises(ControlError, match="are 2 already"):
        change_obstacle(emulator, {"put": ONE})
    change_obstacle(emulator, {"corners": DISPLAYED, "by": [1, 0]})
