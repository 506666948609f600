"""Pictures as plain data: a golden one, what changed since, and that looking changes nothing."""

from __future__ import annotations

import json
from math import cos, degrees, pi, radians, remainder, sin, tan
from pathlib import Path
from typing import Any

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu.server.graphics import MAX_REMOVALS, Figure
from nserver_emu.server.handlers.runtime_settings import switch_noise
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import open_address
from nserver_emu.simulation.models import N200, SCOUT, RobotModel
from nserver_emu.simulation.noise import NOISY
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.viewer.scene import LASER_INTERVAL, MAX_NEW_POINTS, MAX_REVISIONS, SceneHistory
from tests.nserver_emu.server.wire_client import meet, simulation
from worlds.io import load_world
from worlds.world import StartPose

GOLDEN = Path(__file__).parent / "golden" / "picture.json"
# Parts that are sent only when they have changed.
CHANGING = {"bodies", "world", "traces", "beams", "lasers", "said"}
DRAWN = {"graphics", "drawn"}


def a_stage() -> Emulator:
    """A robot that has driven a little, an obstacle, a drawing, a word."""
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    client.ask("add_obstacle", 3, 500, 500, 600, 500, 600, 600)
    client.ask("draw_line", 0, 0, 100, 200, 3)
    client.ask("vm", 100, 200, 0)
    emulator.pass_time(0.5)
    client.ask("st")
    return emulator


def test_a_whole_picture_equals_the_golden_one() -> None:
    history = SceneHistory(a_stage())
    history.take()
    assert json.loads(json.dumps(history.since(0))) == json.loads(GOLDEN.read_text())


def test_the_golden_picture_says_what_the_wire_says() -> None:
    shown = json.loads(GOLDEN.read_text())["robots"]["1"]
    emulator = a_stage()
    client, _ = meet(emulator)
    slots = client.ask("gs").slots
    assert shown["state"] == [slots[slot] for slot in range(45)]
    truth = client.ask("sim_truth").values
    assert [round(1000 * number) for number in shown["actual"][:2]] == list(truth[2:4])


def test_beams_of_the_golden_picture_match_its_readings() -> None:
    golden = json.loads(GOLDEN.read_text())
    reached = 0
    for sonar, x, y, direction in golden["beams"]["1"]:
        steps = [(at, go) for at, go in ((x, cos(direction)), (y, sin(direction))) if abs(go) > 1e-9]
        # Oracle: distance to the nearer wall of the room (-12 to 102.17 in both directions), minus the ring's radius.
        wall_in = min(((-12.0 if go < 0 else 102.17) - at) / go - 9.06 for at, go in steps)
        if sonar == 2:  # the obstacle stands there
            assert golden["robots"]["1"]["state"][17 + sonar] < wall_in - 50
            continue
        # Readings are whole inches, at least 6.
        assert golden["robots"]["1"]["state"][17 + sonar] == pytest.approx(max(6.0, wall_in), abs=0.51)
        reached += 1
    assert reached == 15


def test_beams_are_sent_once_and_end_when_the_robot_is_placed() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    shown = {beam[0]: beam[1:] for beam in history.since(0)["beams"]["1"]}
    # 16 sonars, 22.5 deg apart: 0.3927 rad.
    assert shown[3] == pytest.approx([0, 0, 3 * 0.3926991], abs=1e-5)
    history.take()
    emulator.pass_time(1.0)
    history.take()
    assert "beams" not in history.since(1), "all sonars have emitted again from the same place"
    client.ask("vm", 100, 0, 200)
    emulator.pass_time(0.5)
    client.ask("st")
    # 255 first: an order without sonars, so that no beam is added until the end.
    client.ask("conf_sn", 15, 255, *[0] * 15)
    emulator.pass_time(0.5)
    history.take()
    picture = {beam[0]: beam[1:] for beam in history.since(3)["beams"]["1"]}
    # One ping in 60 ms: 9 in half a second, each from another place.
    assert len({x for x, _, _ in picture.values()}) == len(picture) == 9
    for sonar, (x, y, direction) in picture.items():  # 10 in/s, and 20 degrees a second of the turret
        expected_rad = sonar * 0.3926991 + radians(2 * x)
        assert (0.0 < x <= 5.0, y, direction) == (True, 0.0, pytest.approx(expected_rad, abs=2e-5))
    client.ask("place_robot", 500, 500, 0, 0)
    history.take()
    # A beam without numbers is removed: the robot was placed elsewhere.
    assert history.since(4)["beams"]["1"] == [[sonar] for sonar in range(16)]
    assert "beams" not in history.since(0)
    client.ask("conf_sn", 15, 5, 255, *[0] * 14)
    history.take()
    # The only sonar of the new order fires at once.
    assert history.since(5)["beams"] == {"1": [[5, 50.0, 50.0, pytest.approx(5 * 0.3926991, abs=1e-5)]]}
    assert history.since(0)["beams"] == history.since(5)["beams"]


