"""The state machine of protocol_machine.py, a few thousand steps of it; `scripts/endurance` runs a million."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from nclient.protocol.commands import Call
from tests.nserver_emu.server.protocol_machine import ProtocolMachine


@pytest.mark.long
def test_the_protocol_holds_its_invariants_for_2000_steps() -> None:
    ProtocolMachine.steps = 0
    run_state_machine_as_test(
        ProtocolMachine,
        settings=settings(
            max_examples=55, stateful_step_count=50, deadline=None, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )  # fmt: skip
    assert ProtocolMachine.steps >= 2000


def test_a_refused_connect_ends_the_wait_for_a_closed_program() -> None:
    # 1. A client moves nothing and closes; its entry stays for a second connection of the same program.
    machine = ProtocolMachine()
    machine.begin(gateway=False, model="n150")
    machine.leave(number=1, how="close", made=Call("gs"))
    # 2. A new connection from the same address is refused its robot.
    machine.connect(number=1, robot=3)  # There is no robot 3: the connection stays, without a robot.
    # 3. After the retention time of 0.2 s a connection without CONNECT finds nothing to continue.
    machine.pass_time(0.3)
    second = machine.open_peer(1)
    second.send(Call("gs"))
    machine.pump()
    assert second.context.robot_id is None
    machine.teardown()
