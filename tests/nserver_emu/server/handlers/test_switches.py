"""Noise and world changed while it runs: visible to clients, saved in snapshots, repeatable."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nclient.errors import ControlError, WorldFileError
from nserver_emu.control import snapshot
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.handlers.runtime_settings import (
    MAX_EXPORTED_WORLDS,
    change_wall,
    noise_of,
    noise_words,
    put_world,
    show_world,
    switch_noise,
)
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import N150
from nserver_emu.simulation.noise import IDEAL, SETUPS
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.io import format_world, load_world
from worlds.world import Path as WayPoints
from worlds.world import Polygon, StartPose, SurfaceSpot, WallAccuracy, World


def sonars(client: WireClient) -> tuple[int, ...]:
    slots = client.ask("gs").slots
    return tuple(slots[slot] for slot in range(17, 33))


def readings(emulator: Emulator, client: WireClient, looks: int = 6) -> set[tuple[int, ...]]:
    """Return a client's sonar readings, a whole ring apart."""
    found = set()
    for _ in range(looks):
        emulator.pass_time(1.0)
        found.add(sonars(client))
    return found


def test_noise_changes_take_effect_for_clients() -> None:
    emulator = Emulator(simulation(seed=4))
    client, _ = meet(emulator)
    # Without noise all readings at rest are equal.
    (exact,) = readings(emulator, client)
    assert switch_noise(emulator, {"sensors": "noisy", "robot": 1}) == {"1": {"sensors": "noisy", "motion": "ideal"}}
    # The readings themselves change with the next ping, not with the switch.
    assert sonars(client) == exact
    assert len(readings(emulator, client)) == 6
    assert switch_noise(emulator, {"sensors": "ideal"})["1"]["sensors"] == "ideal"
    emulator.pass_time(1.0)
    assert readings(emulator, client) == {exact}


@pytest.mark.long
def test_odometry_strays_robot_by_robot() -> None:
    emulator = Emulator(
        SimulationConfig(others=(("n150", StartPose(70.0, 70.0)),), start=StartPose(20.0, 20.0)).simulation()
    )
    # Only robot 2 gets noise; both drive the same path.
    switch_noise(emulator, {"motion": "noisy", "robot": 2})
    for number in (1, 2):
        client, _ = meet(emulator)
        client.ask("connect_robot", number, 0)
        client.ask("pr", 200, 900, 0)
    emulator.pass_time(20.0)
    one, two = emulator.simulation.robots.values()
    assert one.actual == one.encoder
    assert two.actual != two.encoder
    assert noise_of(one) == {"sensors": "ideal", "motion": "ideal"}
    assert noise_of(two) == {"sensors": "ideal", "motion": "noisy"}


def a_run(switches: dict[int, dict[str, Any]], saved: Path | None = None) -> list[object]:
    """The replies to a client over twenty seconds, noise switched meanwhile; at half of it saved and restored."""
    setting = SimulationConfig(robot="n200", seed=8, start=StartPose(40.0, 40.0))
    emulator = Emulator(setting.simulation())
    client, _ = meet(emulator)
    client.ask("pr", 200, 900, 300)
    replies: list[object] = []
    for second in range(20):
        if second in switches:
            switch_noise(emulator, switches[second])
        # The snapshot is restored into an emulator of other settings, which must not matter.
        if second == 10 and saved is not None:
            snapshot.save(emulator, saved)
            emulator = Emulator(SimulationConfig().simulation())
            snapshot.restore(emulator, saved)
            client, _ = meet(emulator)
        emulator.pass_time(1.0)
        replies += [client.ask("gs"), client.ask("sim_truth").values]
    return replies


SWITCHES: dict[int, dict[str, Any]] = {
    3: {"sensors": "measured"}, 6: {"motion": "noisy", "robot": 1}, 14: {"sensors": "noisy"},
}  # fmt: skip


