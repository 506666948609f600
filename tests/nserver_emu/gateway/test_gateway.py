"""Nserver's clients on a real robot, in one process and without a thread: an emulated one over its own line, a silent
one, one that says NAK, another Nserver."""

from __future__ import annotations

import math

import pytest

from docs.generate.commands import examples
from nclient.backends.wrappers import Capped
from nclient.connect import Wanted, open_backend
from nclient.errors import AddressError, BumperHit, ConnectionLost, ReplyTimeout, RobotRefused
from nclient.protocol import codec
from nclient.protocol.commands import COMMANDS, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, N200
from nserver_emu.gateway.gateway import TIMEOUT_S
from nserver_emu.server.context import Pace
from nserver_emu.simulation.noise import NOISY
from tests.nserver_emu.gateway.real_robots import LINE_STATE, EmulatedLine, House, ScriptedRobot, emulated, line_of
from worlds.world import StartPose

SERVERS = ("quit_server", "simulated_robot")
WATCHING = ("gs", "get_sn", "get_rc", "get_rv", "get_bp", "get_cp")


def on_line(model: str = "n150") -> tuple[House, EmulatedLine]:
    """A gateway to an emulated robot on its own line."""
    line = line_of(emulated(model))
    return House(lambda: line), line


def scripted(**answers: Reply | Exception) -> tuple[House, ScriptedRobot]:
    robot = ScriptedRobot(answers=answers)
    house = House(lambda: robot)
    robot.names()
    return house, robot


def refusal(reply: Reply) -> tuple[int, ...]:
    return reply.values if reply.kind == "error" else ()


def test_the_real_robot_moves_and_the_simulated_one_stands() -> None:
    house, line = on_line()
    guest = house.guest()
    guest.ask("sp", 100, 450, 450)
    first = guest.ask("pr", 240, 0, 900)
    assert first.slots[38] == 100
    reply = guest.ask("ws", 1, 1, 1, 60)
    assert (reply.slots[34], reply.slots[37], reply.slots[38]) == (240, 900, 0)
    real = line.emulator.simulation.robots[1].actual
    assert (real.x_in, math.degrees(real.turret_rad)) == pytest.approx((24.0, 90.0))
    assert house.emulator.simulation.robots[1].actual.x_in == 0.0
    assert reply.slots[0] == 10
    assert reply.slots[33] == 0
    assert reply.clock is not None
    assert reply.volts is not None


def test_questions_have_the_numbers_of_the_real_robot() -> None:
    house, line = on_line()
    guest = house.guest()
    guest.ask("dp", 120, -340)
    guest.ask("da", 100, 200)
    robot = line.emulator.simulation.robots[1]
    for name in WATCHING:
        assert guest.ask(name).kind != "error"
    assert tuple(guest.ask("get_rc").slots.values()) == (120, -340, 100, 200)
    assert tuple(guest.ask("get_sn").slots.values()) == robot.sonar.readings_in
    assert guest.ask("get_robot_conf").values == (120, -340, 100, 200)
    assert guest.ask("place_robot", 50, 60, 70, 80) == Reply("simple", values=(0,))
    assert tuple(guest.ask("get_rc").slots.values()) == (50, 60, 70, 80)
    assert robot.actual.x_in == 0.0


def test_all_commands_are_answered_and_what_the_robot_lacks_is_error_4() -> None:
    for model, lacking in (
        ("n150", {"conf_ir", "get_ir", "conf_cp", "conf_ls", "get_ls", "conf_sg", "get_sg", "pa", "tk", "get_ra",
                  "sim_truth", "sim_control", "arm_zr", "arm_ws", "arm_mv", "special_request"}),
        ("n200", {"get_ra", "sim_truth", "sim_control", "special_request"}),
    ):  # fmt: skip
        house, _ = on_line(model)
        guest = house.guest()
        asked = [row for row in COMMANDS if row.has_tcp_reply and row.tcp_type is not None and row.name not in SERVERS]
        refused = {row.name: refusal(guest.ask(row.name, *examples(row))) for row in asked}
        assert {name for name, code in refused.items() if code == (4,)} == lacking
        world = {"delete_obstacle", "move_obstacle"}  # there is none yet
        assert {name for name, code in refused.items() if code and code != (4,)} <= world