def test_a_viewer_with_the_last_picture_gets_only_changes() -> None:
    emulator = a_stage()
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    history.take()
    assert not (CHANGING | DRAWN) & set(history.since(1))
    client.send("tk", codec.encode_tcp_request(Call("tk", ("hi",))))
    client.ask("new_world")
    client.ask("draw_line", 0, 0, 100, 200, 3)
    client.ask("create_robot", 2, 0)
    client.ask("vm", 100, 0, 0)
    emulator.pass_time(1.0)
    history.take()
    picture = history.since(2)
    assert CHANGING - {"lasers"} <= set(picture)
    assert (picture["frame"], picture["since"]) == (3, 2)
    assert picture["world"]["obstacles"] == []
    # Shape 1 was removed by drawing it again in XOR mode (3): the difference has no new one.
    assert picture["drawn"] == {"gone": [1], "come": []}
    assert "graphics" not in picture
    assert picture["said"] == [[0.5, 1, "hi"]]
    assert set(picture["bodies"]) == {"1", "2"}


def test_traces_continue_from_the_viewers_picture() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    first = history.since(0)["traces"]["1"]["actual"]
    # `gone` counts all points so far; the difference has only those that are new.
    assert first == {"gone": 1, "points": [0.0, 0.0]}
    client.ask("vm", 100, 0, 0)
    emulator.pass_time(0.5)
    history.take()
    more = history.since(1)["traces"]["1"]["actual"]
    assert len(more["points"]) == 2 * (more["gone"] - 1)
    whole = history.since(0)["traces"]["1"]["actual"]
    assert whole == {"gone": more["gone"], "points": first["points"] + more["points"]}


def test_a_fast_trace_is_thinned() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    client.ask("vm", 100, 300, 0)
    emulator.pass_time(20.0)
    history.take()
    more, whole = (history.since(number)["traces"]["1"]["actual"] for number in (1, 0))
    # 20 s at 10 in/s are 200 in: hundreds of points at half an inch.
    assert len(whole["points"]) == 2 * whole["gone"] > 4 * MAX_NEW_POINTS
    assert MAX_NEW_POINTS <= len(more["points"]) <= 2 * MAX_NEW_POINTS
    # The thinned points are a subset of the real ones.
    thinned = set(zip(whole["points"][::2], whole["points"][1::2], strict=True))
    assert thinned >= set(zip(more["points"][::2], more["points"][1::2], strict=True))


# Never taken, too old, or from the future: the viewer gets everything.
@pytest.mark.parametrize("number", [-1, 0, 1, 2, MAX_REVISIONS + 10, 10**9])
def test_a_viewer_with_an_unknown_picture_gets_everything(number: int) -> None:
    history = SceneHistory(a_stage())
    for _ in range(MAX_REVISIONS + 2):
        history.take()
    picture = history.since(number)
    assert picture["since"] == 0
    assert set(picture) >= CHANGING | {"graphics"}
    assert "drawn" not in picture


def test_drawings_continue_from_the_viewers_picture() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    shapes: list[Any] = []
    for number in range(40):
        # Mode 3 and 4 are XOR colours: a line drawn twice is removed again.
        client.ask("draw_line", 0, 0, number % 17, 0, 3 + number % 2)
        client.ask("draw_line", number, 1, 1, 1, 1)
        if number % 3:
            continue
        history.take()
        change = history.since(history.number - 1)["drawn"]
        # What a page does: remove what is gone, add what has come. The result must equal the whole list.
        shapes = [shape for shape in shapes if shape[0] not in change["gone"]] + change["come"]
        assert shapes == history.since(0)["graphics"]
        assert len(change["come"]) <= 6