@pytest.mark.long
def test_the_same_changes_give_the_same_bytes() -> None:
    assert a_run(SWITCHES) == a_run(SWITCHES)
    # Another switch changes only the last replies, and that must be visible.
    assert a_run(SWITCHES) != a_run(SWITCHES | {15: {"sensors": "ideal"}})
    assert a_run(SWITCHES) != a_run({})


@pytest.mark.long
def test_a_snapshot_keeps_what_was_switched(tmp_path: Path) -> None:
    assert a_run(SWITCHES, tmp_path / "saved.json") == a_run(SWITCHES)


@pytest.mark.parametrize(
    ("wanted", "error"),
    [
        ({"sensors": "loud"}, "sensors is one of ideal, noisy, measured, building, not loud"),
        ({"motion": 3}, "motion is one of ideal, noisy, worn, not 3"),
        # A near miss is suggested.
        ({"motion": "nosy"}, "noisy"),
        ({"sensors": "noisy", "robot": 7}, "no robot 7; there are 1"),
        ({"sensors": "noisy", "robot": "1"}, "no robot 1"),
        ({"sensors": "noisy", "turret": "x"}, "not 'turret'"),
        ({"robot": 1}, "both omitted"),
    ],
)  # fmt: skip
def test_what_is_no_noise_is_refused_with_what_is(wanted: dict[str, Any], error: str) -> None:
    emulator = Emulator(simulation())
    with pytest.raises(ControlError, match=error):
        switch_noise(emulator, wanted)
    assert emulator.simulation.robots[1].setup == IDEAL


def test_noise_in_words() -> None:
    assert noise_words("robot=2 sensors=measured") == {"robot": 2, "sensors": "measured"}
    for text in ("", "sensors", "sensors=", "robot=1 noisy"):
        with pytest.raises(ControlError, match="such as sensors=measured"):
            noise_words(text)
    assert "measured" in SETUPS


def test_another_world_takes_the_place_of_the_one_there() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    before = sonars(client)
    put_world(emulator, format_world(load_world("several_walls")), "mine.toml")
    emulator.pass_time(1.0)
    assert emulator.simulation.world.name == "several_walls"
    assert sonars(client) != before


def test_an_invalid_world_changes_nothing() -> None:
    emulator = Emulator(simulation())
    world = emulator.simulation.world
    with pytest.raises(ControlError, match=r"far\.toml: .*robot 1"):
        put_world(emulator, "[[room]]\ncorners_in = [[500, 0], [600, 0], [600, 100]]\n", "far.toml")
    with pytest.raises(WorldFileError, match=r"bad\.toml: .*no TOML"):
        put_world(emulator, "[[room", "bad.toml")
    assert emulator.simulation.world is world


def test_robots_without_room_are_placed_at_starts() -> None:
    emulator = Emulator(simulation())
    emulator.simulation.add_robot(2, StartPose(40.0, 0.0), N150, IDEAL)
    arena = load_world("arena")
    # `places`: robots without room are put at the starts of the new world.
    assert put_world(emulator, format_world(arena), "arena.toml", places=True).starts == arena.starts
    for number, robot in emulator.simulation.robots.items():
        emulator.simulation.require_free(*robot.disc, number)
    # A world with a single start has no room for the second robot, and nothing changes.
    far = "[[room]]\ncorners_in = [[500, 500], [600, 500], [600, 600], [500, 600]]\n[[start]]\nx_in = 550\ny_in = 550"
    with pytest.raises(ControlError, match="no start of this world is free for robot 2"):
        put_world(emulator, far, "far.toml", places=True)
    assert emulator.simulation.world.name == arena.name


# Coordinates that tenths and even a text of three decimals cannot express.
TWELVE = tuple(
    (60.123456789 + 9 * math.cos(k * math.tau / 12), 50.1 + 9 * math.sin(k * math.tau / 12)) for k in range(12)
)
ROOM = Polygon(((-30.0, -30.0), (120.0, -30.0), (120.0, 120.0), (-30.0, 120.0)), "hall")


