"""Effects of each command on a simulated N150, in wire units and simulated time."""

from __future__ import annotations

import math

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import COMMANDS, Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, Mask, Position
from nserver_emu.server.handlers.table import HANDLERS, Emulator
from nserver_emu.server.session import Session
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.world import StartPose


@pytest.fixture
def emulator() -> Emulator:
    return Emulator(simulation(), port=7019)


@pytest.fixture
def client(emulator: Emulator) -> WireClient:
    return meet(emulator)[0]


ARGUMENTS: dict[str, tuple[object, ...]] = {
    "ct": EVERYTHING.smask,
    "tk": ("hello",),
    "special_request": (200, 1, 2),
    "motion_check": (0, 1000, 1000, 2000, 2000),
    **dict.fromkeys(("add_obstacle", "delete_obstacle"), (3, 400, 400, 500, 400, 400, 500)),
    "move_obstacle": (3, 400, 400, 500, 400, 400, 500, 5, 5),
}


def arguments(row: Command) -> tuple[int, ...]:
    return ARGUMENTS.get(row.name, (0,) * len(row.arguments))  # type: ignore[return-value]  # tk has a text


TESTED_ON_THEIR_OWN = ("zr", "connect_robot")
"""Answered later, and answered before anything else."""
ANSWERED_AT_ONCE = [r for r in COMMANDS if r.has_tcp_reply and r.tcp_type and r.name not in TESTED_ON_THEIR_OWN]


# Error codes: 2 wrong values, 4 not available, 5 refused.
REFUSALS = {
    **dict.fromkeys(("special_request", "arm_zr", "arm_ws", "arm_mv", "real_robot"), 4),
    **dict.fromkeys(("conf_ir", "get_ir", "conf_ls", "get_ls", "conf_sg", "get_sg"), 4),
    **dict.fromkeys(("delete_obstacle", "move_obstacle"), 2),
    **dict.fromkeys(("quit_server", "sim_control"), 5),
}
"""Commands that a plain N150 lacks, and their error codes."""


@pytest.mark.parametrize("row", ANSWERED_AT_ONCE, ids=lambda row: row.name)
def test_every_command_gets_a_reply_or_an_error(row: Command, client: WireClient) -> None:
    reply = client.ask(row.name, *arguments(row))
    code = REFUSALS.get(row.name, 0 if row.name in HANDLERS else 4)
    if code:
        assert (reply.kind, reply.values) == ("error", (code,))
    else:
        assert reply.kind == row.tcp_reply.kind


def test_connect_returns_the_port_or_0_without_a_robot(emulator: Emulator) -> None:
    session = Session(emulator.answer)

    def exchange(data: bytes) -> bytes:
        session.receive(data)
        return session.process_requests(9)

    client = WireClient(exchange)
    # 0: there is no robot 9, and the connection has none; its requests get error 3.
    assert client.ask("connect_robot", 9, 1).values == (0,)
    assert client.ask("gs").values == (3,)
    assert client.ask("connect_robot", 1, 1).values == (7019,)
    assert client.ask("gs").kind == "state"


def test_a_fresh_robot_stands_at_its_start_and_shows_rest(client: WireClient) -> None:
    slots = client.ask("gs").slots
    # Speed 1.0 as 10 tenths; bumpers, pose, velocities and motors (slots 33 to 41) at 0.
    assert slots[0] == 10
    assert [slots[k] for k in range(33, 42)] == [0] * 9
    assert all(6 <= slots[k] <= 255 for k in range(17, 33))


def test_vm_shows_a_velocity_at_once_and_none_after_st(emulator: Emulator, client: WireClient) -> None:
    # Motor bits 3: translation (bit 0) and steering (bit 1) move.
    slots = client.ask("vm", 100, -50, 0).slots
    assert [slots[k] for k in (38, 39, 40, 41)] == [100, -50, 0, 3]
    emulator.simulation.step(1.0)
    slots = client.ask("gs").slots
    # -5 deg as a heading of 0..3599. The arc of 10 in turns by 5 deg only, so its chord is nearly as long.
    assert slots[36] == 3600 - 50
    assert slots[37] == 0
    assert math.hypot(slots[34], slots[35]) == pytest.approx(100, abs=1)
    slots = client.ask("st").slots
    assert [slots[k] for k in (38, 39, 40, 41)] == [0, 0, 0, 0]


