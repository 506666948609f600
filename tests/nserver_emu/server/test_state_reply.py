"""Cost of a state reply: rays are cast only for sensors in the mask, once per time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pytest

from nclient.protocol.types import EVERYTHING, Mask, Position
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.acoustics import Ping
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.sensors import InfraredRing
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise
from tests.nserver_emu.server.wire_client import WireClient, meet
from worlds.io import load_world
from worlds.world import StartPose


@pytest.fixture
def casts(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count the computed sonar echoes and infrared readings."""
    counted: Counter[str] = Counter()
    measure, look = SonarNoise.measured_ranges, InfraredRing._ranges

    def count_pings(model: SonarNoise, pings: Sequence[Ping], *args: object) -> list[float]:
        counted["sonar"] += len(pings)
        return measure(model, pings, *args)  # type: ignore[arg-type]

    def looked(*args: object) -> object:
        counted["infrared"] += 1
        return look(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(SonarNoise, "measured_ranges", count_pings)
    monkeypatch.setattr(InfraredRing, "_ranges", looked)
    return counted


@pytest.fixture
def emulator() -> Emulator:
    made = Simulation(load_world("thesis_room"))
    made.add_robot(1, StartPose(0.0, 0.0, 0.0, 0.0), N200)
    return Emulator(made)


@pytest.fixture
def client(emulator: Emulator) -> WireClient:
    return meet(emulator)[0]


def mask(*slots: int, position: int = 0) -> tuple[int, ...]:
    return Mask((position, *[int(slot in slots) for slot in range(1, 44)])).smask


@pytest.mark.long
@pytest.mark.parametrize(
    ("slots", "cast"),
    [
        (range(34, 44), {}),
        (range(1, 17), {"infrared": 20}),
        (range(17, 33), {"sonar": 20 * 16}),
        (range(1, 33), {"infrared": 20, "sonar": 20 * 16}),
    ],
)
def test_a_mask_pays_for_what_it_shows(
    emulator: Emulator, client: WireClient, casts: Counter[str], slots: range, cast: dict[str, int]
) -> None:
    client.ask("ct", *mask(*slots, position=Position.SONAR | Position.INFRARED))
    casts.clear()
    for _ in range(20):
        emulator.pass_time(1.0)
        client.ask("gs")
    assert casts == cast


def test_connections_with_other_masks_share_the_snapshot(
    emulator: Emulator, client: WireClient, casts: Counter[str]
) -> None:
    emulator.simulation.robots[1].place(300.0, 200.0, 1.0, 2.0)
    whole, _ = meet(emulator)
    client.ask("ct", *mask(17, 34))
    emulator.pass_time(1.0)
    casts.clear()
    blind = client.ask("gs").slots
    assert casts == {"sonar": 16}
    seen = whole.ask("gs").slots
    assert casts == {"sonar": 16, "infrared": 1}
    again = client.ask("gs").slots
    assert casts == {"sonar": 16, "infrared": 1}
    assert again == blind
    assert (blind[17], blind[34]) == (seen[17], seen[34])
    assert (blind[18], blind[35], blind[43]) == (0, 0, 0)
    assert min(seen[18], seen[35], seen[43]) > 0
    client.ask("ct", *EVERYTHING.smask)
    assert client.ask("gs").slots == seen


def test_a_frame_is_sent_again_until_something_changes(emulator: Emulator) -> None:
    client, session = meet(emulator)

    def frame() -> bytes:
        client.ask("gs")
        cached = session.context.cached_state
        assert cached is not None
        return cached.frames["gs"]

    first = frame()
    assert frame() is first
    # A command, and time, make another one; so does what this connection selects.
    client.ask("dp", 100, 0)
    moved = frame()
    assert moved != first
    assert frame() is moved
    emulator.pass_time(0.01)
    later = frame()
    assert later is not moved
    client.ask("ct", *EVERYTHING.with_position(Position.COMPASS).smask)
    assert len(frame()) == len(later) + 36