def a_world() -> World:
    """More than the wire can say: twelve corners, names, tenths of tenths, a start that something stands on, a path."""
    things = (Polygon(TWELVE, "pillar"), Polygon(((20.25, 80.0), (30.1, 80.0), (30.1, 90.0)), "table"))
    starts = (StartPose(0.0, 0.0, 0.1, 0.2), StartPose(60.0, 50.0, 1 / 3, 2 / 3))
    paths = {"round": WayPoints("round", "5.1", starts[1], ((60.0, 50.0), (5.0, 5.0)))}
    return World("w", "t", (ROOM,), obstacles=things, starts=starts, paths=paths)


def test_a_world_that_was_shown_comes_back_as_the_very_same() -> None:
    emulator = Emulator(simulation())
    world = a_world()
    # 1. Two worlds are exported as text: this one, and the one without obstacles.
    emulator.simulation.change_world(world)
    before = show_world(emulator)
    meet(emulator)[0].ask("new_world")
    emptied = emulator.simulation.world
    after = show_world(emulator)
    # 2. After a third world each text restores the very object, although the text cannot express it all.
    put_world(emulator, "[[room]]\ncorners_in = [[-50, -50], [90, -50], [90, 90], [-50, 90]]", "other.toml")
    assert put_world(emulator, before, "before") is world
    assert emulator.simulation.world is world
    assert put_world(emulator, after, "after") is emptied
    # 3. An edited text is parsed, and is another world.
    assert put_world(emulator, before + "# edited", "edited.toml") is not world


def test_exported_worlds_are_limited_to_the_undo_steps() -> None:
    emulator = Emulator(simulation())
    first = emulator.simulation.world
    text = show_world(emulator)
    # Exactly as many further worlds as are remembered: the first one is dropped.
    for k in range(MAX_EXPORTED_WORLDS):
        emulator.simulation.change_world(World(f"w{k}", "", (ROOM,)))
        show_world(emulator)
    assert len(emulator.exported_worlds) == MAX_EXPORTED_WORLDS
    assert put_world(emulator, text, "first") is not first


def test_inner_walls_are_added_moved_and_removed() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    before, rows = sonars(client), len(emulator.simulation.world.inner_walls)
    assert change_wall(emulator, {"put": [[40, -9], [40, 9]]}) == {
        "walls": rows + 1, "was": None, "is": [[40, -9], [40, 9]],
    }  # fmt: skip
    emulator.pass_time(1.0)
    assert sonars(client)[0] < before[0]
    # A wall is found by its ends; a name is stripped of spaces.
    named = change_wall(emulator, {"wall": [[40, -9], [40, 9]], "to": [[40, -9], [40, 9]], "name": " gate "})
    assert "name" not in named
    moved = change_wall(emulator, {"wall": [[40, -9], [40, 9]], "by": [5, 1]})
    assert moved["name"] == "gate"
    assert (moved["was"], moved["is"]) == ([[40, -9], [40, 9]], [[45, -8], [45, 10]])
    # "to" replaces the ends; without "to" and "by" the wall is removed.
    change_wall(emulator, {"wall": moved["is"], "to": [[50, 0], [60, 0]]})
    assert change_wall(emulator, {"wall": [[50, 0], [60, 0]]})["walls"] == rows
    emulator.pass_time(1.0)
    assert sonars(client) == before


@pytest.mark.parametrize(
    ("change", "words"),
    [({"put": [[-5, -5], [5, 5]]}, "touch robot 1"), ({"put": [[40, 0], [40, 0.1]]}, "at least"),
     ({"put": [[40, 0]]}, "two ends"), ({"put": [[40, 0], [1e9, 0]]}, "on the map"), ({"put": 7}, "such as"),
     ({"wall": [[1, 2], [3, 4]]}, "no inner wall"), ({}, "such as")],
)  # fmt: skip
def test_wrong_wall_changes_nothing(change: dict[str, Any], words: str) -> None:
    emulator = Emulator(simulation())
    world = emulator.simulation.world
    with pytest.raises(ControlError, match=words):
        change_wall(emulator, change)
    assert emulator.simulation.world is world


