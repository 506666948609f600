"""`nserver ctl`: requests, output, and errors without a server."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from nserver_emu import cli
from nserver_emu.control import cli as ctl
from nserver_emu.control import cli as ctl_answers
from nserver_emu.control.commands import COMMANDS, default_path
from worlds.io import SHIPPED


@contextmanager
def answering(path: Path, answer: bytes) -> Iterator[list[dict[str, Any]]]:
    """A daemon that says one thing; the list is what it was asked."""
    asked: list[dict[str, Any]] = []

    def serve() -> None:
        connection, _ = listener.accept()
        with connection, connection.makefile("rb") as lines:
            asked.append(json.loads(lines.readline()))
            connection.sendall(answer)

    with socket.socket(socket.AF_UNIX) as listener, ThreadPoolExecutor(1) as thread:
        listener.settimeout(10)
        listener.bind(str(path))
        listener.listen()
        serving = thread.submit(serve)
        yield asked
        serving.result(10)


@pytest.fixture
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("c") / "s"


def run(path: Path, *words: str, result: object = None, error: str = "") -> tuple[int, dict[str, Any]]:
    answer = {"ok": False, "error": error} if error else {"ok": True, "said": result or {}}
    with answering(path, json.dumps(answer).encode() + b"\n") as asked:
        code = cli.main(["ctl", "--control", str(path), *words])
    (request,) = asked
    return code, request


@pytest.mark.parametrize(
    ("words", "sent"),
    [
        (["status"], {"command": "status", "argument": None}),
        (["speed", "10"], {"command": "speed", "argument": "10"}),
        (["stop"], {"command": "stop", "argument": None}),
        (["stop", "2"], {"command": "stop", "argument": "2"}),
        (["release", "2"], {"command": "release", "argument": "2"}),
        (["faults", "clear"], {"command": "faults clear", "argument": None}),
        (["noise", "sensors=noisy", "robot=2"], {"command": "noise", "argument": "sensors=noisy robot=2"}),
    ],
)
def test_words_become_a_request(path: Path, words: list[str], sent: dict[str, Any]) -> None:
    assert run(path, *words) == (0, sent)


def test_files_are_read_here_and_named_whole(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.toml").write_text("seed = 3")
    code, request = run(path, "faults", "set", "p.toml", result={"rules": 0})
    assert (code, request["argument"]) == (0, {"file": "p.toml", "text": "seed = 3"})
    Path("w.toml").write_text("# a world")
    world = run(path.with_name("w"), "world", "set", "w.toml")[1]
    assert world == {"command": "world set", "argument": {"file": "w.toml", "text": "# a world"}}
    shipped = (SHIPPED / "several_walls.toml").read_text()
    for place, name in enumerate(("several_walls", "several_walls.toml")):
        world = run(path.with_name(f"v{place}"), "world", "set", name)[1]
        assert world["argument"] == {"file": name, "text": shipped}
    assert run(path.with_name("t"), "save", "x.json")[1]["argument"] == str(tmp_path / "x.json")


@pytest.mark.parametrize("words", [["--control", "c1", "status"], ["--control", "status"]])
def test_a_path_is_one_that_the_daemon_takes_as_well(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    wanted = f"argument --control: a path with a slash or ending in .sock, such as ./nserver.sock, not {words[1]!r}"
    with pytest.raises(SystemExit, match="2"):
        cli.main(["ctl", *words])
    assert capsys.readouterr().err.splitlines()[0].endswith(wanted)
    with pytest.raises(SystemExit, match="2"):
        cli.main(words[:2])
    assert f"{wanted}; the world goes before --control" in capsys.readouterr().err


def test_a_missing_file_is_an_error_without_a_server(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["ctl", "--control", "/nowhere", "faults", "set", str(tmp_path / "x.toml")]) == 1
    assert "x.toml: cannot be read" in capsys.readouterr().err
    assert cli.main(["ctl", "--control", "/nowhere", "world", "set", str(tmp_path / "w.toml")]) == 1
    assert "w.toml: no such file" in capsys.readouterr().err


STATUS = {
    "version": "0.1.0", "world": "thesis_room", "seed": 1, "time_s": 12.5, "speed": 2.0, "paused": False,
    "lockstep_s": None,
    "robots": [
        {"number": 1, "model": "n150", "moving": True, "bumpers": 0, "x_in": 1.25, "y_in": -3.0, "steering_deg": 90.0,
         "turret_deg": 0.0, "noise": {"sensors": "ideal", "motion": "worn"}, "held": None},
        {"number": 2, "model": "scout", "moving": False, "bumpers": 5, "x_in": 0.0, "y_in": 0.0, "steering_deg": 0.0,
         "turret_deg": 0.0, "noise": {"sensors": "measured", "motion": "noisy"},
         "held": {"by": "viewer 1", "ignored": 4}},
    ],
    "lines": {"nserver": "127.0.0.1:7019", "serial:1": "/tmp/nomad"},
    "connections": [
        {"name": "127.0.0.1:5", "robot": 1, "waiting": True, "refused": 2},
        {"name": "127.0.0.1:6", "robot": None, "waiting": False, "refused": 0},
    ],
    "faults": {"rules": 2, "struck": {"drop": 3}},
}  # fmt: skip


def test_everything_at_a_glance(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(path, "status", result=STATUS)
    assert capsys.readouterr().out.splitlines() == [
        "nserver 0.1.0, thesis_room, seed 1",
        "time 12.500 s, 2 x real time",
        "robot 1: n150 at 1.2, -3.0 in, 90.0 deg, moving, sensors ideal, motion worn",
        "robot 2: scout at 0.0, 0.0 in, 0.0 deg, standing, bumpers 0x5, sensors measured, motion noisy, "
        "held by viewer 1, 4 motion commands ignored since",
        "line nserver: 127.0.0.1:7019",
        "line serial:1: /tmp/nomad",
        "client 127.0.0.1:5: robot 1, 2 refused, waiting",
        "client 127.0.0.1:6: no robot yet, 0 refused",
        "faults: 2 rules, so far drop 3",
    ]
    run(path.with_name("t"), "--json", "status", result=STATUS)
    assert json.loads(capsys.readouterr().out) == STATUS


@pytest.mark.parametrize(
    ("result", "shown"),
    [
        ({"plan": "seed = 3\n"}, "seed = 3"),
        ({"counts": {}}, "no faults"),
        ({"counts": {"serial:1": {"it": {"seen": 3, "drop": 1}}}}, "serial:1, it: seen 3, drop 1"),
        ({"time_s": 1, "paused": True, "lockstep_s": None, "speed": 1}, "time 1.000 s, paused"),
        ({"time_s": 1, "paused": False, "lockstep_s": 0.1, "speed": 1}, "time 1.000 s, lockstep, 0.1 s a request"),
        ({"time_s": 1, "paused": False, "lockstep_s": None, "speed": "max"}, "time 1.000 s, unlimited speed"),
        ({"saved": "/x"}, "saved: /x"),
        ({"held": {}}, "no robot is held"),
        ({"held": {"2": {"by": "page", "ignored": 0}}}, "robot 2, held by page, 0 motion commands ignored since"),
        ({"text": 'name = "w"\n'}, 'name = "w"'),
        ({"noise": {"2": {"sensors": "ideal", "motion": "worn"}}}, "robot 2: sensors ideal, motion worn"),
    ],
)
def test_answers_are_shown_for_people(result: dict[str, Any], shown: str) -> None:
    assert "\n".join(ctl_answers.format_result(result)) == shown


def test_a_refusal_exits_with_1(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(path, "pause", error="it cannot be")[0] == 1
    assert capsys.readouterr().err == "nserver ctl: it cannot be\n"


def test_without_a_server_the_remedy_is_printed(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path.parent))
    assert cli.main(["ctl", "status"]) == 1
    output = capsys.readouterr().err
    assert f"no nserver answers at {default_path({'XDG_RUNTIME_DIR': str(path.parent)})} (No such file" in output
    assert "start it with nserver --control" in output
    with answering(path, b""):
        assert cli.main(["ctl", "--control", str(path), "status"]) == 1
    assert "closed the connection" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "patience"), [("stop", "URGENT_TIMEOUT_S"), ("counts", "TIMEOUT_S")])
def test_a_hanging_server_is_reported(
    command: str, patience: str, path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ctl, patience, 0.05)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as silent:
        silent.bind(str(path))
        silent.listen()
        words = ["faults", command] if command == "counts" else [command]
        assert cli.main(["ctl", "--control", str(path), *words]) == 1
    assert f"the nserver at {path} did not answer in 0.05 s: it hangs" in capsys.readouterr().err


def test_a_peer_that_is_no_server_is_reported(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with answering(path, b'{"ok": true}\n'):
        assert cli.main(["ctl", "--control", str(path), "status"]) == 1
    assert f"nserver ctl: {ctl_answers.NO_ANSWER}" in capsys.readouterr().err
    monkeypatch.setattr(ctl, "MAX_LINE", 100_000)
    with answering(path.with_name("t"), b"x" * 150_000):
        assert cli.main(["ctl", "--control", str(path.with_name("t")), "status"]) == 1
    assert "too long" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "output"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["fly"], "no command 'fly'; there are status, faults show"),
        (["puase"], "help; did you mean pause?"),
        (["faults"], "no command 'faults'"),
        (["speed"], "speed takes X, not nothing"),
        (["pause", "now"], "pause takes no argument, not now"),
    ],
)
def test_wrong_usage_exits_2(words: list[str], output: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(["ctl", *words])
    assert stop.value.code == 2
    assert output in capsys.readouterr().err


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(["ctl", "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert all(f"\n  {row.name}" in out for row in COMMANDS)
    assert cli.main(["ctl", "help"]) == 0
    assert capsys.readouterr().out == out


def test_ctrl_c_ends_with_130(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    def interrupted(*_: object) -> dict[str, Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr(ctl, "request", interrupted)
    assert cli.main(["ctl", "--control", str(path), "status"]) == 130
