"""A serial cable on a clock by hand: ten bits a byte, whatever the alarms do."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nserver_emu.server.serial_session import (
    MAX_COMPENSATED_S,
    MAX_IN_TRANSIT,
    PIECE_BYTES,
    Arrival,
    RateLimitedChannel,
)

BAUD = 38400
BYTE_S = 10 / BAUD


def all_arrived(cable: RateLimitedChannel, now_s: float) -> list[Arrival]:
    found = []
    while arrival := cable.arrived(now_s):
        found.append(arrival)
    return found


def test_bytes_take_ten_bits_each_and_come_out_on_the_other_side() -> None:
    cable = RateLimitedChannel(BAUD)
    assert cable.due_s is None
    cable.to_robot(b"gs", 100.0)
    assert cable.due_s == pytest.approx(100.0 + 2 * BYTE_S)
    assert cable.arrived(100.0 + 1.9 * BYTE_S) is None
    arrival = cable.arrived(100.0 + 2.1 * BYTE_S)
    assert arrival is not None
    assert (arrival.data, arrival.to_robot) == (b"gs", True)
    assert arrival.at_s == pytest.approx(100.0 + 2 * BYTE_S)
    assert cable.due_s is None


def test_directions_are_independent_and_bytes_queue() -> None:
    cable = RateLimitedChannel(BAUD)
    cable.to_robot(bytes(10), 0.0)
    cable.to_robot(b"x", 0.0)
    cable.to_host(b"answer", 0.0)
    assert [(round(arrival.at_s / BYTE_S), arrival.data, arrival.to_robot) for arrival in all_arrived(cable, 1.0)] == [
        (6, b"answer", False), (10, bytes(10), True), (11, b"x", True)]  # fmt: skip


def test_a_long_answer_comes_piece_by_piece() -> None:
    cable = RateLimitedChannel(BAUD)
    whole = bytes(range(256)) * 2
    cable.to_host(whole, 0.0)
    first_half = all_arrived(cable, 256 * BYTE_S + 1e-9)
    assert b"".join(arrival.data for arrival in first_half) == whole[:256]
    assert {len(arrival.data) for arrival in first_half} == {PIECE_BYTES}
    assert b"".join(arrival.data for arrival in all_arrived(cable, 1.0)) == whole[256:]


@given(st.lists(st.floats(0.0, MAX_COMPENSATED_S / 3), min_size=5, max_size=60))
def test_late_alarms_cost_a_host_that_asks_at_once_nothing(lateness: list[float]) -> None:
    """Requests of 6 bytes, answers of 48: 54 bytes an exchange, and at the end the lateness of the last answer."""
    cable, now_s = RateLimitedChannel(BAUD), 0.0
    for late_s in lateness:
        cable.to_robot(bytes(6), now_s)
        assert cable.due_s is not None
        request = cable.arrived(cable.due_s + late_s)
        assert request is not None
        cable.to_host(bytes(48), request.at_s)
        assert cable.due_s is not None
        now_s = cable.due_s + late_s
        assert cable.arrived(now_s) is not None
    assert now_s == pytest.approx(54 * BYTE_S * len(lateness) + lateness[-1], abs=1e-9)


def test_a_host_that_takes_its_time_gets_nothing_back() -> None:
    cable = RateLimitedChannel(BAUD)
    cable.to_host(b"x", 0.0)
    assert cable.arrived(0.01) is not None
    cable.to_robot(b"y", 5.0)
    assert cable.due_s == pytest.approx(5.0 + BYTE_S)


def test_a_full_channel_drops_replies_and_suspends_reading() -> None:
    cable = RateLimitedChannel(BAUD)
    cable.to_host(bytes(MAX_IN_TRANSIT), 0.0)
    cable.to_host(bytes(48), 0.0)
    assert cable.lost == 48
    full = [cable.full]
    cable.to_robot(bytes(MAX_IN_TRANSIT), 0.0)
    full.append(cable.full)
    arrived = all_arrived(cable, 60.0)
    assert sum(len(arrival.data) for arrival in arrived) == 2 * MAX_IN_TRANSIT
    assert [*full, cable.full] == [False, True, False]
