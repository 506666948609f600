"""Any values of any command: an answer that can be sent, and a robot that still answers, never an internal error."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.commands import COMMANDS, Call
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed, clock_ms
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import NOISY
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import ORIGIN, meet
from worlds.world import World

EDGES = (0, 1, -1, 2, 3, 10, 3600, 32767, -32768, 10**6, 2**31 - 1, -(2**31))
WORD = st.one_of(st.sampled_from(EDGES), st.integers(-(2**31), 2**31 - 1), st.integers(-300, 300))
OVER_TCP = [row for row in COMMANDS if row.tcp_type is not None and row.has_tcp_reply and row.packet_type is None]


@st.composite
def requests(draw: st.DrawFn) -> bytes:
    """A request of the table with any words that its layout takes."""
    row = draw(st.sampled_from(OVER_TCP))
    fewest, most = row.tcp_words
    words = draw(st.lists(WORD, min_size=fewest, max_size=min(most, fewest + 20)))
    head = row.tcp_type.to_bytes(2, "big") + len(words).to_bytes(2, "big")  # type: ignore[union-attr]
    return head + b"".join(word.to_bytes(4, "big", signed=True) for word in words)


def open_field(model: str) -> Emulator:
    """A robot where nothing stands and nothing ends."""
    simulation = Simulation(World("field"))
    simulation.add_robot(1, ORIGIN, MODELS[model], NOISY)
    return Emulator(simulation, allowed=Allowed(quit=True, control=True))


@pytest.mark.parametrize("model", sorted(MODELS))
@given(asked=st.lists(requests(), max_size=12))
@settings(max_examples=40)
def test_whatever_is_asked_is_answered_and_the_robot_goes_on(model: str, asked: list[bytes]) -> None:
    emulator = open_field(model)
    _, session = meet(emulator)
    for data in asked:
        session.receive(data)
        if session.context.robot_id is None:
            break
        session.process_requests(max_requests=1)
        for _ in range(3):
            emulator.simulation.step(0.2)
            session.tick()
        assert not session.closing
    again, _ = meet(emulator)
    assert again.ask("gs").kind == "state"
    assert again.ask("sim_truth").kind == "truth"


def answer(name: str, *args: Any) -> tuple[int, ...]:
    client, _ = meet(open_field("n150"))
    values: tuple[int, ...] = client.ask(name, *args).values
    return values


@pytest.mark.parametrize(
    ("name", "args"),
    [
        ("place_robot", (2**31 - 1, 0, 0, 0)),
        ("add_obstacle", (3, 2**31 - 1, 0, 0, 500, 2**31 - 1, 500)),
    ],
)
def test_what_lies_off_the_map_is_refused(name: str, args: tuple[int, ...]) -> None:
    assert answer(name, *args) == (2,)


def test_an_obstacle_is_not_moved_off_the_map() -> None:
    client, _ = meet(open_field("n150"))
    corners = (3, 900, 900, 999, 900, 900, 999)
    client.ask("add_obstacle", *corners)
    assert client.ask("move_obstacle", *corners, 2**31 - 1, 0).values == (2,)
    assert client.ask("move_obstacle", *corners, 1, 0).values[0] == 3


def test_a_position_beyond_all_bounds_is_clamped() -> None:
    client, _ = meet(open_field("n150"))
    slots = client.ask("dp", 2**31 - 1, -(2**31)).slots
    assert (slots[34], slots[35]) == (2**31 - 1, -(2**31))


@pytest.mark.parametrize("days", [25, 50, 1000])
def test_clocks_go_round_after_their_longest_time(days: int) -> None:
    assert 0 <= clock_ms(86400.0 * days) < 2**32


def test_an_invalid_request_is_no_server_error() -> None:
    with pytest.raises(WireError):
        codec.encode_tcp_request(Call("vm", (2**31, 0, 0)))
