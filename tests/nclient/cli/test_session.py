"""A session with an emulated robot in this process: what each line does to it, and what is shown."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nclient.backends.nserver import NserverBackend
from nclient.cli.shell_session import BUILTINS, Session
from nclient.connector import open_backend
from nclient.errors import RobotRefused, ShellError
from nclient.protocol.types import N200
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_server import ScriptedServer


class Slept:
    """Counts seconds of real time that were waited."""

    def __init__(self) -> None:
        self.total_s = 0.0

    def __call__(self, seconds: float) -> None:
        self.total_s += seconds


def session_on(address: str = "sim:thesis_room", slept: Slept | None = None) -> Session:
    return Session(open_backend(address), slept or Slept())


def scripted(server: ScriptedServer, slept: Slept | None = None) -> Session:
    return Session(NserverBackend(MemoryStream(server), model=server.wire_state.model), slept or Slept(), pid=7)


def reported(session: Session, text: str) -> str:
    return "\n".join(session.run(text))


@pytest.mark.long
def test_a_motion_and_its_end() -> None:
    session = session_on()
    # 240 tenths of an inch are 24 in.
    assert "moving: translation" in reported(session, "pr(240, 0, 0);")
    assert reported(session, "wait").startswith("x 24.0 in  y 0.0 in")
    assert reported(session, "State[34]") == "State[34] = 240"
    assert session.robot.truth().x_in == pytest.approx(24.0)


@pytest.mark.parametrize(("address", "text", "notes"), [
    # Tenths of in/s on the wire: 10000 are 1000 in/s.
    ("sim:thesis_room", "vm 10000 0 0", ["translation 10000 is 1000 in/s, more than the 20 in/s of the n150"]),
    ("sim:thesis_room", "vm -201 0 451", ["translation -201 is 20.1 in/s", "turret 451 is 45.1 deg/s"]),
    # Exactly the maxima of a N150: 20 in/s and 45 deg/s.
    ("sim:thesis_room", "vm 200 -450 450", []),
    # sp sets speeds; mv sets a velocity in mode 1 and a distance in mode 2; pr sets distances.
    ("sim:thesis_room", "sp 0 460 0", ["steering 460 is 46 deg/s"]),
    ("sim:thesis_room", "mv 1 300 2 3000 0 0", ["translation 300 is 30 in/s"]),
    ("sim:thesis_room", "pr 10000 0 0", []),
    ("sim:thesis_room?robot=scout", "vm 390 -400 0", ["left wheel -400 is 40 in/s, more than the 39 in/s"]),
])  # fmt: skip
def test_speeds_beyond_the_model_are_reported(address: str, text: str, notes: list[str]) -> None:
    session = session_on(address)
    *shown, _ = list(session.run(text))
    assert len(shown) == len(notes)
    assert all(note in line for note, line in zip(notes, shown, strict=True))


@pytest.mark.parametrize(("text", "shown"), [
    ("gs", "x 0.0 in  y 0.0 in"),
    ("get_sn", "sonar "),
    ("get_rc", "pose        x 0.0 in"),
    ("get_rv", "velocity    translation 0.0 in/s"),
    ("get_ra", "translation 0.0 in/s2  steering 0.0 deg/s2"),
    ("get_bp", "bumpers     free"),
    ("get_robot_conf", "x 0.0 in  y 0.0 in  steering 0.0 deg"),
    ("get_rpx", "robot 1: x 0.0 in  y 0.0 in  heading 0.0 deg"),
    ("sim_truth", "ground truth x 0.000 in  y 0.000 in  heading 0.000 deg"),
    ("sim_control 4 500", "simulated time 0."),
    ("sim_control 1 0", "paused"),
    ("motion_check 0 0 0 40000 0", "hits at x "),
    ("motion_check 0 0 0 10 0", "free"),
    ("predict_sensors 0 0 0 0", "sonar "),
    ("new_world", "ok"),
    ("connect_robot 1", "x 0.0 in  y 0.0 in"),
    ("conf_tm 3", "standing"),
    ("Smask", "0 1 1 1"),
    ("Laser", "0"),
    ("help", "pr translation steering turret      move each axis by a distance"),
    ("help pr wait", "wait [SECONDS]"),
    ("state", "battery     computer 12.0 V"),
    ("state pose clock", "clock       0."),
    ("# nothing", ""),
])
def test_what_a_line_shows(text: str, shown: str) -> None:
    assert shown in reported(session_on(), text)


@pytest.mark.long
def test_model_with_more_sensors_reports_more() -> None:
    session = session_on("sim:thesis_room?robot=n200")
    assert reported(session, "get_ir").startswith("infrared ")
    assert reported(session, "get_cp").startswith("compass ")
    assert reported(session, "conf_ls 51 20 20 20 4; get_ls").splitlines()[-1].startswith("laser ")


def test_the_mask_is_set_and_sent_as_in_c() -> None:
    session = session_on("sim:thesis_room?robot=n200")
    assert reported(session, "Smask[17] = 0; Smask[17]") == "Smask[17] = 0\nSmask[17] = 0"
    # As in C the assignment changes the array only, and ct sends it.
    assert session.wire_state.mask.has(17)  # not yet
    reported(session, "ct")
    assert not session.wire_state.mask.has(17)
    reported(session, f"ct {{{' '.join(['0'] + ['1'] * 43)}}}")
    assert reported(session, "Smask[17]") == "Smask[17] = 1"


def test_help_is_as_wide_as_a_terminal_but_for_long_lines() -> None:
    lines = reported(session_on(), "help").splitlines()
    assert all(name in "\n".join(lines) for name in BUILTINS)
    assert any(line.startswith(" " * 36) for line in lines)


@pytest.mark.parametrize(("text", "why"), [
    ("help nothing_such", "help: no command 'nothing_such'"),
    ("help mvv", "did you mean mv?"),
    ("help vn", r"help: no command 'vn'; did you mean vm\?; help lists them all"),
    ("help foo", "help: no command 'foo'; help lists them all"),
    ("help slep", "did you mean sleep?"),
    ("state sonars", "no part 'sonars'"),
    ("sleep", r"sleep SECONDS: expected a number of seconds, 0 to 86400"),
    ("sleep long", "sleep SECONDS"),
    ("sleep -1", "sleep SECONDS"),
    ("wait 1 2", r"wait \[SECONDS\]: expected a number"),
    ("quit now", "quit takes no arguments"),
    ("State[45]", "State has 45 numbers, 0 to 44, not 45"),
    ("Smask[44] = 1", "Smask has 44 numbers"),
    ("Smask[1] = 2", r"Smask\[0\] is a sum"),
    ("Smask[0] = 32", r"Smask\[0\] is a sum"),
    ("Laser[1]", "Laser holds 1 numbers now, not 1"),
    ("gs; prr", "no command 'prr'"),
])
def test_errors_are_reported_before_anything_is_executed(text: str, why: str) -> None:
    server = ScriptedServer()
    session = scripted(server)
    with pytest.raises(ShellError, match=why):
        reported(session, text)
    # The second command of a line is checked before the first one is sent.
    assert server.names() == []


def test_a_refusal_of_the_robot_is_its_own_error() -> None:
    session = session_on()
    with pytest.raises(RobotRefused, match="quit_server was refused"):
        reported(session, "quit_server")
    # Error code 5: refused by the setup. It stays in State[44].
    assert "State[44] = 5" in reported(session, "State[44]")


def test_what_has_many_numbers_and_no_words_is_shown_as_it_came() -> None:
    server = ScriptedServer()
    # The scripted server answers with 16 zeros.
    assert reported(scripted(server), "special_request 200 1 2") == " ".join(["0"] * 16)
    assert server.last().args == (200, 1, 2)
    assert reported(scripted(server), "create_robot 3").startswith("x 0.0 in")
    assert ("create_robot", (3, 7)) in [(call.name, call.args) for call in server.calls]


@pytest.mark.long
def test_sleep_is_simulated_time_in_this_process_and_costs_none() -> None:
    slept = Slept()
    session = session_on("sim:thesis_room?step_s=0.05", slept)
    before = session.robot.refresh().clock_s
    assert reported(session, "sleep 3") == ""
    after = session.robot.state.clock_s
    assert before is not None
    assert after is not None
    # 3 s in steps of 0.05 s, and at most one step more for the query that ends the wait.
    assert after - before == pytest.approx(3.05, abs=0.051)
    assert slept.total_s == 0


def test_sleep_uses_the_robots_clock() -> None:
    server, slept = ScriptedServer(), Slept()
    session = scripted(server, slept)

    def pass_time(seconds: float) -> None:
        slept(seconds)
        # A simulation ten times as fast.
        server.clock += round(10_000 * seconds)

    session._sleep = pass_time
    reported(session, "sleep 20")
    # 20 s of a clock that runs ten times as fast take 2 s.
    assert slept.total_s == pytest.approx(2.0, abs=0.06)


def test_sleep_says_when_the_robots_clock_stands() -> None:
    with pytest.raises(ShellError, match=r"clock .*sim_control 2 0"):
        reported(session_on(), "sim_control 1 0; sleep 1")


def test_sleep_uses_real_time_without_a_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    slept = Slept()
    session = scripted(ScriptedServer(), slept)
    silent = session.robot.refresh()
    # A robot whose replies have no clock: the wait is in real time.
    monkeypatch.setattr(session.robot, "refresh", lambda: replace(silent, clock_ms=None))
    reported(session, "sleep 2")
    assert slept.total_s == 2


def test_wait_fails_where_the_robot_moves_on() -> None:
    # vm has no end, so that the robot still moves after 1 s.
    with pytest.raises(ShellError, match=r" 1 s .*translation 5\.0"):
        reported(session_on(), "vm 50 0 0; wait 1")


@pytest.mark.parametrize("text", ["quit", "exit", "disconnect_robot 1"])
def test_quitting_is_noted(text: str) -> None:
    session = session_on()
    assert not session.finished
    reported(session, text)
    assert session.finished


@pytest.mark.parametrize("text", ["quit", "exit", "disconnect_robot 1"])
def test_what_follows_on_the_line_is_not_done(text: str) -> None:
    session = session_on()
    reported(session, f"{text}; pr 100 0 0; gs")
    assert not session.robot.refresh().moving


def test_a_time_out_of_ones_own_is_noted() -> None:
    session = session_on()
    assert not session.user_set_timeout
    reported(session, "conf_tm 3; gs")
    assert session.user_set_timeout


def test_halting_says_st() -> None:
    server = ScriptedServer(model=N200)
    session = scripted(server)
    assert session.halt().startswith("stopped: x 0.0 in")
    assert server.names() == ["st"]