def test_measured_walls_keep_their_accuracy() -> None:
    known = WallAccuracy(0.1, 0.01, 20.0)
    rows = np.array([[0, 0, 9, 0], [0, 5, 9, 5], [0, 9, 9, 9]])
    world = World("w", inner_walls=rows, accuracies={0: known, 2: known})
    # Rows behind a removed wall move up, and their accuracies with them.
    assert world.with_inner_wall(1).accuracies == {0: known, 1: known}
    assert world.with_inner_wall(2, (1, 1, 2, 2)).accuracies == {0: known}
    assert world.with_inner_wall(3, (1, 1, 2, 2)).accuracies == world.accuracies


@pytest.mark.parametrize(("to", "is_measured"), [([[40, -20], [40, 9]], True), ([[40, -9], [41, 9]], False)])
def test_wall_that_becomes_longer_keeps_its_accuracy(to: list[list[float]], is_measured: bool) -> None:
    emulator = Emulator(simulation())
    # Collinear and longer: where the wall is was measured. Turned: it was not.
    row = len(emulator.simulation.world.inner_walls)
    change_wall(emulator, {"put": [[40, -9], [40, 9]]})
    measured = WallAccuracy(0.1, 0.01, 15.0)
    emulator.simulation.change_world(replace(emulator.simulation.world, accuracies={row: measured}))
    change_wall(emulator, {"wall": [[40, -9], [40, 9]], "to": to})
    assert (emulator.simulation.world.accuracies == {row: measured}) is is_measured


def test_wall_that_becomes_shorter_keeps_the_spots_beside_it() -> None:
    emulator = Emulator(simulation())
    row = len(emulator.simulation.world.inner_walls)
    change_wall(emulator, {"put": [[40, -9], [40, 9]]})
    spots = tuple(SurfaceSpot(41.0, y, 0.2) for y in (-8.0, -4.0, 4.0, 8.0))
    measured = WallAccuracy(0.1, 0.01, 15.0, spots)
    emulator.simulation.change_world(replace(emulator.simulation.world, accuracies={row: measured}))
    change_wall(emulator, {"wall": [[40, -9], [40, 9]], "to": [[40, -9], [40, 3]]})
    assert emulator.simulation.world.accuracies == {row: measured._replace(surface=spots[:3])}


@pytest.mark.parametrize("change", [{}, {"by": [5, 1]}])
def test_undo_restores_the_accuracy_of_a_wall(change: dict[str, Any]) -> None:
    emulator = Emulator(simulation())
    wall, surface = [[40, -9], [40, 9]], [SurfaceSpot(41.0, 2.0, 0.2)]
    measured = [0.1, 0.01, 15.0, surface]
    rows = change_wall(emulator, {"put": wall, "accuracy": measured})["walls"]
    done = change_wall(emulator, {"wall": wall, **change})
    assert emulator.simulation.world.accuracies == {}
    # The reply of a change has what undoes it: "to" for a moved wall, "put" for a removed one.
    undo = {"wall": done["is"], "to": done["was"]} if change else {"put": done["was"]}
    change_wall(emulator, undo | {"accuracy": done["accuracy"]})
    assert emulator.simulation.world.accuracies == {rows - 1: WallAccuracy(0.1, 0.01, 15.0, tuple(surface))}
    for wrong in ([0.1], [0.1, -1, 5], "abc", [0.1, 0.1, 5, [[1, 2]]], [0.1, 0.1, 5, [[1, 2, -1]]]):
        with pytest.raises(ControlError, match="such as"):
            change_wall(emulator, {"put": [[60, -9], [60, 9]], "accuracy": wrong})