def test_a_nak_is_error_4_and_the_next_one_is_answered() -> None:
    house, robot = scripted(conf_sn=RobotRefused("conf_sn", None))
    guest = house.guest()
    assert refusal(guest.ask("conf_sn", 15, *range(16))) == (4,)
    assert guest.ask("gs").slots[34] == 100
    assert robot.names() == ["conf_sn", "gs"]


def test_a_robot_that_falls_silent_is_error_6_for_all_until_it_answers_again() -> None:
    house, robot = scripted()
    driver, watcher = house.guest(), house.guest()
    driver.ask("vm", 10, 0, 0)
    robot.trouble += [ReplyTimeout("no answer")] * 2
    assert refusal(driver.ask("vm", 20, 0, 0)) == (6,)
    assert refusal(watcher.ask("gs")) == (6,)
    assert refusal(watcher.ask("ws", 1, 1, 1, 10)) == (6,)
    assert watcher.ask("motion_check", 0, 0, 0, 1000, 1000).kind == "simple"
    house.work()
    assert watcher.ask("gs").slots[34] == 100
    assert driver.ask("gs").slots[34] == 100
    assert refusal(watcher.ask("vm", 5, 0, 0)) == (5,)


def test_a_line_that_is_lost_is_opened_again_and_the_robot_stopped_first() -> None:
    robots = [ScriptedRobot(), ScriptedRobot()]
    left = iter(robots)
    house = House(lambda: next(left))
    guest = house.guest()
    robots[0].close()
    assert refusal(guest.ask("gs")) == (6,)
    assert guest.ask("gs").slots[34] == 100
    assert robots[1].names() == ["st", "conf_tm", "gs", "gs"]


def test_one_owner_the_others_watch_and_everybody_may_stop() -> None:
    house, line = on_line()
    driver, watcher = house.guest(), house.guest()
    driver.ask("vm", 50, 0, 0)
    for name, args in (("vm", (10, 0, 0)), ("pr", (10, 0, 0)), ("sp", (1, 1, 1)), ("place_robot", (0, 0, 0, 0))):
        assert refusal(watcher.ask(name, *args)) == (5,)
    assert watcher.ask("gs").slots[38] == 50
    assert watcher.ask("st").slots[38] == 0
    assert driver.ask("vm", 50, 0, 0).slots[38] == 50
    driver.leave()
    house.work()
    assert not any(line.emulator.simulation.robots[1].moving)
    assert watcher.ask("vm", 20, 0, 0).slots[38] == 20


def test_the_owner_lets_go_with_lp() -> None:
    house, _ = on_line()
    driver, other = house.guest(), house.guest()
    driver.ask("vm", 50, 0, 0)
    driver.ask("lp")
    assert other.ask("vm", 20, 0, 0).slots[38] == 20
    assert refusal(driver.ask("vm", 20, 0, 0)) == (5,)


def test_a_watcher_that_leaves_stops_nobody() -> None:
    house, line = on_line()
    driver, watcher = house.guest(), house.guest()
    driver.ask("vm", 50, 0, 0)
    watcher.leave()
    house.work()
    assert line.emulator.simulation.robots[1].moving[0]


def test_read_only_asks_and_changes_nothing() -> None:
    robot = ScriptedRobot()
    house = House(lambda: robot, read_only=True)
    guest = house.guest()
    for name, args in (("vm", (1, 1, 1)), ("conf_tm", (1,)), ("dp", (1, 1)), ("zr", ())):
        assert refusal(guest.ask(name, *args)) == (5,)
    assert guest.ask("gs").slots[34] == 100
    assert guest.ask("simulated_robot").values == (0,)
    house.side.close()
    assert robot.names() == ["gs", "gs"]


