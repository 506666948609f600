"""The state machine of protocol_machine.py, a few thousand steps of it; `scripts/endurance` runs a million."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

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
