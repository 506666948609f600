"""A saved simulation goes on bit for bit, and a stranger's file can do nothing but be refused."""

from __future__ import annotations

import json
import struct
import sys
import tracemalloc
from array import array
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest

from nclient.errors import SnapshotError
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from nserver_emu.persistence import snapshot
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.graphics import MAX_POINTS, Figure
from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.world import StartPose

pytestmark = pytest.mark.long

BOX = (4, 400, -100, 600, -100, 600, 100, 400, 100)


def busy() -> tuple[Emulator, WireClient]:
    """A noisy robot amid a motion, with sonars under way, an obstacle, drawings and words."""
    emulator = Emulator(simulation(noisy=True, seed=5))
    client, _ = meet(emulator)
    client.ask("add_obstacle", *BOX)
    client.ask("draw_robot", 1, 2, 3, 4, 2)
    client.ask("refresh_all")
    client.send("tk", codec.encode_tcp_request(Call("tk", ("hello",))))
    client.ask("conf_tm", 4)
    client.ask("create_robot", 2, 1)
    client.ask("vm", 20, 100, 0)
    client.ask("connect_robot", 1, 1)
    client.ask("dp", 100, 200)
    client.ask("pr", 250, 900, -450)
    emulator.simulation.step(1.2345)
    return emulator, client


def future(emulator: Emulator, client: WireClient) -> list[object]:
    """What a client hears for a while."""
    heard: list[object] = []
    for _ in range(60):
        emulator.simulation.step(0.1)
        heard += [client.ask("gs"), client.ask("sim_truth").values]
    heard += [client.ask("vm", 50, -100, 30), client.ask("get_rpx").values]
    for _ in range(20):
        emulator.simulation.step(0.07)
        heard.append(client.ask("gs"))
    return heard


def test_a_restored_simulation_goes_on_bit_for_bit(tmp_path: Path) -> None:
    emulator, client = busy()
    snapshot.save(emulator, tmp_path / "saved.json")
    restored = Emulator(simulation())
    snapshot.restore(restored, tmp_path / "saved.json")
    assert restored.simulation.time_s == emulator.simulation.time_s
    assert restored.graphics.shapes == emulator.graphics.shapes
    pings = emulator.simulation.robots[1].sonar.pings
    assert restored.simulation.robots[1].sonar.pings == pings
    assert len({ping.x_in for ping in pings if ping}) >= 3
    assert restored.graphics.redrawn == emulator.graphics.redrawn
    assert restored.transcript.utterances == emulator.transcript.utterances
    assert snapshot.dumps(restored) == snapshot.dumps(emulator)
    again, _ = meet(restored)
    assert future(restored, again) == future(emulator, client)
    assert again.ask("delete_obstacle", *BOX).kind == "simple"
    assert [path.name for path in tmp_path.iterdir()] == ["saved.json"]


def test_days_of_driving_and_drawing_are_saved_in_little_memory() -> None:
    """What a save takes and lets go stays with the process: it would look like a leak, for as long as tracks fill."""
    emulator = Emulator(simulation())
    emulator.pass_time(0.1)
    for trace in (emulator.traces.actual[1], emulator.traces.encoder[1]):
        for number in range(MAX_POINTS):
            trace.add(number + 1 / 3, 0.1 * number)
    for number in range(2000):
        emulator.graphics.draw(Figure.LINE, (number, 1000, 2000, 3000), 1)
    tracemalloc.start()
    try:
        text = snapshot.dumps(emulator)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 5 * len(text)
    restored = Emulator(simulation())
    snapshot.loads(restored, text)
    assert restored.traces.actual[1].points == emulator.traces.actual[1].points
    assert restored.graphics.numbered == emulator.graphics.numbered