def test_a_noisy_robot_ramps_but_reports_a_velocity_at_once() -> None:
    noisy, _ = meet(Emulator(simulation(noisy=True)))
    slots = noisy.ask("vm", 100, 0, 0).slots
    assert 0 < slots[38] < 100
    assert slots[41] == 1


def test_pr_moves_exactly_its_distance_at_the_speed_of_sp(emulator: Emulator, client: WireClient) -> None:
    # 10 in at 5 in/s and 90 deg at 45 deg/s both take 2 s.
    client.ask("sp", 50, 450, 450)
    client.ask("pr", 100, 900, -900)
    emulator.simulation.step(1.0)
    assert client.ask("get_rv").slots == {38: 50, 39: 450, 40: -450}
    # 2.01 s in total: all axes have stopped, as there are no ramps.
    emulator.simulation.step(1.01)
    assert client.ask("get_rv").slots == {38: 0, 39: 0, 40: 0}
    assert [client.ask("get_rc").slots[k] for k in (36, 37)] == [900, 2700]


def test_pa_turns_the_shorter_direction(emulator: Emulator, client: WireClient) -> None:
    # 1. The wheels have rolled 6 in, and the steering encoder is set to 180 deg.
    client.ask("pr", 60, 0, 0)
    emulator.simulation.step(2.0)
    client.ask("da", 1800, 0)
    # 2. To a total of 10 in, steering by +10 deg to 190, turret by -10 deg to 350.
    assert client.ask("pa", 100, 1900, 3500).slots[41] == 7
    emulator.simulation.step(5.0)
    slots = client.ask("gs").slots
    assert (slots[36], slots[37], slots[41]) == (1900, 3500, 0)
    # 3. Translation returns to the count at power-on; the angles stay.
    client.ask("pa", 0, 1900, 3500)
    emulator.simulation.step(5.0)
    counts = emulator.simulation.robots[1].counts
    assert counts[0] == pytest.approx(0.0, abs=1e-9)
    assert math.degrees(counts[1]) == pytest.approx(10.0)
    # 4. At the targets already: no axis moves.
    assert client.ask("pa", 0, 1900, 3500).slots[41] == 0


def test_get_ra_returns_accelerations_in_velocity_slots() -> None:
    emulator = Emulator(simulation(noisy=True))
    client, _ = meet(emulator)
    # A noisy robot ramps; get_ra has the accelerations in the slots of the velocities, with the sign of the motion.
    client.ask("ac", 100, 200, 300)
    client.ask("vm", 100, -100, 100)
    assert client.ask("get_ra").slots == {38: 100, 39: -200, 40: 300}
    emulator.simulation.step(5.0)
    assert client.ask("get_ra").slots == {38: 0, 39: 0, 40: 0}


def test_mv_commands_each_axis_in_its_own_mode(emulator: Emulator, client: WireClient) -> None:
    # Modes of mv: 0 leave, 1 velocity, 2 distance, 4 acceleration, 5 speed. Steering turns 10 deg at 10 deg/s.
    client.ask("mv", 1, 100, 5, 100, 0, 0)
    client.ask("mv", 0, 0, 2, 100, 0, 0)
    emulator.simulation.step(0.5)
    assert client.ask("get_rv").slots == {38: 100, 39: 100, 40: 0}
    emulator.simulation.step(0.51)
    assert client.ask("get_rv").slots == {38: 100, 39: 0, 40: 0}


def test_mv_in_a_mode_that_clients_refuse_moves_nothing(client: WireClient) -> None:
    # Mode 6 does not exist; the valid mode of the translation must have no effect either.
    assert client.ask("mv", 1, 100, 6, 0, 0, 0).values == (2,)
    assert client.ask("get_rv").slots == {38: 0, 39: 0, 40: 0}


def test_lp_lets_go(client: WireClient) -> None:
    client.ask("vm", 100, 0, 0)
    assert client.ask("lp").slots[41] == 0


def test_ac_is_taken_and_has_its_effect_where_the_setup_ramps() -> None:
    emulator = Emulator(simulation(noisy=True))
    client, _ = meet(emulator)
    # 5 in/s^2: after 1 s half of the 10 in/s are reached.
    client.ask("ac", 50, 500, 500)
    client.ask("vm", 100, 0, 0)
    emulator.simulation.step(1.0)
    assert client.ask("get_rv").slots[38] == 50