def test_read_only_lets_anybody_stop_it() -> None:
    robot = ScriptedRobot()
    house = House(lambda: robot, read_only=True)
    assert house.guest().ask("st").kind == "state"
    assert robot.names() == ["gs", "st"]


def test_the_robot_and_its_shadow_are_capped_alike() -> None:
    line = line_of(emulated())
    house = House(lambda: line, shadow=True, around=lambda backend: Capped(backend, max_speed_in_s=4, max_turn_deg_s=9))
    guest = house.guest()
    assert guest.ask("vm", 100, -200, 50).slots[38] == 40
    simulated = house.emulator.simulation.robots[1]
    for robot in (line.emulator.simulation.robots[1], simulated):
        assert robot.velocities == pytest.approx((4.0, -math.radians(9), math.radians(5)))
    guest.ask("st")
    guest.ask("pr", 240, 0, 0)
    assert simulated.velocities[0] == pytest.approx(4.0)
    assert guest.ask("gs").slots[38] == 40


def test_a_bumper_that_stops_the_robot_is_error_5_and_the_talk_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    house, robot = scripted()
    guest = house.guest()
    robot.trouble.append(BumperHit("gs", (3,)))
    assert refusal(guest.ask("gs")) == (5,)
    assert guest.ask("gs").kind == "state"
    assert "the real robot was stopped" in caplog.text


def test_who_connects_switches_between_the_real_and_the_simulated_robot() -> None:
    house, line = on_line()
    guest, other = house.guest(), house.guest()
    guest.ask("vm", 50, 0, 0)
    assert refusal(other.ask("simulated_robot")) == (5,)
    assert guest.ask("real_robot").values == (0,)
    assert guest.ask("simulated_robot").values == (0,)
    house.work()
    real, simulated = line.emulator.simulation.robots[1], house.emulator.simulation.robots[1]
    assert not any(real.moving)
    assert other.ask("vm", 30, 0, 0).slots[38] == 30
    assert simulated.moving[0]
    assert other.ask("sim_truth").kind == "truth"
    assert guest.ask("real_robot").values == (0,)
    assert not any(simulated.moving)
    assert refusal(guest.ask("sim_truth")) == (4,)
    assert other.ask("vm", 20, 0, 0).slots[38] == 20
    assert real.moving[0]
    assert not simulated.moving[0]


def test_robots_without_a_real_side_and_strangers_are_the_simulations() -> None:
    house, _ = on_line()
    guest = house.guest()
    assert guest.ask("create_robot", 2, 1).values == (1,)
    assert refusal(guest.ask("real_robot")) == (4,)
    assert guest.ask("sim_truth").kind == "truth"


def test_ws_is_asked_for_again_and_again_and_a_stop_comes_between() -> None:
    moving = Reply("state", {**LINE_STATE.slots, 41: 1}, clock=4_294_967_000)
    house, robot = scripted()
    robot.state = moving
    waiter, other = house.guest(), house.guest()
    waiter.session.receive(codec.tcp_request(Call("ws", (1, 0, 0, 1))))
    assert waiter.session.answers(1) == b""
    assert waiter.session.tick() == b""
    house.work()
    assert waiter.session.tick() == b""
    house.now_s += 0.01
    assert waiter.session.tick() == b""
    house.work()
    assert other.ask("st").kind == "state"
    assert robot.names() == ["gs", "st"]
    robot.state = Reply("state", moving.slots, clock=650)  # 946 ms later: the clock began anew
    house.now_s += 1.0
    assert waiter.session.tick() == b""
    house.work()
    assert waiter.session.tick() == b""
    robot.state = Reply("state", moving.slots, clock=704)
    house.now_s += 1.0
    waiter.session.tick()
    house.work()
    (reply,) = waiter.client.read("ws", waiter.session.tick())
    assert (reply.clock, reply.slots[41]) == (704, 1)