@pytest.mark.long
def test_changes_after_a_picture_come_once_with_the_next() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    shapes: list[Any] = []
    points: list[Any] = history.since(0)["traces"]["1"]["actual"]["points"]
    client.ask("vm", 100, 100, 0)
    for number in range(30):
        client.ask("draw_line", 0, 0, number % 5, 0, 3 + number % 3)
        history.take()
        emulator.pass_time(0.2)
        # Drawn after the picture was taken: it belongs to the next one.
        client.ask("draw_line", 0, 0, number % 4, 0, 3 + number % 3)
        picture = history.since(history.number - 1)
        shapes = [shape for shape in shapes if shape[0] not in picture["drawn"]["gone"]] + picture["drawn"]["come"]
        points += picture.get("traces", {"1": {"actual": {"points": []}}})["1"]["actual"]["points"]
    history.take()
    picture = history.since(history.number - 1)
    shapes = [shape for shape in shapes if shape[0] not in picture["drawn"]["gone"]] + picture["drawn"]["come"]
    whole = history.since(0)
    assert shapes == whole["graphics"]
    assert points + picture["traces"]["1"]["actual"]["points"] == whole["traces"]["1"]["actual"]["points"]


def test_a_viewer_far_behind_gets_all_drawings_again() -> None:
    emulator = Emulator(simulation())
    history = SceneHistory(emulator)
    history.take()
    # More removals than the graphics remember; an even number of XOR lines leaves nothing.
    for _ in range(2 * MAX_REMOVALS + 2):
        emulator.graphics.draw(Figure.LINE, (0, 0, 9, 9), 4)
    history.take()
    assert history.since(1)["graphics"] == []


@pytest.mark.long
def test_where_a_robot_was_put_down_its_track_begins_anew() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    history = SceneHistory(emulator)
    history.take()
    client.ask("place_robot", 500, 500, 0, 0)
    emulator.pass_time(0.05)
    history.take()
    # None separates two tracks: the page draws no line between them.
    assert history.since(1)["traces"]["1"]["actual"]["points"] == [None, None, 50.0, 50.0]
    client.ask("dp", 0, 0)
    client.ask("vm", 100, 0, 0)
    emulator.pass_time(30.0)
    history.take()
    more = history.since(2)["traces"]["1"]
    assert None not in more["actual"]["points"]
    # dp moves the encoders' track only.
    assert more["encoder"]["points"][:3] == [None, None, pytest.approx(0.0, abs=1.1)]
    assert history.since(0)["traces"]["1"]["actual"]["points"][:5] == [0.0, 0.0, None, None, 50.0]


@pytest.mark.long
@pytest.mark.parametrize("model", [N200, SCOUT])
def test_touching_bumpers_are_drawn_at_the_wall(model: RobotModel) -> None:
    sim = Simulation(load_world("thesis_room"), seed=3)
    sim.add_robot(1, StartPose(80.0, 40.0, 0.3), model, NOISY)
    emulator = Emulator(sim)
    client, _ = meet(emulator)
    # The body turns for a minute, so that its heading is off by noise; the front of the drawing must follow.
    client.ask("vm", *((0, 450, 450) if model is N200 else (50, -50, 0)))
    emulator.pass_time(60.0)
    history = SceneHistory(emulator)
    history.take()
    heading = history.since(0)["robots"]["1"]["actual"][2]
    client.ask("vm", 0, 0, 0)
    # Steer back to the direction of the x axis and drive against the wall.
    left = round(-degrees(heading) * 10) % 3600
    if model is N200:
        client.ask("pr", 0, left, 0)
        emulator.pass_time(15.0)
        client.ask("vm", 100, 0, 0)
    else:
        client.ask("vm", 100, 100, 0)
    emulator.pass_time(20.0)
    history.take()
    shown = history.since(0)["robots"]["1"]
    x, y = shown["actual"][:2]
    radius = model.body.radius_in
    # Distances to the four walls by direction.
    walls = {0.0: 102.17 - x, pi / 2: 102.17 - y, pi: x + 12.0, -pi / 2: y + 12.0}
    touched = [direction for direction, far in walls.items() if far < radius + 0.01]
    half = pi / len(model.body.bumper_angles_rad)
    hit = [k for k in range(20) if shown["state"][33] >> k & 1]
    assert touched
    assert hit
    for k in hit:
        # Bumper k points to `front` plus k sectors; it must be within half a sector of a touched wall.
        direction = shown["front"] + 2 * half * k
        assert any(abs(remainder(direction - wall, 2 * pi)) <= half + 1e-4 for wall in touched)


def test_a_change_of_noise_is_sent() -> None:
    emulator = Emulator(simulation())
    history = SceneHistory(emulator)
    history.take()
    switch_noise(emulator, {"sensors": "measured"})
    history.take()
    body = history.since(1)["bodies"]["1"]
    assert body["noise"] == {"sensors": "measured", "motion": "ideal"}
    assert body["noises"]["sensors"] == ["ideal", "noisy", "measured", "building"]