def test_ws_answers_when_the_named_axes_are_still(emulator: Emulator) -> None:
    client, session = meet(emulator)
    # 10 in at 10 in/s: still moving after 0.9 s, at rest after 1.1 s.
    client.ask("sp", 100, 450, 450)
    client.ask("pr", 100, 0, 0)
    assert client.send("ws", codec.encode_tcp_request(Call("ws", (1, 1, 1, 20)))) == []
    emulator.simulation.step(0.9)
    assert session.tick() == b""
    emulator.simulation.step(0.2)
    assert session.tick() != b""
    assert client.ask("ws", 1, 1, 1, 20).kind == "state"


def test_ws_answers_after_its_timeout_without_stopping_anything(emulator: Emulator) -> None:
    client, session = meet(emulator)
    client.ask("vm", 20, 0, 0)
    # Only steering and turret are selected, and they are at rest.
    assert client.ask("ws", 0, 1, 1, 9).slots[38] == 20
    # Translation never stops: the reply comes after 2 s.
    client.send("ws", codec.encode_tcp_request(Call("ws", (1, 0, 0, 2))))
    emulator.simulation.step(1.9)
    assert session.tick() == b""
    emulator.simulation.step(0.2)
    assert session.tick() != b""
    assert client.ask("get_rv").slots[38] == 20


def test_zr_replies_at_zero_with_all_encoders_zero(emulator: Emulator) -> None:
    client, session = meet(emulator)
    client.ask("pr", 100, 900, 450)
    emulator.simulation.step(5.0)
    assert client.send("zr", codec.encode_tcp_request(Call("zr"))) == []
    for _ in range(100):
        emulator.simulation.step(0.1)
        if session.tick():
            break
    assert client.ask("get_rc").slots == {34: 0, 35: 0, 36: 0, 37: 0}


def test_dp_and_da_set_encoders_but_do_not_move_the_robot(client: WireClient) -> None:
    sonars = client.ask("get_sn").slots
    client.ask("dp", -1234, 5678)
    client.ask("da", 900, -1800)
    # Headings from 0 to 3599: -1800 is 1800.
    assert client.ask("get_rc").slots == {34: -1234, 35: 5678, 36: 900, 37: 1800}
    assert client.ask("get_sn").slots == sonars
    assert client.ask("sim_truth").values[2:6] == (0, 0, 0, 0)


def test_place_robot_moves_both_robots(client: WireClient) -> None:
    assert client.ask("place_robot", 100, 200, 900, 450).kind == "simple"
    assert client.ask("get_rc").slots == {34: 100, 35: 200, 36: 900, 37: 450}
    assert client.ask("sim_truth").values[2:6] == (10_000, 20_000, 90_000, 45_000)


def test_place_robot_into_a_wall_is_refused_and_moves_nothing(client: WireClient) -> None:
    assert client.ask("place_robot", -120, 0, 0, 0).values == (2,)
    assert client.ask("get_rc").slots[34] == 0


def test_conf_tm_stops_the_motion_when_no_command_comes(emulator: Emulator, client: WireClient) -> None:
    client.ask("conf_tm", 2)
    client.ask("vm", 10, 0, 0)
    # Each query restarts the timeout of 2 s.
    for _ in range(3):
        emulator.simulation.step(1.9)
        assert client.ask("get_rv").slots[38] == 10
    emulator.simulation.step(2.1)
    assert client.ask("get_rv").slots[38] == 0


def test_a_command_that_is_not_there_yet_feeds_the_time_out_too(emulator: Emulator, client: WireClient) -> None:
    client.ask("conf_tm", 2)
    # A command without effect counts as one, too.
    client.ask("vm", 10, 0, 0)
    for _ in range(3):
        emulator.simulation.step(1.9)
        client.ask("refresh_all")
    assert client.ask("get_rv").slots[38] == 10


def test_sonars_fire_in_the_order_and_at_the_rate_of_conf_sn(emulator: Emulator, client: WireClient) -> None:
    # Rate 10 is 40 ms; sonars 3 and 5 in turn, 255 ends the order. Sonar 3 fires at 0 ms, before the robot is placed.
    client.ask("conf_sn", 10, 3, 5, 255, *[0] * 13)
    before = client.ask("get_sn").slots
    emulator.simulation.robots[1].place(30.0, 20.0, 0.0, 0.0)
    # At 50 ms sonar 5 has fired (40 ms), at 90 ms sonar 3 again (80 ms).
    emulator.simulation.step(0.05)
    once = client.ask("get_sn").slots
    emulator.simulation.step(0.04)
    twice = client.ask("get_sn").slots
    assert {slot for slot in before if once[slot] != before[slot]} == {17 + 5}
    assert {slot for slot in before if twice[slot] != before[slot]} == {17 + 3, 17 + 5}