def test_ws_waits_for_the_named_axes_only() -> None:
    house, robot = scripted()
    robot.state = Reply("state", {**LINE_STATE.slots, 41: 0b100}, clock=0)
    assert house.guest().ask("ws", 1, 1, 0, 255).slots[41] == 0b100


def test_who_asks_for_the_state_during_zr_gets_the_last_one() -> None:
    house, robot = scripted()
    watcher = house.guest()
    watcher.ask("gs")
    robot.names()
    house.side.robot.saying = "zr"
    watcher.session.receive(codec.tcp_request(Call("gs")))
    (state,) = watcher.client.read("gs", watcher.session.answers(1))
    assert (state.slots[34], state.clock) == (100, 5000)
    assert robot.names() == []


def test_the_time_out_is_the_gateways_until_a_client_sets_one() -> None:
    robot = ScriptedRobot()
    house = House(lambda: robot)
    assert robot.calls == [Call("conf_tm", (5,)), Call("gs")]
    guest, other = house.guest(), house.guest()
    guest.ask("vm", 10, 0, 0)
    robot.names()
    house.gateway.tick()
    house.work()
    assert robot.names() == []
    house.now_s += TIMEOUT_S / 3
    house.gateway.tick()
    house.work()
    assert robot.names() == ["gs"]
    guest.ask("conf_tm", 2)
    assert robot.calls == [Call("conf_tm", (2,))]
    house.now_s += 100
    house.gateway.tick()
    house.work()
    guest.ask("conf_tm", 0)
    assert robot.calls == [Call("conf_tm", (2,)), Call("st"), Call("conf_tm", (5,))]
    guest.ask("conf_tm", 3)
    robot.calls.clear()
    other.leave()
    guest.leave()
    house.work()
    assert robot.calls == [Call("st"), Call("conf_tm", (5,))]
    house.now_s += 100
    house.gateway.tick()
    house.work()
    assert len(robot.calls) == 2


def test_an_owner_gone_dumb_has_a_robot_that_stands_however_much_others_ask() -> None:
    house, line = on_line()
    real = line.emulator.simulation.robots[1]
    owner, watcher = house.guest(), house.guest()
    owner.ask("conf_tm", 2)
    owner.ask("vm", 10, 0, 0)
    watcher.ask("gs")
    assert not real.still((0,))
    for _ in range(50):
        watcher.ask("gs")
        house.gateway.tick()
    house.work()
    assert real.still((0,))


def test_an_owner_gone_dumb_has_its_robot_stopped_however_much_others_ask(caplog: pytest.LogCaptureFixture) -> None:
    house, robot = scripted()
    owner, watcher = house.guest(), house.guest()
    owner.ask("conf_tm", 2)
    owner.ask("vm", 10, 0, 0)
    robot.names()
    for _ in range(50):
        watcher.ask("gs")
        house.gateway.tick()
    house.work()
    assert robot.names().count("st") == 1
    assert caplog.text.count("said nothing for 2 s") == 1
    owner.ask("vm", 10, 0, 0)
    for _ in range(50):
        owner.ask("gs")
        house.gateway.tick()
    robot.state = Reply("state", {**LINE_STATE.slots, 41: 1}, clock=0)
    owner.session.receive(codec.tcp_request(Call("ws", (1, 1, 1, 200))))
    owner.session.answers(1)
    for _ in range(50):
        house.now_s += 0.1
        house.work()
        owner.session.tick()
        house.gateway.tick()
    assert "st" not in robot.names()


