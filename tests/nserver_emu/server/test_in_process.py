"""The emulator without a socket: time passes with each exchange; addresses are read strictly."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nclient.errors import AddressError, StartError, WorldFileError
from nclient.protocol import types
from nserver_emu.server.inprocess import OPTIONS, InProcess, open_address
from nserver_emu.simulation import sonar
from nserver_emu.simulation.segments import PS_PER_S
from tests.nserver_emu.server.wire_client import WireClient
from worlds.robots import BODIES


def connected(address: str) -> tuple[WireClient, InProcess]:
    end = open_address(address)

    def exchange(data: bytes) -> bytes:
        end.send(data)
        return end.receive()

    client = WireClient(exchange)
    client.ask("connect_robot", 1, 1)
    return client, end


def test_each_exchange_takes_its_step_of_simulated_time() -> None:
    client, _ = connected("sim:thesis_room?step_s=0.25")
    assert client.ask("sim_truth").values[1] == 0
    # A step of 0.25 s per request; sim_truth does not take one.
    assert [client.ask("gs").clock for _ in range(3)] == [250, 500, 750]
    assert client.ask("sim_truth").values[1] == 750


def test_state_shows_that_time_moves_only_with_the_client() -> None:
    client, _ = connected("sim:")
    assert client.ask("gs").slots[0] == 0


def test_a_later_answer_comes_in_the_same_exchange() -> None:
    client, _ = connected("sim:")
    client.ask("sp", 100, 450, 450)
    client.ask("pr", 100, 0, 0)
    # Within one exchange the reply of ws is waited for in steps of simulated time.
    reply = client.ask("ws", 1, 1, 1, 30)
    assert reply.slots[38] == 0
    assert reply.slots[34] == 100
    assert reply.clock is not None
    # 10 in at 10 in/s take 1 s, plus the steps before and after.
    assert 1000 < reply.clock < 1500


def test_a_run_depends_on_the_seed_only() -> None:
    def run(seed: int) -> list[tuple[int, ...]]:
        client, _ = connected(f"sim:thesis_room?noisy=1&seed={seed}&start=10,10,30,0")
        client.ask("vm", 50, 100, 0)
        return [tuple(client.ask("gs").slots.values()) for _ in range(30)] + [client.ask("sim_truth").values]

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_the_start_is_taken_from_the_address() -> None:
    client, _ = connected("sim:thesis_room?start=-1,20,90")
    assert client.ask("get_rc").slots == {34: -10, 35: 200, 36: 900, 37: 0}


def test_closing_stops_the_robot() -> None:
    client, end = connected("sim:")
    client.ask("vm", 50, 0, 0)
    end.close()
    assert end.emulator.simulation.robots[1].moving == (False, False, False)
    # A gs request (type 000f, no words) after the end gets no reply.
    end.send(b"\x00\x0f\x00\x00")
    assert end.receive() == b""


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("sim:?sed=1", "did you mean seed"),
        ("sim:?colour=1", "There are robot, robots"),
        ("sim:?seed=x", "seed is a whole number"),
        ("sim:?noisy=maybe", "noisy is 1 or 0"),
        ("sim:?step_s=0", "step_s is 0.001 to 10"),
        ("sim:?step_s=long", "step_s is 0.001 to 10"),
        ("sim:?robot=r2d2", "no robot model 'r2d2'"),
        ("sim:?robots=0", "robots is a whole number from 1 to 1000, not '0'"),
        ("sim:?robots=two", "robots is a whole number"),
        ("sim:?robots=1001", "robots is a whole number"),
        ("sim:?seed=1&seed=2", "seed is given 2 times; expected once"),
        ("sim:?start=1", "a start is X,Y,STEER,TURRET"),
        ("sim:?start=a,b", "a start is X,Y,STEER,TURRET"),
        ("sim:?start=nan,0", "a start is X,Y,STEER,TURRET"),
    ],
)
def test_a_bad_address_names_the_wrong_part(address: str, words: str) -> None:
    with pytest.raises(AddressError, match=words):
        open_address(address)


def test_a_missing_world_or_obstructed_start_is_an_error() -> None:
    with pytest.raises(WorldFileError, match="thesis_room"):
        open_address("sim:thesis_rom")
    with pytest.raises(StartError):
        open_address("sim:thesis_room?start=-12,0")


def test_a_world_file_of_ones_own(tmp_path: Path) -> None:
    world = tmp_path / "hall.toml"
    world.write_text('name = "hall"\n[[room]]\ncorners_m = [[-2, -2], [2, -2], [2, 2], [-2, 2]]\n')
    client, _ = connected(f"sim:{world}")
    # A square room of 4 m: 2 m to the wall, minus the ring's radius of 9.06 in.
    assert client.ask("gs").slots[17] == round(2 / 0.0254 - 9.06)


def test_the_client_controls_the_time() -> None:
    client, _ = connected("sim:?step_s=0.1")
    client.ask("vm", 10, 0, 0)
    # Verb 1 pauses: marker, clock in ms, speed (0 in lockstep), paused. 4 steps by milliseconds.
    assert client.ask("sim_control", 1, 0).values == (1, 100, 0, 1)
    assert client.ask("gs").clock == 100
    assert client.ask("sim_control", 4, 50).values == (1, 150, 0, 1)
    assert client.ask("gs").clock == 150


def test_a_setup_can_be_named_and_counts_before_noisy() -> None:
    # A named setup is used even with noisy=1.
    for options, setup in (("setup=measured", "measured"), ("noisy=1&setup=ideal", "ideal"), ("noisy=1", "noisy")):
        assert open_address(f"sim:?{options}").emulator.simulation.robots[1].setup.name == setup
    with pytest.raises(AddressError, match=r"'perfect'.* ideal, noisy, measured, building, worn"):
        open_address("sim:?setup=perfect")


def test_a_setup_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "half deaf.toml"
    path.write_text("[sonar]\ndead = [0, 8]\n", encoding="utf-8")
    client, _ = connected(f"sim:?setup={path}")
    # Slots 17 and 25 are the sonars 0 and 8.
    slots = client.ask("gs").slots
    assert (slots[17], slots[25]) == (0, 0)
    assert slots[18] > 0
    with pytest.raises(WorldFileError, match=r"nowhere\.toml: .*be read"):
        open_address("sim:?setup=nowhere.toml")


def test_each_address_has_its_own_world_and_robots() -> None:
    client, end = connected("sim:?robots=2&start=0,0&start=60,0")
    alone, _ = connected("sim:")
    robots = end.emulator.simulation.robots
    assert list(robots) == [1, 2]
    assert robots[2].actual[:2] == (60.0, 0.0)
    for _ in range(10):
        seen = client.ask("gs").slots
    # Robot 2 is 60 in ahead: its radius is 9.72 in, the sonar ring's 9.06 in.
    assert (seen[17], alone.ask("gs").slots[17]) == (round(60.0 - 9.72 - 9.06), 93)
    assert client.ask("get_rpx").values[0] == 2
    assert client.ask("create_robot", 3, 1).values != (0,)
    assert client.ask("get_rpx").values[0] == 3
    assert alone.ask("get_rpx").values[0] == 1


def test_models_and_models_of_a_file_for_each(tmp_path: Path) -> None:
    path = tmp_path / "models.toml"
    path.write_text('[[model]]\nname = "small"\nlike = "n200"\nradius_in = 6\n', encoding="utf-8")
    end = open_address(f"sim:?robot=n200&robot=small&robots=3&model_file={path}")
    assert [robot.model.name for robot in end.emulator.simulation.robots.values()] == ["n200", "small", "small"]


def test_the_ring_starts_in_the_order_that_clients_count_on() -> None:
    for body in BODIES.values():
        assert body.ring.firing == tuple((number,) for number in types.DEFAULT_SONAR_ORDER)
        assert body.ring.interval_s == types.DEFAULT_SONAR_RATE * types.SONAR_RATE_STEP_S
    assert pytest.approx(types.SONAR_RATE_STEP_S) == sonar.TICK_PS / PS_PER_S


@pytest.mark.parametrize(("name", "args"), [("ws", (1, 1, 1, 5)), ("zr", ())])
def test_waiting_while_paused_is_refused(name: str, args: tuple[int, ...]) -> None:
    # Steering and turret at 90 deg: zr has something to do.
    client, _ = connected("sim:")
    client.ask("place_robot", 0, 0, 900, 900)
    client.ask("vm", 0, 100, 0)
    client.ask("sim_control", 1, 0)
    assert client.ask(name, *args).values == (5,)
    assert client.ask("gs").kind == "state"
    client.ask("sim_control", 2, 0)
    assert client.ask("ws", 1, 1, 1, 1).kind == "state"


def test_the_documented_options_are_complete() -> None:
    # The page lists the options once; each is accepted as an option, and "~" is an invalid value for each.
    page = (Path(__file__).parents[3] / "docs" / "addresses.md").read_text()
    (listed,) = re.findall(r"^\| `sim:WORLD` \|.*options of its own besides \(([^)]*)\)", page, re.MULTILINE)
    assert tuple(listed.split(", ")) == OPTIONS
    with pytest.raises(AddressError) as refused:
        open_address("sim:?nothing=1")
    assert str(refused.value).endswith(f" There are {', '.join(OPTIONS)}.")
    for name in OPTIONS:
        with pytest.raises((AddressError, StartError, WorldFileError)) as caught:
            open_address(f"sim:?{name}=~")
        assert "no option" not in str(caught.value)