@pytest.mark.long
@pytest.mark.parametrize(
    ("args", "like"),
    [
        # Sonar numbers that do not exist end the order, as 255 does; the rate is clamped to 1..255.
        ((15, 3, 16, *[0] * 14), (15, 3, *[255] * 15)),
        ((15, 3, -1, *[0] * 14), (15, 3, *[255] * 15)),
        ((0, *range(16)), (1, *range(16))),
        ((-7, *range(16)), (1, *range(16))),
        ((100_000, *range(16)), (255, *range(16))),
    ],
)
def test_conf_sn_takes_of_what_no_ring_has_what_it_can(args: tuple[int, ...], like: tuple[int, ...]) -> None:
    def replies_to(numbers: tuple[int, ...]) -> list[Reply]:
        emulator = Emulator(simulation())
        client, _ = meet(emulator)
        client.ask("ct", *EVERYTHING.with_position(Position.SONAR).smask)
        client.ask("vm", 100, 0, 100)
        replies = [client.ask("conf_sn", *numbers)]
        for _ in range(30):
            emulator.pass_time(0.11)
            replies.append(client.ask("gs"))
        return replies

    assert replies_to(args) == replies_to(like)
    assert replies_to(args)[0].kind == "state"


def test_a_masked_slot_repeats_the_last_value_sent(emulator: Emulator, client: WireClient) -> None:
    # Excluded: position data (0), sonar 3 (slot 20) and x (slot 34).
    no_sonar_3 = Mask(tuple(0 if slot in (0, 20, 34) else 1 for slot in range(44)))
    first = client.ask("gs").slots
    client.ask("ct", *no_sonar_3.smask)
    client.ask("place_robot", 300, 400, 900, 0)
    client.ask("conf_sn", 1, *range(16))
    emulator.simulation.step(0.1)
    slots = client.ask("gs").slots
    assert slots[20] == first[20]
    assert slots[34] == first[34]
    assert slots[35] == 400
    assert [slots[k] for k in (17, 18, 19)] != [first[k] for k in (17, 18, 19)]
    # A new connection was sent nothing yet: its excluded slots are 0.
    other, _ = meet(emulator)
    assert other.ask("ct", *no_sonar_3.smask).slots[20] == 0


def test_position_data_comes_with_the_reading_at_its_own_instant(emulator: Emulator, client: WireClient) -> None:
    reply = client.ask("ct", *EVERYTHING.with_position(Position.SONAR | Position.BUMPER).smask)
    assert set(reply.stamps) == {f"sonar_{i}" for i in range(16)} | {"bumper"}
    client.ask("vm", 100, 0, 0)
    # Rate 15 is 60 ms, at 10 in/s 0.6 in: each stamp has the pose of its own ping.
    client.ask("conf_sn", 15, *range(16))
    emulator.simulation.step(0.3)
    stamps = client.ask("get_sn").stamps
    assert [stamps[f"sonar_{k}"].x for k in range(5)] == [0, 6, 12, 18, 24]
    assert [stamps[f"sonar_{k}"].sensor_time for k in range(5)] == [0, 60, 120, 180, 240]
    assert stamps["sonar_4"].v_trans == 100
    # Bumpers are read at the request: 0.3 s, 3 in.
    assert client.ask("get_bp").stamps["bumper"].x == 30


def test_the_bumper_that_touches_is_set_and_the_motor_bit_clears() -> None:
    emulator = Emulator(simulation(start=StartPose(0.0, 40.0, math.pi, 0.0)))
    client, _ = meet(emulator)
    client.ask("vm", 100, 0, 0)
    emulator.simulation.step(3.0)
    slots = client.ask("gs").slots
    # Twenty bumpers, 18 deg apart: number 10 is at 180 deg, where the wall is. Steering does not turn the body.
    assert slots[33] == 1 << 10
    assert (slots[38], slots[41]) == (0, 0)
    assert client.ask("get_bp").slots == {33: 1 << 10}
    client.ask("vm", -100, 0, 0)
    emulator.simulation.step(0.5)
    assert client.ask("gs").slots[33] == 0


