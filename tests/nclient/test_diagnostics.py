"""Diagnostics query the robot and never move it; errors on the link are part of the report."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nclient.backends.base import Backend
from nclient.backends.nserver import NserverBackend
from nclient.cli.doctor import DiagnosticData, Diagnostics, percentile_s, report
from nclient.connector import Connector
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, N200, SCOUT, Model
from nclient.transports.stream import MemoryStream
from nclient.url import parse_address
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import InProcess
from nserver_emu.simulation.noise import NOISY
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise
from tests.nclient.scripted_server import ScriptedServer
from worlds.io import load_world

GS = codec.encode_tcp_request(Call("gs"))


class Time:
    """A clock that advances with each sleep, and a little with each reading."""

    def __init__(self, step_s: float = 0.001) -> None:
        self.now_s, self.step_s, self.slept_s = 0.0, step_s, 0.0

    def clock(self) -> float:
        self.now_s += self.step_s
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        self.slept_s += seconds


class Patient:
    """A scripted robot that ignores gs number k if k is in `deaf`; its clock advances with each request."""

    # State[0] = 10 is real time; all sonars read 60 in.
    def __init__(self, model: Model = N150, deaf: range = range(0)) -> None:
        self.script = ScriptedServer(model=model)
        self.script.slots = {0: 10} | dict.fromkeys(range(17, 33), 60)
        self.model, self.deaf, self.count = model, deaf, 0
        self.connections = 0

    def opens(self) -> Backend:
        self.connections += 1
        return NserverBackend(MemoryStream(self), model=self.model)

    def send(self, data: bytes) -> None:
        if data == GS:
            self.count += 1
            if self.count in self.deaf:
                return
        # 30 ms of the robot's clock for each request.
        self.script.clock += 30
        self.script.send(data)

    def receive(self) -> bytes:
        answered: bytes = self.script.receive()
        return answered

    def close(self) -> None: ...


def examined(patient: Patient, exchanges: int = 40, time: Time | None = None) -> DiagnosticData:
    time = time or Time()
    return Diagnostics(patient.opens, time.clock, time.sleep).run(exchanges)


def findings_of(chart: DiagnosticData) -> dict[str, tuple[str, str]]:
    return {finding.what: (finding.grade.name, finding.seen) for finding in report(chart)}


def test_a_healthy_robot_is_not_moved() -> None:
    patient, time = Patient(), Time()
    chart = examined(patient, 40, time)
    assert {grade for grade, _ in findings_of(chart).values()} == {"OK"}
    asked = [call.name for call in patient.script.calls]
    # Only queries: nothing that moves the robot, and no st.
    assert asked == ["connect_robot", "ct", *["gs"] * 40, *chart.answers, "disconnect_robot"]
    assert all(name.startswith("get_") for name in chart.answers)
    # A gs every 30 ms, less the 1 ms that the clock takes for the exchange.
    assert time.slept_s == pytest.approx(40 * 0.029, abs=1e-6)
    assert findings_of(chart)["link"] == ("OK", "40 of 40 gs answered; 1.00 ms p50, 1.00 ms p99")
    assert findings_of(chart)["clock"][1] == f"went forward 1.2 s, {39 * 0.03 / chart.elapsed_s:.2f} s a second"
    assert chart.elapsed_s == pytest.approx(39 * 0.03, rel=0.1)


def test_lockstep_time_needs_no_pause() -> None:
    patient, time = Patient(), Time()
    # State[0] = 0: simulated time advances with each request, and waiting is useless.
    patient.script.slots[0] = 0
    examined(patient, 40, time)
    assert time.slept_s == 0


@pytest.mark.parametrize(("model", "questions"), [
    (N150, "get_sn get_rc get_rv get_ra get_cp get_bp"), (SCOUT, "get_sn get_rc get_rv get_ra get_bp"),
    (N200, "get_ir get_sn get_rc get_rv get_ra get_cp get_ls get_bp get_sg"),
])
def test_each_model_gets_its_own_queries(model: Model, questions: str) -> None:
    chart = examined(Patient(model))
    assert list(chart.answers) == questions.split()
    assert findings_of(chart)["firmware"] == ("OK", f"a {model.name} answered {questions}")
    assert ("infrareds" in findings_of(chart)) is model.has_infrared


def test_unanswered_queries_are_reported() -> None:
    patient = Patient()
    patient.script.answers["get_bp"] = Reply("error", values=(4,))
    patient.script.answers["get_rv"] = None
    chart = examined(patient)
    grade, seen = findings_of(chart)["firmware"]
    assert grade == "FAIL"
    assert "get_bp (get_bp was refused: not available on this robot (error 4))" in seen
    assert "get_rv (get_rv, with 5 s to answer" in seen
    assert chart.answers["get_rc"] == ""
    # Connections: the first one, and one after each of the two that a missing reply closed.
    assert patient.connections == 3, "what was not answered closed the connection, twice"


# One lost reply of 40 is a warning, five are a failure.
@pytest.mark.parametrize(("deaf", "grade"), [(range(5, 6), "WARN"), (range(5, 10), "FAIL")])
def test_lost_replies_are_graded(deaf: range, grade: str) -> None:
    patient = Patient(deaf=deaf)
    chart = examined(patient)
    assert (len(chart.states), len(chart.losses)) == (40 - len(deaf), len(deaf))
    assert findings_of(chart)["link"][0] == grade
    assert patient.connections == 1 + len(deaf)


def test_a_robot_that_disappears() -> None:
    chart = examined(Patient(deaf=range(1, 1000)))
    assert len(chart.losses) == 10
    ((what, (grade, seen)),) = findings_of(chart).items()
    assert (what, grade) == ("link", "FAIL")
    assert "no answer to 10 questions" in seen


def test_a_slow_link() -> None:
    # Each look at the clock takes 0.3 s.
    chart = examined(Patient(), time=Time(0.3))
    assert findings_of(chart)["link"] == ("WARN", "40 of 40 gs answered; 300.00 ms p50, 300.00 ms p99: slow")


def test_counts_of_a_line_are_reported() -> None:
    chart = examined(Patient())
    assert "line" not in findings_of(chart)
    assert findings_of(replace(chart, link={"exchanges": 5, "skipped_bytes": 0}))["line"][0] == "OK"
    damaged = findings_of(replace(chart, link={"skipped_bytes": 3, "checksum_errors": 1}))["line"]
    assert damaged == ("WARN", "3 skipped bytes, 1 checksum errors")


def test_percentiles_by_nearest_rank() -> None:
    # Nearest rank: the smallest value of which at least that part of all values is not larger.
    assert [percentile_s([5, 1, 4, 2, 3], share) for share in (0.0, 0.2, 0.21, 0.5, 0.99, 1.0)] == [1, 1, 2, 3, 5, 5]


@pytest.mark.long
@pytest.mark.parametrize("what", ["sim:thesis_room", "sim:thesis_room?noisy=1", "sim:centre_vertex?robot=scout"])
def test_simulated_robots_are_healthy(what: str) -> None:
    time = Time()
    chart = Diagnostics(Connector(parse_address(what)).open_session, time.clock, time.sleep).run()
    assert {finding.grade.name for finding in report(chart)} == {"OK"}
    assert len({state.pose for state in chart.states}) == 1


@pytest.mark.long
def test_a_dead_sonar_of_a_simulated_robot() -> None:
    simulation = Simulation(load_world("thesis_room"))
    sonar = SonarNoise(range_std_relative=0.01, range_std_floor_in=0.05, dead=(5,))
    simulation.add_robot(1, setup=replace(NOISY, sonar=sonar))
    time = Time()

    def opens() -> Backend:
        return NserverBackend(MemoryStream(InProcess(Emulator(simulation))))

    found = findings_of(Diagnostics(opens, time.clock, time.sleep).run())
    assert {what: grade for what, (grade, _) in found.items() if grade != "OK"} == {"sonar 5": "FAIL"}