@pytest.mark.parametrize(("speed", "fed_after_s"), [(None, 5 / 3), (10, 5 / 3), (100, 5 / 30), (0, None)])
def test_a_robot_is_fed_as_fast_as_its_time_runs(speed: int | None, fed_after_s: float | None) -> None:
    house, robot = scripted()
    robot.state = Reply("state", LINE_STATE.slots if speed is None else {**LINE_STATE.slots, 0: speed}, clock=0)
    guest, asked_s = house.guest(), house.now_s
    guest.ask("vm", 10, 0, 0)
    robot.names()
    while not robot.calls and house.now_s < 10:
        house.now_s += 0.02
        house.gateway.tick()
        house.work()
    if fed_after_s is None:
        assert robot.names() == []
    else:
        assert robot.names() == ["gs"]
        assert house.now_s - asked_s == pytest.approx(fed_after_s, abs=0.04)


def test_position_data_are_asked_for_once_for_all_who_want_them() -> None:
    robot = ScriptedRobot(N200)
    house = House(lambda: robot)
    assert robot.calls == [Call("conf_tm", (5,)), Call("ct", EVERYTHING.smask), Call("gs")]
    one, other = house.guest(), house.guest()
    robot.calls.clear()
    one.ask("ct", *EVERYTHING.with_position(2).smask)
    other.ask("ct", *EVERYTHING.with_position(4).smask)
    one.ask("ct", *EVERYTHING.with_position(2).smask)
    said = [Call("ct", EVERYTHING.with_position(2).smask), Call("ct", EVERYTHING.with_position(6).smask), Call("gs")]
    assert robot.calls == said
    other.leave()
    one.ask("ct", *EVERYTHING.smask)
    assert robot.calls[-1] == Call("ct", EVERYTHING.smask)


def test_stamps_of_another_nserver_come_through() -> None:
    house = House(lambda: open_backend("sim:thesis_room", Wanted()))
    guest = house.guest()
    guest.ask("ct", *EVERYTHING.with_position(2).smask)
    guest.ask("dp", 500, 600)
    guest.ask("vm", 20, 0, 0)
    for _ in range(20):
        reply = guest.ask("gs")
    assert {stamp.y for stamp in reply.stamps.values()} == {600}
    assert refusal(house.guest().ask("sim_truth")) == (4,)
    house.side.close()


def test_the_end_stops_the_robot() -> None:
    house, line = on_line()
    house.guest().ask("vm", 50, 0, 0)
    house.side.close()
    assert not any(line.emulator.simulation.robots[1].moving)
    assert line.closed
    assert refusal(house.guest().ask("gs")) == (6,)


def test_a_simulated_robot_of_another_model_is_refused() -> None:
    with pytest.raises(AddressError, match="is a n200 in the simulation and really a n150"):
        House(ScriptedRobot, emulator=emulated("n200"))


def test_a_robot_that_cannot_be_reached_is_an_error_at_the_start() -> None:
    def nowhere() -> ScriptedRobot:
        raise ConnectionLost("no such port")

    with pytest.raises(ConnectionLost):
        House(nowhere)


def test_a_shadow_does_the_same_and_differs_by_nothing() -> None:
    line = line_of(emulated())
    house = House(lambda: line, emulator=emulated(pace=Pace(lockstep_s=0.1)), shadow=True)
    house.work()
    house.gateway.tick()
    guest = house.guest()
    # what was said to the robot when it was reached took its time, too
    house.emulator.simulation.step(line.emulator.simulation.time_s - house.emulator.simulation.time_s)
    guest.ask("vm", 50, 100, -200)
    for _ in range(30):
        guest.ask("gs")
    guest.ask("get_sn")
    guest.ask("st")
    assert house.side.follower is not None
    shadow = house.side.follower.shadow
    assert shadow.states > 30
    for name, found in shadow.quantities.items():
        assert found.largest == 0, name
    assert house.emulator.simulation.robots[1].actual == line.emulator.simulation.robots[1].actual


