"""A simulated serial line and its simulation answer on one connection."""

from __future__ import annotations

import pytest

from nclient import AddressError, ConnectionLost, RobotRefused, connect
from nclient.connector import Connector
from nclient.protocol.commands import Call
from nclient.transports.stream import open_in_process
from nclient.url import parse_address


def test_the_simulation_answers_only_its_own_commands() -> None:
    with connect("sim:thesis_room?line=1&seed=4&noisy=1&start=10,20,0,0&step_s=0.05") as robot:
        assert robot.is_simulated()
        first = robot.refresh()
        truth = robot.truth()
        assert (truth.x_in, truth.y_in, truth.seed) == (10, 20, 4)
        # Commands of the simulation take no simulated time, so that both clocks agree.
        assert truth.time_s == pytest.approx(first.clock_s, abs=1e-6)
        assert robot.refresh().raw_stamps == {}
        assert robot.link is not None
        assert robot.link.exchanges >= 2


def test_a_run_on_a_line_equals_one_over_tcp() -> None:
    def run(line: int) -> list[tuple[float, float, tuple[int, ...]]]:
        with connect(f"sim:thesis_room?line={line}&seed=4&noisy=1") as robot:
            robot.refresh()
            robot.drive(translation_in_s=5, steering_deg_s=10)
            states = [robot.refresh() for _ in range(20)]
            return [(state.x_in, state.y_in, state.sonars_in) for state in states]

    # Same seed and same commands: the two protocols must not change the order of random numbers.
    assert run(1) == run(0)


def test_server_commands_are_refused_on_a_line() -> None:
    with connect("sim:thesis_room?line=1") as robot, pytest.raises(RobotRefused):
        robot.add_obstacle(corners_in=[(30, 30), (40, 30), (40, 40)])


def test_closing_closes_line_and_simulation() -> None:
    backend = Connector(parse_address("sim:thesis_room?line=1")).open()
    backend.execute(Call("sim_truth"))
    backend.close()
    for call in (Call("sim_truth"), Call("gs")):
        with pytest.raises(ConnectionLost):
            backend.execute(call)


def test_the_wire_of_a_simulated_line_is_serial() -> None:
    assert parse_address("sim:thesis_room?line=1").wire == "serial"
    assert parse_address("sim:thesis_room?line=0").wire == "tcp"


def test_a_tcp_peer_has_no_simulation_stream() -> None:
    stream = open_in_process("sim", "sim:thesis_room")
    with pytest.raises(AddressError, match="leave line=1 out"):
        stream.beside()
