"""nomad doctor and nomad stop from the command line, and stopping what does not want to stop."""

from __future__ import annotations

import itertools
import json
from types import SimpleNamespace

import pytest

from nclient.backends.base import Backend
from nclient.backends.nserver import NserverBackend
from nclient.cli import doctor, main
from nclient.cli.robot import RobotStopper
from nclient.errors import ConnectionLost
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_server import Answer, ScriptedServer

ST, GS = (codec.encode_tcp_request(Call(name)) for name in ("st", "gs"))


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A millisecond passes between two looks at the clock, however busy this machine is."""
    ticks = itertools.count()
    monkeypatch.setattr(doctor, "time", SimpleNamespace(perf_counter=lambda: next(ticks) / 1000, sleep=None))


@pytest.mark.usefixtures("ticking")
# Latencies are graded, and a busy machine would make them slow: the clock is replaced.
def test_a_report_in_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["doctor", "sim:thesis_room"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line[:6] for line in lines} == {"OK    "}
    assert [line[6:19].strip() for line in lines] == [
        "link", "firmware", "motion", "clock", "sonars", "bumpers", "computer", "motors"
    ]


@pytest.mark.usefixtures("ticking")
def test_a_report_as_an_object(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["doctor", "sim:thesis_room?robot=n200", "--json", "--exchanges", "20"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["model"], found["worst"]) == ("n200", "OK")
    assert found["findings"][0]["what"] == "link"
    assert found["findings"][0]["grade"] == "OK"
    # One tick of 1 ms between sending and receiving.
    assert "1.00 ms p50, 1.00 ms p99" in found["findings"][0]["seen"]


@pytest.mark.parametrize(("words", "code"), [
    (("doctor", "nserver://127.0.0.1:1"), 1), (("doctor", "sim:nowhere"), 1), (("stop", "usb:1"), 2),
])
def test_nothing_to_examine(capsys: pytest.CaptureFixture[str], words: tuple[str, ...], code: int) -> None:
    assert main.main(list(words)) == code
    assert capsys.readouterr().err.startswith("nomad: ")


@pytest.mark.parametrize("count", ["0", "-1", "x", "1000001"])
def test_senseless_counts(count: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["doctor", "sim:thesis_room", f"--exchanges={count}"])


def test_a_simulated_robot_is_stopped(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["stop", "sim:thesis_room"]) == 0
    assert capsys.readouterr().out == "stands still at x 0.0 in, y 0.0 in; st sent 1 time\n"


def test_without_an_address_it_is_the_one_that_all_commands_take(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", "sim:thesis_room?start=3,4")
    assert main.main(["stop"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("stands still at x 3.0 in, y 4.0 in")
    assert captured.err == "nomad: stopping sim:thesis_room?start=3,4\n"
    assert main.main(["doctor", "--exchanges", "5", "--interval", "0.01", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["address"] == "sim:thesis_room?start=3,4"


class Runaway:
    """Rolls at 100, still for `obeys` states after it was ordered to stop, and is absent the first `absent` times.

    `st_answers`: what it says to st, one after the other, before it says what it should.
    """

    def __init__(self, obeys: int = 0, st_answers: tuple[Answer, ...] = (), absent: int = 0) -> None:
        self.script = ScriptedServer()
        # 10 = real time, x 1.5 in, translation 10 in/s, motor bit 0: a robot that drives.
        self.script.slots = {0: 10, 34: 15, 38: 100, 41: 1}
        self.obeys, self.st_answers, self.absent = obeys, list(st_answers), absent
        self.reported = False

    def opens(self) -> Backend:
        if self.absent:
            self.absent -= 1
            raise ConnectionLost("no answer")
        return NserverBackend(MemoryStream(self))

    def send(self, data: bytes) -> None:
        if data == ST:
            # 1. st is answered by the script: an error or nothing at first, then a state that still shows the speed.
            self.reported = True
            self.script.answers.pop("st", None)
            if self.st_answers:
                self.script.answers["st"] = self.st_answers.pop(0)
        # 2. After `obeys` states the robot stands still.
        elif data == GS and self.reported:
            self.obeys -= 1
            if self.obeys < 0:
                self.script.slots |= {38: 0, 41: 0}
        self.script.send(data)

    def receive(self) -> bytes:
        answered: bytes = self.script.receive()
        return answered

    def close(self) -> None:
        self.script.close()


class Time:
    """Clock that advances by sleeping."""

    now_s = 0.0

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.mark.parametrize(("runaway", "reported", "faults"), [
    # st is sent again after 20 states that show motion: 25 states take two.
    (Runaway(), "1 time", ""), (Runaway(obeys=5), "1 time", ""), (Runaway(obeys=25), "2 times", ""),
    # A missing reply or an error counts, and st is repeated.
    (Runaway(st_answers=(None, None)), "3 times", ", 2 errors"),
    (Runaway(st_answers=(Reply("error", values=(6,)),) * 2, obeys=1), "3 times", ", 2 errors"),
    # Four attempts to connect fail, and no st is sent by them.
    (Runaway(absent=4), "1 time", ", 4 errors"),
])
def test_stop_repeats_until_the_robot_stands_still(
    capsys: pytest.CaptureFixture[str], runaway: Runaway, reported: str, faults: str
) -> None:
    time = Time()
    assert RobotStopper(runaway.opens, time.clock, time.sleep).run(10) == 0
    assert capsys.readouterr().out == f"stands still at x 1.5 in, y 0.0 in; st sent {reported}{faults}\n"
    assert runaway.script.closed


def test_one_that_does_not_stop(capsys: pytest.CaptureFixture[str]) -> None:
    time = Time()
    assert RobotStopper(Runaway(obeys=10**6).opens, time.clock, time.sleep).run(3) == 1
    assert capsys.readouterr().out.startswith("NOT STOPPED: last seen at 10.0 in/s; st sent ")
    # 3 s of patience, and at most the 20 states of 0.05 s of the last attempt in addition.
    assert 3 <= time.now_s < 4.1


def test_one_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    time = Time()
    assert RobotStopper(Runaway(absent=10**6).opens, time.clock, time.sleep).run(1) == 1
    reported = capsys.readouterr()
    # One attempt each 0.05 s for 1 s.
    assert reported.out == "NOT STOPPED: no reply; st sent 0 times, 20 errors\n"
    assert reported.err == "nomad: no answer\n", "each trouble is reported once"