def test_only_the_robot_of_a_closed_client_stops(emulator: Emulator) -> None:
    first, first_session = meet(emulator)
    second, second_session = meet(emulator)
    first.ask("vm", 100, 0, 0)
    second.ask("vm", 50, 0, 0)
    emulator.on_disconnect(first_session.context)
    assert second.ask("get_rv").slots[38] == 50
    second.send("disconnect_robot", codec.encode_tcp_request(Call("disconnect_robot", (1, 1))))
    assert second_session.closing
    assert first.ask("get_rv").slots[38] == 0


def test_the_truth_names_time_pose_seed_and_robot() -> None:
    emulator = Emulator(simulation(noisy=True, seed=7))
    client, _ = meet(emulator)
    client.ask("vm", 50, 0, 0)
    emulator.simulation.step(4.0)
    reply: Reply = client.ask("sim_truth")
    # Marker, clock in ms, x and y in thousandths of an inch.
    marker, clock, x, y, *_, seed, robot_id = reply.values
    assert (marker, clock, seed, robot_id) == (1, 4000, 7, 1)
    odometry = client.ask("get_rc").slots
    assert (x / 1000, y / 1000) != (odometry[34] / 10, odometry[35] / 10)
    assert abs(x / 1000 - odometry[34] / 10) < 3


def test_encoders_never_leave_their_words(emulator: Emulator, client: WireClient) -> None:
    # Positions are 32-bit words: beyond their range they are clamped, not wrapped.
    client.ask("dp", 2**31 - 1, -(2**31))
    client.ask("vm", 200, 0, 0)
    emulator.simulation.step(1.0)
    assert client.ask("gs").slots[34] == 2**31 - 1
    client.ask("da", 450, 450)
    client.ask("dp", -(2**31), -(2**31))
    client.ask("vm", -200, 0, 0)
    emulator.simulation.step(1.0)
    assert client.ask("get_rc").slots == {34: -(2**31), 35: -(2**31), 36: 450, 37: 450}


# The clock is a word of milliseconds: 2^31 ms are 24.86 days, 2^32 ms are 49.71 days.
@pytest.mark.parametrize("days", [24.9, 49.8, 400.0])
def test_the_clock_goes_round_like_its_word(days: float, emulator: Emulator, client: WireClient) -> None:
    emulator.simulation.robots.clear()
    emulator.simulation.step(days * 86400)
    emulator.simulation.add_robot(1)
    assert client.ask("gs").clock == round(days * 86_400_000) % 2**32
    assert client.ask("get_bp").clock == round(days * 86_400_000) % 2**32
    assert client.ask("sim_truth").values[1] % 2**32 == round(days * 86_400_000) % 2**32


def test_only_the_axes_of_a_closed_client_stop(emulator: Emulator) -> None:
    driver, driver_session = meet(emulator)
    helper, helper_session = meet(emulator)
    driver.ask("vm", 50, 0, 20)
    # Modes 4 and 5 are settings, so the helper owns no axis.
    helper.ask("mv", 5, 100, 4, 300, 0, 0)
    emulator.on_disconnect(helper_session.context)
    assert driver.ask("get_rv").slots == {38: 50, 39: 0, 40: 20}
    steerer, _ = meet(emulator)
    steerer.ask("mv", 0, 0, 1, 30, 0, 0)
    emulator.on_disconnect(driver_session.context)
    assert steerer.ask("get_rv").slots == {38: 0, 39: 30, 40: 0}


def test_the_answers_to_questions_count_as_sent_too(client: WireClient) -> None:
    nothing = Mask((0,) * 44)
    # A mask without any slot: all replies repeat what was sent last.
    client.ask("ct", *nothing.smask)
    client.ask("dp", 70, 80)
    assert client.ask("gs").slots[34] == 0
    # get_sn and get_rc ignore the mask, and what they send counts as sent.
    sonars = client.ask("get_sn").slots
    client.ask("get_rc")
    slots = client.ask("gs").slots
    assert {slot: slots[slot] for slot in sonars} == sonars
    assert (slots[34], slots[35]) == (70, 80)


def test_a_connection_keeps_its_robot_when_another_is_not_there(client: WireClient) -> None:
    assert client.ask("connect_robot", 2, 1).values == (0,)
    assert client.ask("gs").kind == "state"


def test_asking_for_the_truth_keeps_no_robot_moving(emulator: Emulator, client: WireClient) -> None:
    client.ask("conf_tm", 1)
    client.ask("vm", 50, 0, 0)
    # 1.6 s with sim_truth every 0.4 s: the timeout of 1 s is over.
    for _ in range(4):
        emulator.pass_time(0.4)
        client.ask("sim_truth")
    assert client.ask("get_rv").slots[38] == 0