def test_tracks_are_kept_alike_by_machines_of_either_byte_order(monkeypatch: pytest.MonkeyPatch) -> None:
    def saved() -> str:
        text: str = next(o["of"] for o in json.loads(snapshot.dumps(emulator))["objects"] if o["is"] == "doubles")
        return text

    emulator = Emulator(simulation())
    emulator.pass_time(0.1)
    x_in, y_in = emulator.traces.actual[1].points[0]
    assert b64decode(saved()) == struct.pack("<2d", x_in, y_in)
    monkeypatch.setattr(sys, "byteorder", "big")
    whole = snapshot.dumps(emulator)
    assert b64decode(saved()) == struct.pack(">2d", x_in, y_in), "turned round from what this machine has"
    restored = Emulator(simulation())
    snapshot.loads(restored, whole)
    assert restored.traces.actual[1].points == [(x_in, y_in)]


@pytest.mark.parametrize("setup", ["ideal", "noisy", "measured", "worn"])
def test_three_models_with_all_their_senses_and_an_arm_go_on_bit_for_bit(setup: str) -> None:
    others = (("n200", StartPose(70.0, 70.0, 1.0)), ("scout", StartPose(75.0, 25.0, 2.0)))
    setting = SimulationConfig(start=StartPose(20.0, 20.0, 0.5), seed=6, setup=setup, others=others)

    def clients(emulator: Emulator) -> list[WireClient]:
        met = [meet(emulator)[0] for _ in range(3)]
        for robot_id, client in enumerate(met, start=1):
            client.ask("connect_robot", robot_id, 1)
        return met

    def heard(emulator: Emulator, clients: list[WireClient]) -> list[object]:
        replies: list[object] = []
        for number in range(12):
            emulator.pass_time(0.23)
            for robot_id, client in enumerate(clients, start=1):
                names = ("gs", "get_cp", "get_ir", "get_sn", "get_ls", "get_bp", "sim_truth")
                replies += [client.ask(name) for name in names] + [emulator.layers(robot_id)]
            if number == 6:
                clients[2].ask("vm", -80, 50, 0)
            arm = emulator.arms[2]
            replies += [arm.lift.position_in, arm.grip.position_in, arm.is_still()]
        return replies

    emulator = Emulator(setting.simulation())
    first = clients(emulator)
    for client in first:
        client.ask("ct", *EVERYTHING.with_position(31).smask)
        client.ask("vm", 70, 60, 50)
        client.ask("conf_sn", 2, *range(16))
        client.ask("conf_ir", 4, *range(16))
        client.ask("conf_tm", 2)
    first[1].ask("conf_cp", 2)
    first[1].ask("arm_mv", 2, 1000, 1, 50)
    emulator.pass_time(1.37)
    restored = Emulator(SimulationConfig().simulation())
    snapshot.loads(restored, snapshot.dumps(emulator))
    again = clients(restored)
    for client in again:
        client.ask("ct", *EVERYTHING.with_position(31).smask)
    for client in first:
        client.ask("gs")
    assert heard(restored, again) == heard(emulator, first)
    assert snapshot.dumps(restored) == snapshot.dumps(emulator)


def test_saving_changes_nothing() -> None:
    (one, client), (other, watched) = busy(), busy()
    for _ in range(3):
        snapshot.dumps(other)
    assert future(one, client) == future(other, watched)


def test_a_file_that_cannot_be_written_or_read_says_so(tmp_path: Path) -> None:
    emulator, _ = busy()
    with pytest.raises(SnapshotError, match=r"nowhere.*cannot be written"):
        snapshot.save(emulator, tmp_path / "nowhere" / "saved.json")
    with pytest.raises(SnapshotError, match=r"nothing.json: cannot be read"):
        snapshot.restore(emulator, tmp_path / "nothing.json")


def test_what_is_too_long_to_be_a_snapshot_is_neither_read_nor_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, path = Emulator(simulation()), tmp_path / "saved.json"
    length = len(snapshot.dumps(emulator))
    monkeypatch.setattr(snapshot, "SNAPSHOT_BYTES", length)
    snapshot.save(emulator, path)
    snapshot.restore(emulator, path)
    monkeypatch.setattr(snapshot, "SNAPSHOT_BYTES", length - 1)
    with pytest.raises(SnapshotError, match=rf"saved\.json: is longer than {length - 1} bytes"):
        snapshot.restore(emulator, path)
    emulator.simulation.step(0.1)
    before = path.read_text()
    with pytest.raises(SnapshotError, match=r"saved\.json: cannot be written: \d+ bytes.*lower --limit-graphics or"):
        snapshot.save(emulator, path)
    assert path.read_text() == before
    assert [each.name for each in tmp_path.iterdir()] == ["saved.json"]


