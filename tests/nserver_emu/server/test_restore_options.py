"""Options that go with --restore and --replay, and the speed of a restored simulation."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient import connect
from nclient.errors import SnapshotError
from nserver_emu import cli
from nserver_emu.control import snapshot
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import SimulationClock
from tests.nserver_emu.server.wire_client import meet, simulation

# Differs from the default in two fields, so that a restored clock is recognised.
SAVED_PACE = SimulationClock(factor=3.0, lockstep_s=0.25)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "saved.json"
    snapshot.save(Emulator(simulation(seed=4), clock=SAVED_PACE), path)
    return path


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "run.log"
    with connect(f"sim:thesis_room?record={path}") as robot:
        robot.refresh()
    return path


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Emulator]:
    """The emulators that daemons were made for; none of them opens a door."""
    emulators: list[Emulator] = []

    class Doorless(Daemon):
        async def listen(self, host: str, port: int) -> int:
            emulators.append(self.emulator)
            return port + len(host)

        async def serve(self, *_: object) -> None:
            """No client connects."""

    monkeypatch.setattr(cli, "Daemon", Doorless)
    return emulators


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--seed", "0"], "--seed"),
        (["--robot", "n150"], "--robot"),
        (["--robots", "1"], "--robots"),
        (["--start", "0,0,0,0", "--setup", "ideal"], "--start, --setup"),
        (["-noisy"], "--noisy"),
        (["--model-file", "mine.toml"], "--model-file"),
        (["thesis_room"], "the world thesis_room"),
    ],
)
@pytest.mark.parametrize(("option", "file"), [("--restore", "snapshot"), ("--replay", "recording")])
def test_what_the_file_decides_is_refused(
    option: str, file: str, words: list[str], named: str, saved: Path, started: list[Emulator],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    with pytest.raises(SystemExit) as stop:
        cli.main([*words, option, str(saved)])
    assert stop.value.code == 2
    why = f"argument {option}: the {file} has a world, robots, a seed and a setup of its own"
    assert f"{why}: leave out {named}\n" in capsys.readouterr().err
    assert not started


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["several_walls", "--robots", "3", "--noisy", "--start", "5,5"],
         "of its own: leave out --robots, --start, --noisy, the world several_walls\n"),
        (["--restore", "saved.json"], "of its own: leave out --restore\n"),
        (["--save", "saved.json", "--restore", "saved.json"], "of its own: leave out --restore\n"),
        (["--save", "saved.json", "--autosave", "60"], "and writes no file: leave out --save, --autosave\n"),
        (["--record", "again.log"], "it compares and stops, and writes no file: leave out --record\n"),
    ],
)  # fmt: skip
def test_a_replay_starts_from_the_recording_alone(
    words: list[str], error: str, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main([*words, "--replay", str(recorded)])
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.splitlines(keepends=True)[0].endswith(error)


@pytest.mark.parametrize(
    "words",
    [
        [], ["--port", "7100"], ["--bind", "127.0.0.1"], ["--speed", "max"], ["--paused"], ["--lockstep", "0.5"],
        ["--viewer"], ["--allow-quit", "--allow-control"], ["--limit-connections", "9"], ["--log-level", "debug"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_other_options_may_accompany_a_replay(
    words: list[str], recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*words, "--replay", str(recorded)]) == 0
    assert "as recorded" in capsys.readouterr().out


def test_a_robot_of_a_setup_file_is_refused_and_its_port_is_not(
    saved: Path, started: list[Emulator], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, world = tmp_path / "robot.setup", tmp_path / "world.setup"
    robot.write_text("[robot]\ntype = n200\n", encoding="utf-8")
    world.write_text("[server]\nport = 7100\n", encoding="utf-8")
    with pytest.raises(SystemExit):
        cli.main([str(robot), "--restore", str(saved)])
    assert "the robot of a setup file" in capsys.readouterr().err
    assert cli.main([str(world), "--restore", str(saved)]) == 0
    assert len(started) == 1
    assert cli.main(["nothing.setup", "--restore", str(saved)]) == 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "pace"),
    [
        ([], SAVED_PACE),
        (["--speed", "7"], SimulationClock(7.0)),
        (["--speed", "max"], SimulationClock(None)),
        (["--paused"], SimulationClock(paused=True)),
        (["--lockstep", "0.5"], SimulationClock(lockstep_s=0.5)),
        (["--port", "0", "--allow-control"], SAVED_PACE),
    ],
)
def test_a_restored_run_keeps_its_speed_unless_given(
    words: list[str], pace: SimulationClock, saved: Path, started: list[Emulator]
) -> None:
    assert cli.main([*words, "--restore", str(saved)]) == 0
    assert started[0].clock == pace
    assert started[0].simulation.seed == 4


@pytest.mark.parametrize(
    "pace",
    [
        # Out of range, or of a type that JSON allows but the clock does not; True is an int in Python.
        SimulationClock(factor=-1.0),
        SimulationClock(factor=1e9),
        SimulationClock(factor=True),
        SimulationClock(factor="1"),  # type: ignore[arg-type]
        SimulationClock(lockstep_s=0.0),
        SimulationClock(lockstep_s=11.0),
        SimulationClock(paused=1),  # type: ignore[arg-type]
    ],
)
def test_an_invalid_clock_is_refused(pace: SimulationClock) -> None:
    text = snapshot.dumps(Emulator(simulation(), clock=pace))
    emulator = Emulator(simulation())
    with pytest.raises(SnapshotError, match="is damaged"):
        snapshot.loads(emulator, text)
    assert emulator.clock == SimulationClock()


def test_the_first_client_owns_a_restored_moving_robot() -> None:
    emulator = Emulator(simulation())
    # 1. A moving robot is saved and restored: its axes have no owner.
    meet(emulator)[0].ask("vm", 50, 0, 100)
    emulator.pass_time(1.0)
    restored = Emulator(simulation())
    snapshot.loads(restored, snapshot.dumps(emulator))
    robot = restored.simulation.robots[1]
    # 2. The first client that connects owns both moving axes; the second takes over the turret with mv.
    first, first_session = meet(restored)
    second, second_session = meet(restored)
    second.ask("mv", 0, 0, 0, 0, 1, 70)
    # 3. When the first one closes, only its own axis stops.
    restored.on_disconnect(first_session.context)
    assert robot.moving == (False, False, True)
    # 4. A client that connects later owns nothing.
    _, third_session = meet(restored)
    restored.on_disconnect(third_session.context)
    assert robot.moving == (False, False, True)
    restored.on_disconnect(second_session.context)
    assert robot.moving == (False, False, False)
    del first


@pytest.mark.long
def test_axes_with_an_owner_are_not_claimed() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    # 1. Robot 2 moves; the snapshot is restored.
    client.ask("create_robot", 2, 1)
    client.ask("vm", 0, 0, 100)
    restored = Emulator(simulation())
    snapshot.loads(restored, snapshot.dumps(emulator))
    # 2. A client of robot 1 closes: the motion of robot 2 is not its own.
    _, session = meet(restored)
    restored.on_disconnect(session.context)
    assert restored.simulation.robots[2].moving[2]


def test_a_saved_run_starts_anew_without_a_file(
    started: list[Emulator], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    saved = tmp_path / "now.json"
    words = ["several_walls", "--robots", "2", "--seed", "7", "--save", str(saved), "--restore", str(saved)]
    assert cli.main(words) == 0
    assert (started[0].simulation.world.name, len(started[0].simulation.robots)) == ("several_walls", 2)
    assert started[0].simulation.seed == 7
    (record,) = caplog.records
    assert record.getMessage() == f"{saved}: not there yet: the simulation begins, and is saved there"


def test_a_saved_run_continues_from_its_file(
    saved: Path, started: list[Emulator], tmp_path: Path, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    # The world, model and robot do not exist: with a file to restore they are not read.
    gone = ["world_that_is_gone.toml", "--model-file", "gone_too.toml", "--robot", "mine", "--seed", "7", "--noisy"]
    caplog.set_level("INFO", "nserver_emu.control.recording")
    assert cli.main([*gone, "--save", saved.name, "--autosave", "60", "--restore", str(saved)]) == 0
    assert (started[0].simulation.world.name, started[0].simulation.seed) == ("thesis_room", 4)
    assert started[0].clock == SAVED_PACE
    assert "goes on from" in caplog.text
    # An option for the clock overrides the saved one.
    assert cli.main([*gone, "--save", saved.name, "--restore", str(saved), "--speed", "7"]) == 0
    assert started[1].clock == SimulationClock(7.0)


@pytest.mark.parametrize("save", [(), ("--save", "other.json"), ("--save", "other.json", "--autosave", "60")])
def test_a_missing_file_is_an_error_if_not_also_saved(
    save: tuple[str, ...], started: list[Emulator], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*save, "--restore", str(tmp_path / "now.json")]) == 1
    assert "now.json: cannot be read: " in capsys.readouterr().err
    assert not started


def test_a_damaged_file_is_an_error(
    started: list[Emulator], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "now.json"
    saved.touch()
    assert cli.main(["--save", str(saved), "--restore", str(saved)]) == 1
    assert "is no snapshot of an nserver" in capsys.readouterr().err
    assert (started, saved.read_text()) == ([], "")
