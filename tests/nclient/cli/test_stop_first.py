"""On a robot's own line st goes out first, and counts as answered however little of the robot is understood."""

from __future__ import annotations

import pytest

from nclient.backends.base import Backend
from nclient.backends.direct import DirectBackend
from nclient.cli import main
from nclient.cli.robot import RobotStopper, StopFirstConnector
from nclient.errors import ReplyTimeout
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.types import EVERYTHING, MODELS, N150, N200, SCOUT, Model
from nclient.transports.stream import ByteStream, MemoryStream
from tests.nclient.scripted_line import Answer, ScriptedLine

UNSEEN = "NOT SEEN TO STOP: st was answered, and nothing showed that it stands still"


class Time:
    """Clock that advances by sleeping."""

    now_s = 0.0

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def stopped(robot: ScriptedLine, model: Model, patience_s: float = 1) -> tuple[int, StopFirstConnector]:
    """The exit code, and who opened the conversations."""

    def talks(stream: ByteStream) -> Backend:
        return DirectBackend(stream, model)

    time = Time()
    first = StopFirstConnector(lambda: MemoryStream(robot), talks, model)
    return RobotStopper(first, time.clock, time.sleep).run(patience_s), first


@pytest.mark.parametrize("model", MODELS.values())
def test_the_first_bytes_are_st(model: Model, capsys: pytest.CaptureFixture[str]) -> None:
    robot = ScriptedLine(model=model)
    code, _ = stopped(robot, model)
    assert code == 0
    assert robot.names()[0] == "st"
    # Length 2 (type and checksum), type 9 (st); 0x01 + 0x02 + 0x09 = 0x0c.
    assert bytes(robot.requests[:6]) == bytes.fromhex("01 02 00 09 0c 5c")
    # One st as the first bytes, one after the session has begun.
    assert capsys.readouterr().out == "stands still at x 0.0 in, y 0.0 in; st sent 2 times\n"


def test_a_n200_that_does_not_answer_ct_is_stopped_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    # The model's first command is not answered, but the robot was stopped before it.
    robot = ScriptedLine({"ct": None}, N200)
    code, first = stopped(robot, N200)
    assert code == 1
    assert robot.names()[:2] == ["st", "ct"]
    assert first.replies
    assert capsys.readouterr().out.startswith(f"{UNSEEN}; st sent ")


def test_a_hello_before_the_answer_is_no_answer() -> None:
    robot = ScriptedLine(model=N200)
    # The handshake of 11 bytes has no frame: it must not count as the reply to st.
    robot.out += build_handshake(Handshake(EVERYTHING, 51))
    code, _ = stopped(robot, N200)
    assert (code, robot.names()[0]) == (0, "st")


@pytest.mark.parametrize(("real", "captured"), [(N200, N150), (N200, SCOUT)])
# The packet of a N200 has another length than those of N150 and Scout, which shows its model.
def test_another_model_than_the_address_says(real: Model, captured: Model, capsys: pytest.CaptureFixture[str]) -> None:
    code, first = stopped(ScriptedLine(model=real), captured)
    out = capsys.readouterr().out
    assert code == 1
    assert first.replies
    assert out.startswith(f"{UNSEEN}; it looks like a {real.name}'s: write model={real.name} in the address; st sent ")


def test_st_is_repeated_until_it_is_answered() -> None:
    answers: list[Answer] = [None, None]
    robot = ScriptedLine({"st": answers})
    code, first = stopped(robot, N150)
    assert (code, first.stops_sent) == (0, 3)
    assert robot.names()[:3] == ["st", "st", "st"]


def test_a_nak_is_no_answer() -> None:
    # Type 8: the robot refused. st is sent once more.
    nak = bytes.fromhex("01 02 00 08 0b 5c")
    answers: list[Answer] = [nak]
    robot = ScriptedLine({"st": answers})
    code, first = stopped(robot, N150)
    assert (code, first.stops_sent) == (0, 2)


def test_no_reply_closes_the_line(capsys: pytest.CaptureFixture[str]) -> None:
    robot = ScriptedLine({"st": None})
    code, first = stopped(robot, N150, patience_s=0.1)
    # Two connections of three attempts each, as the patience of 0.1 s allows.
    assert (code, first.stops_sent, robot.closed) == (1, 6, 2)
    reported = capsys.readouterr()
    assert reported.out == "NOT STOPPED: no reply; st sent 6 times, 2 errors\n"
    assert reported.err == "nomad: st was not answered within 1 s, 3 times\n"
    assert set(robot.names()) == {"st"}
    with pytest.raises(ReplyTimeout):
        first()


@pytest.mark.parametrize("address", ["serial:///dev/r1?model=n200", "robotd://lab?model=n200&timeout_s=0.5"])
# `nomad stop` sends ct after st, and does not wait for a handshake, which may have been lost.
def test_lost_handshake_is_not_waited_for(
    address: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = ScriptedLine(model=N200)
    for name in ("serial.SerialStream", "stream.TcpStream"):
        monkeypatch.setattr(f"nclient.transports.{name}", lambda *_, **__: MemoryStream(robot))
    assert main.main(["stop", address, "--patience", "0.2"]) == 0
    assert robot.names()[:2] == ["st", "ct"]
    assert capsys.readouterr().out.startswith("stands still at")