def refused(text: str, match: str) -> None:
    emulator, client = busy()
    before = client.ask("gs")
    with pytest.raises(SnapshotError, match=match):
        snapshot.loads(emulator, text)
    assert client.ask("gs") == before


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is no snapshot"),
        ("[]", "is no snapshot"),
        ('{"nomad_recording": 1}\n{"out": "00"}\n', "is no snapshot"),
        ('name = "a world"\n', "is no snapshot"),
        ('{"as": "nserver snapshot"}', "is no snapshot"),
        ('{"format": "nserver snapshot", "version": "0.', "is damaged"),
        ('{"format": "nserver snapshot", "version": "0.0"}', "version 0.0"),
        ('{"format": "nserver snapshot", "root": ' + "[" * 100_000, "is damaged"),
    ],
)
def test_what_is_no_snapshot_is_refused(text: str, match: str) -> None:
    refused(text, match)


@pytest.mark.parametrize(
    ("first_object", "match"),
    [
        ({"is": "os:system", "of": {}}, "no snapshot may hold"),
        ({"is": "class", "of": "subprocess:Popen"}, "no snapshot may hold"),
        ({"is": "nserver_emu.simulation.simulation:World", "of": {}}, "no snapshot may hold"),
        ({"is": "nserver_emu.server.daemon:Daemon", "of": {}}, "no snapshot may hold"),
        ({"is": "nserver_emu.simulation.simulation:Simulation", "of": {"step": 1}}, "no attribute 'step'"),
        ({"is": "nserver_emu.simulation.simulation:Simulation", "of": {"__class__": 1}}, "no attribute '__class__'"),
        ({"is": "dict", "of": []}, "is damaged: KeyError"),
        ({"is": "dict", "of": [["simulation", 1], ["graphics", 1], ["transcript", 1], ["arms", 1]]}, "simulation is"),
        ({"is": "list", "of": [{"ref": 0}]}, "nested too deeply"),
        ({"is": "list", "of": [[1]]}, "a value that is none"),
        *(({"is": "array", "dtype": kind, "shape": [1], "locked": False, "of": [1]}, "no numbers")
          for kind in ("O", "<c16", "<f8,<f8", "<f8," + "9" * 5000 + "<f8", "", None)),
        ({"is": "array", "dtype": ["<f8"], "shape": [1], "locked": False, "of": [1]}, "is damaged: TypeError"),
    ],
)  # fmt: skip
def test_a_strangers_snapshot_is_refused(first_object: dict[str, object], match: str) -> None:
    whole = json.loads(snapshot.dumps(busy()[0]))
    refused(json.dumps(whole | {"root": {"ref": 0}, "objects": [first_object]}), match)


def test_what_the_rooms_do_not_know_is_not_kept() -> None:
    emulator, _ = busy()
    emulator.graphics.redrawn = json.JSONDecoder()  # type: ignore[assignment]
    with pytest.raises(SnapshotError, match="no snapshot may hold"):
        snapshot.dumps(emulator)


@pytest.mark.parametrize(("kept", "kind"), [(array("i"), "'i'"), (np.zeros(2, np.complex128), "complex128")])
def test_an_array_of_other_numbers_is_not_kept(kept: object, kind: str) -> None:
    emulator, _ = busy()
    emulator.graphics.redrawn = kept  # type: ignore[assignment]
    with pytest.raises(SnapshotError, match=f"cannot keep an array of {kind}"):
        snapshot.dumps(emulator)


def test_a_robot_that_lacks_a_part_is_found_out() -> None:
    whole = json.loads(snapshot.dumps(busy()[0]))
    for thing in whole["objects"]:
        if thing["is"].endswith(":SimulatedRobot"):
            del thing["of"]["_drive"]
    refused(json.dumps(whole), "is damaged: AttributeError")