def test_the_laser_is_measured_at_intervals_and_on_demand() -> None:
    sim = Simulation(load_world("thesis_room"))
    sim.add_robot(1, StartPose(0.0, 0.0), N200)
    emulator = Emulator(sim)
    history = SceneHistory(emulator)
    for _ in range(LASER_INTERVAL):
        history.take()
    # No page watches a laser: it is not measured.
    assert history.since(0)["lasers"] == {}
    for _ in range(LASER_INTERVAL):
        history.take(lasers=None)
    seen = history.since(0)["lasers"]["1"]
    assert "lasers" in history.since(LASER_INTERVAL)
    # Oracle: the points that a client gets, in tenths.
    wire = meet(emulator)[0].ask("get_ls").laser
    assert wire is not None
    assert seen == pytest.approx([number / 10 for number in wire[1:]], abs=0.11)


def test_laser_points_stay_on_the_wall_while_the_robot_turns() -> None:
    sim = Simulation(load_world("thesis_room"))
    sim.add_robot(1, StartPose(40.0, 30.0, 0.0, 0.2), N200)
    emulator = Emulator(sim)
    history = SceneHistory(emulator)
    for _ in range(LASER_INTERVAL):
        history.take(lasers=None)
    meet(emulator)[0].ask("vm", 0, 0, 450)
    emulator.pass_time(0.2)
    history.take(lasers=None)
    picture = history.since(0)
    assert picture["robots"]["1"]["actual"][3] > 0.3
    xs, ys = picture["lasers"]["1"][::2], picture["lasers"]["1"][1::2]
    assert set(xs) == {102.2}
    # The middle of the field of view meets the wall at y + distance x tan(turret).
    middle = 30.0 + 62.17 * tan(0.2)
    assert min(ys) < middle < max(ys)
    assert len(ys) > 400


@pytest.mark.long
def test_looking_changes_nothing_that_comes_later() -> None:
    looked, alone = (Emulator(simulation(noisy=True, seed=5)) for _ in range(2))
    history = SceneHistory(looked)
    clients = [meet(emulator)[0] for emulator in (looked, alone)]
    for client in clients:
        client.ask("vm", 80, 200, 100)
    for _ in range(20):
        for emulator in (looked, alone):
            emulator.pass_time(0.13)
        history.take(lasers=None)
        history.since(0)
    first, second = (client.ask("gs") for client in clients)
    assert first == second
    assert looked.traces.to_state() == alone.traces.to_state()


@pytest.mark.parametrize(("name", "half_cone_deg", "count"), [("corridor8", 15.0, 8), ("ring24", 12.5, 24)])
def test_rings_of_model_files_are_shown(name: str, half_cone_deg: float, count: int) -> None:
    models = Path(__file__).parents[2] / "worlds" / "models"
    emulator = open_address(f"sim:thesis_room?robot={name}&model_file={models / name}.toml").emulator
    history = SceneHistory(emulator)
    history.take()
    picture = json.loads(json.dumps(history.since(0)))
    ring, sonar = picture["bodies"]["1"]["sonars"], emulator.simulation.robots[1].sonar
    assert ring["half_cone"] == pytest.approx(radians(half_cone_deg), abs=1e-5)
    assert len(ring["angles"]) == len(picture["beams"]["1"]) == count
    assert picture["robots"]["1"]["sonars"] == pytest.approx(sonar.readings_in, abs=1e-3)


@pytest.mark.parametrize("name", ["corridor8", "ring24"])
def test_readings_without_echo_equal_that_of_the_ring(name: str) -> None:
    models = Path(__file__).parents[2] / "worlds" / "models"
    emulator = open_address(f"sim:hall?robot={name}&model_file={models / name}.toml").emulator
    history = SceneHistory(emulator)
    history.take()
    picture = json.loads(json.dumps(history.since(0)))
    readings, ring = emulator.simulation.robots[1].sonar.readings_in, emulator.simulation.robots[1].model.body.ring
    shown = picture["robots"]["1"]["sonars"]
    assert ring.no_echo_in in readings
    no_echo_in = picture["bodies"]["1"]["sonars"]["no_echo_in"]
    assert [reading == no_echo_in for reading in shown] == [reading == ring.no_echo_in for reading in readings]


def test_the_cone_is_that_of_the_setup_in_force() -> None:
    emulator = open_address("sim:thesis_room?setup=measured").emulator
    history = SceneHistory(emulator)
    history.take()
    assert history.since(0)["bodies"]["1"]["sonars"]["half_cone"] == pytest.approx(radians(12.5), abs=1e-5)
    assert "sonars" not in history.since(0)["robots"]["1"]
