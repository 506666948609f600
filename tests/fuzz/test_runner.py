"""A run of one reader without atheris, and the command: counts, findings, limits, report."""

from __future__ import annotations

import faulthandler
import itertools
import os
import time
from pathlib import Path

import pytest

from fuzz import __main__ as command
from fuzz import runner
from fuzz.reader import Reader, input_file
from fuzz.runner import Run, Status, shared_status
from nclient.errors import WireError


class ProcessExit(BaseException):
    """Raised in place of the end of the process."""


@pytest.fixture(autouse=True)
def _isolated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Raise instead of exiting, and store findings in a temporary folder."""

    def end(code: int) -> None:
        raise ProcessExit(code)

    monkeypatch.setattr(os, "_exit", end)
    monkeypatch.setattr(runner, "FOUND", tmp_path / "fuzz" / "found")
    runner.FOUND.mkdir(parents=True)


# "no" is refused as documented, "bad" is a finding, "slow" uses more processor time than is allowed.
def read(data: bytes) -> None:
    if data == b"no":
        raise WireError("no")
    if data.startswith(b"bad"):
        raise KeyError("bad")
    if data == b"slow":
        until_s = time.process_time() + 0.02
        while time.process_time() < until_s:
            pass


READER = Reader("toy", "a toy", read, (WireError,), lambda: [b"yes"], lambda data, _: data + b"!")


def run(tmp_path: Path, *inputs: bytes, max_inputs: float = 1000, max_seconds: float = 3600.0) -> Status:
    status = shared_status()
    toy = Run(READER, status, tmp_path / "toy", max_inputs, max_seconds, is_guided=True)

    def run_all() -> None:
        for data in itertools.cycle(inputs):
            toy.run_input(data)

    with pytest.raises(ProcessExit):
        run_all()
    return status


def findings() -> list[bytes]:
    return [path.read_bytes() for path in sorted(runner.FOUND.glob("toy-*"))]


def test_inputs_and_acceptance_are_counted(tmp_path: Path) -> None:
    status = run(tmp_path, b"yes", b"no")
    # Half of the inputs are accepted.
    assert (status.executions, status.accepted, findings()) == (1000, 500, [])
    assert status.warm_kb > 0
    assert (status.warm_objects, status.end_objects) == (0, 0)


def test_shortest_finding_of_a_kind_is_stored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status = run(tmp_path, b"bad, long", b"bad", b"bad, longer", b"yes")
    assert status.executions == 1000
    # Of three inputs with the same error the shortest is stored.
    assert findings() == [b"bad"]
    assert "KeyError" in capsys.readouterr().err


def test_slow_input_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "MAX_INPUT_S", 0.01)
    run(tmp_path, b"slow", max_inputs=3)
    # 20 ms of processor time against a limit of 10 ms; the input is found again and stored once.
    assert findings() == [b"slow"]
    assert "for one input" in capsys.readouterr().err


def test_run_ends_after_its_time(tmp_path: Path) -> None:
    status = run(tmp_path, b"yes", max_inputs=float("inf"), max_seconds=0.2)
    assert 0.2 <= status.seconds < 10
    assert status.executions > 100


def test_blind_run_counts_objects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status = shared_status()
    blind = Run(READER, status, tmp_path / "toy", 6000, 3600.0, is_guided=False)
    monkeypatch.setattr(blind, "_isolate", lambda: None)
    with pytest.raises(ProcessExit):
        blind.blind()
    faulthandler.cancel_dump_traceback_later()
    assert status.executions == 6000
    assert status.warm_objects > 0
    assert abs(status.end_objects - status.warm_objects) < 10_000


def test_blind_run_starts_from_the_corpus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "1").write_bytes(b"bad")
    blind = Run(READER, shared_status(), tmp_path / "toy", 1000, 3600.0, is_guided=False)
    monkeypatch.setattr(blind, "_isolate", lambda: None)
    with pytest.raises(ProcessExit):
        blind.blind()
    faulthandler.cancel_dump_traceback_later()
    assert all(data.startswith(b"bad") for data in findings())
    assert findings()


def test_report_has_findings_exit_status_and_growth(tmp_path: Path) -> None:
    status = run(tmp_path, b"bad", b"yes")
    lines = list(command._findings(READER, status, 0, 0.0))
    assert lines[0].startswith("found: scripts/fuzz --again fuzz/found/toy-")
    assert "b'bad'" in lines[1]
    assert list(command._findings(READER, status, 0, time.time() + 60)) == []
    crashed = "\n".join(command._findings(READER, status, 11, time.time() + 60))
    assert "ended with -11" in crashed
    # Memory that grows beyond the limit between warm-up and end is a finding, too.
    status.end_kb = status.warm_kb + command.MAX_GROWTH_KB + 1
    status.end_objects = command.MAX_GROWTH_OBJECTS + 1
    grown = list(command._findings(READER, status, 0, time.time() + 60))
    assert ["kB" in grown[0], "objects" in grown[1], len(grown)] == [True, True, 2]
    assert "1,000" in command._row(READER, status)


def test_supervisor_runs_processes_until_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs: list[float] = []

    def fork(_function: object, _reader: Reader, status: Status, _limits: object, count: float, _seconds: float) -> int:
        inputs.append(count)
        status.executions += int(count)
        return 1

    monkeypatch.setattr(command, "_fork", fork)
    monkeypatch.setattr(os, "waitpid", lambda pid, _: (pid, 0))
    monkeypatch.setattr(os, "setpgid", lambda *_: None)
    limits = command.Limits(250_000, float("inf"), tmp_path, True)
    assert command._supervise(READER, shared_status(), limits) == 0
    assert inputs == [100_000, 100_000, 50_000]


def test_input_file_is_overwritten() -> None:
    path = input_file(b"long", ".toml")
    assert (input_file(b"x", ".toml"), path.read_bytes()) == (path, b"x")


def test_list_and_invalid_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--list"]) == 0
    assert "worlds            world files" in capsys.readouterr().out
    for wrong in (["--runs", "0"], ["--seconds", "nan"], ["--list", "wordls"]):
        with pytest.raises(SystemExit, match="2"):
            command.main(wrong)
    assert "unknown reader 'wordls'" in capsys.readouterr().err


def test_again_runs_one_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rejected = "rejected as documented: WireError"
    for name, data, result in (("hello-1", bytes(11), "accepted"), ("hello-2", b"", rejected)):
        (tmp_path / name).write_bytes(data)
        assert command.main(["--again", str(tmp_path / name)]) == 0
        assert capsys.readouterr().out.strip() == result
    (tmp_path / "other").write_bytes(b"")
    assert command.main(["--again", str(tmp_path / "other")]) == 2


def test_default_corpus_is_in_the_user_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert command.default_corpus() == tmp_path / "nomad-fuzz"