def test_a_shadow_begins_where_the_encoders_are_and_tells_a_noisy_robot_apart(caplog: pytest.LogCaptureFixture) -> None:
    line = line_of(emulated(setup=NOISY, start=StartPose(20.0, 20.0, 1.0, 2.0)))
    real = line.emulator.simulation.robots[1]
    real.define_position(-300.0, 200.0)
    house = House(lambda: line, emulator=emulated(), shadow=True)
    house.work()
    guest = house.guest()
    guest.ask("gs")
    encoder = house.emulator.simulation.robots[1].encoder
    assert (encoder.x_in, encoder.y_in) == pytest.approx((-300.0, 200.0))
    assert house.emulator.simulation.robots[1].actual.x_in == 0.0
    guest.ask("place_robot", 600, 600, 0, 0)
    assert house.emulator.simulation.robots[1].actual.x_in == pytest.approx(60.0)
    assert house.side.follower is not None
    assert house.side.follower.shadow.quantities["x_in"].largest == 0.0
    guest.ask("place_robot", 9000, 600, 0, 0)
    assert "shadow: place_robot(9000, 600, 0, 0) in the simulation: place_robot was refused" in caplog.text
    assert house.side.follower.shadow.quantities["x_in"].last == pytest.approx(840.0)


def test_a_shadow_rests_while_the_simulation_is_driven() -> None:
    line = line_of(emulated())
    house = House(lambda: line, shadow=True)
    house.work()
    guest = house.guest()
    assert guest.ask("simulated_robot").values == (0,)
    house.work()
    house.gateway.tick()
    assert house.side.follower is not None
    before = house.side.follower.shadow.states
    guest.ask("gs")
    assert house.side.follower.shadow.states == before


def test_a_shadow_begins_with_the_robot_what_takes_long_and_is_not_waited_for() -> None:
    start = StartPose(0.0, 0.0, 1.0, 2.0)
    line = line_of(emulated(start=start))
    house = House(lambda: line, emulator=emulated(start=start), shadow=True)
    guest = house.guest()
    guest.ask("gs")
    shadow = house.emulator.simulation.robots[1]

    def is_zeroing() -> bool:
        return shadow.zeroing

    guest.session.receive(codec.tcp_request(Call("zr")))
    assert guest.session.answers(1) == b""
    assert is_zeroing()
    house.emulator.simulation.step(60.0)
    assert not is_zeroing()
    house.work()
    assert guest.client.read("zr", guest.session.tick())[0].slots[36] == 0
    assert not is_zeroing()
    assert house.side.follower is not None
    assert house.side.follower.shadow.quantities["steering_deg"].last == 0.0


def test_a_hold_stops_the_real_robot_and_lets_nobody_move_it() -> None:
    house, line = on_line("n200")
    real = line.emulator.simulation.robots[1]
    guest = house.guest()
    guest.ask("vm", 100, 0, 0)
    assert not real.still((0,))
    house.gateway.hold(1, "viewer 1")
    house.work()
    assert real.still((0,))
    for name, args in (("vm", (100, 0, 0)), ("pr", (100, 0, 0)), ("zr", ()), ("mv", (1, 50, 0, 0, 0, 0))):
        assert guest.ask(name, *args).slots[38] == 0
        assert real.still((0, 1, 2))
    assert refusal(guest.ask("arm_mv", 2, 10, 2, 10)) == (5,)
    assert house.emulator.holds.told() == {"1": {"by": "viewer 1", "ignored": 5}}
    house.emulator.holds.release(1)
    assert guest.ask("vm", 100, 0, 0).slots[38] == 100


def test_a_hold_of_a_robot_that_is_simulated_at_present_says_nothing_to_the_real_one() -> None:
    house, line = on_line()
    guest = house.guest()
    guest.ask("simulated_robot")
    guest.ask("vm", 100, 0, 0)
    house.work()
    before = line.emulator.simulation.time_s
    house.gateway.hold(1, "viewer 1")
    house.work()
    assert house.emulator.simulation.robots[1].still((0,))
    assert line.emulator.simulation.time_s == before
