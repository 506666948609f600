"""Nserver's clients on a real robot, in one process and without a thread: an emulated one over its own line, a silent
one, one that answers NAK, another Nserver."""

from __future__ import annotations

import math

import pytest

from docs.generate.commands import examples
from nclient.backends.wrappers import SpeedLimiter
from nclient.connector import open_backend
from nclient.errors import AddressError, BumperHit, ConnectionLost, ReplyTimeout, RobotRefused
from nclient.protocol import codec
from nclient.protocol.commands import COMMANDS, Call
from nclient.protocol.replies import Reply, text_of
from nclient.protocol.types import EVERYTHING, N200
from nserver_emu.gateway.gateway import TIMEOUT_S
from nserver_emu.server.server_state import SimulationClock
from nserver_emu.simulation.noise import NOISY
from tests.nserver_emu.gateway.harness import LINE_STATE, EmulatedLine, GatewayHarness, ScriptedRobot, emulated, line_of
from worlds.world import StartPose

SERVERS = ("quit_server", "simulated_robot")
# Commands that change nothing, so that any client may send them.
WATCHING = ("gs", "get_sn", "get_rc", "get_rv", "get_bp", "get_cp")


def on_line(model: str = "n150") -> tuple[GatewayHarness, EmulatedLine]:
    """A gateway to an emulated robot on its own line."""
    line = line_of(emulated(model))
    return GatewayHarness(lambda: line), line


def scripted(**answers: Reply | Exception) -> tuple[GatewayHarness, ScriptedRobot]:
    robot = ScriptedRobot(answers=answers)
    harness = GatewayHarness(lambda: robot)
    # The calls at the start (timeout, first state) are not part of the tests.
    robot.names()
    return harness, robot


def refusal(reply: Reply) -> tuple[int, ...]:
    return reply.values if reply.kind == "error" else ()


def test_the_real_robot_moves_and_the_simulated_one_does_not() -> None:
    harness, line = on_line()
    client = harness.client()
    client.ask("sp", 100, 450, 450)
    first = client.ask("pr", 240, 0, 900)
    assert first.slots[38] == 100
    reply = client.ask("ws", 1, 1, 1, 60)
    # 24 in and 90 deg in tenths, at rest.
    assert (reply.slots[34], reply.slots[37], reply.slots[38]) == (240, 900, 0)
    real = line.emulator.simulation.robots[1].actual
    assert (real.x_in, math.degrees(real.turret_rad)) == pytest.approx((24.0, 90.0))
    assert harness.emulator.simulation.robots[1].actual.x_in == 0.0
    assert reply.slots[0] == 10
    # The rest value of the line's bumper bits is removed.
    assert reply.slots[33] == 0
    assert reply.clock is not None
    assert reply.volts is not None


def test_queries_return_the_real_robots_numbers() -> None:
    harness, line = on_line()
    client = harness.client()
    client.ask("dp", 120, -340)
    client.ask("da", 100, 200)
    robot = line.emulator.simulation.robots[1]
    for name in WATCHING:
        assert client.ask(name).kind != "error"
    assert tuple(client.ask("get_rc").slots.values()) == (120, -340, 100, 200)
    assert tuple(client.ask("get_sn").slots.values()) == robot.sonar.readings_in
    assert client.ask("get_robot_conf").values == (120, -340, 100, 200)
    # A real robot cannot be placed: only its encoders are set.
    assert client.ask("place_robot", 50, 60, 70, 80) == Reply("simple", values=(0,))
    assert tuple(client.ask("get_rc").slots.values()) == (50, 60, 70, 80)
    assert robot.actual.x_in == 0.0


@pytest.mark.long
def test_every_command_is_answered_and_lacking_ones_are_error_4() -> None:
    for model, lacking in (
        ("n150", {"conf_ir", "get_ir", "conf_cp", "conf_ls", "get_ls", "conf_sg", "get_sg", "pa", "tk", "get_ra",
                  "sim_truth", "sim_control", "arm_zr", "arm_ws", "arm_mv", "special_request"}),
        ("n200", {"get_ra", "sim_truth", "sim_control", "special_request"}),
    ):  # fmt: skip
        harness, _ = on_line(model)
        client = harness.client()
        asked = [row for row in COMMANDS if row.has_tcp_reply and row.tcp_type is not None and row.name not in SERVERS]
        refused = {row.name: refusal(client.ask(row.name, *examples(row))) for row in asked}
        # Error 4 exactly for the commands that this model's line lacks.
        assert {name for name, code in refused.items() if code == (4,)} == lacking
        # There is none yet.
        world = {"delete_obstacle", "move_obstacle"}
        assert {name for name, code in refused.items() if code and code != (4,)} <= world


def test_a_nak_is_error_4_and_the_next_call_is_answered() -> None:
    harness, robot = scripted(conf_sn=RobotRefused("conf_sn", None))
    client = harness.client()
    assert refusal(client.ask("conf_sn", 15, *range(16))) == (4,)
    assert client.ask("gs").slots[34] == 100
    assert robot.names() == ["conf_sn", "gs"]


def test_a_silent_robot_is_error_6_until_it_answers() -> None:
    harness, robot = scripted()
    driver, watcher = harness.client(), harness.client()
    driver.ask("vm", 10, 0, 0)
    # Two lost replies: the job of vm fails, and so does the attempt to reach the robot again.
    robot.trouble += [ReplyTimeout("no answer")] * 2
    assert refusal(driver.ask("vm", 20, 0, 0)) == (6,)
    assert refusal(watcher.ask("gs")) == (6,)
    assert refusal(watcher.ask("ws", 1, 1, 1, 10)) == (6,)
    # Commands that the server answers itself work without the robot.
    assert watcher.ask("motion_check", 0, 0, 0, 1000, 1000).kind == "simple"
    harness.run_pending()
    assert watcher.ask("gs").slots[34] == 100
    assert driver.ask("gs").slots[34] == 100
    # The driver still owns the robot: refused (5).
    assert refusal(watcher.ask("vm", 5, 0, 0)) == (5,)


def test_a_lost_line_is_reopened_with_a_stop_first() -> None:
    robots = [ScriptedRobot(), ScriptedRobot()]
    left = iter(robots)
    harness = GatewayHarness(lambda: next(left))
    client = harness.client()
    robots[0].close()
    assert refusal(client.ask("gs")) == (6,)
    assert client.ask("gs").slots[34] == 100
    # A new connection stops the robot first, then sets the command timeout and reads the state.
    assert robots[1].names() == ["st", "conf_tm", "gs", "gs"]


def test_only_the_owner_moves_and_every_client_may_stop() -> None:
    harness, line = on_line()
    driver, watcher = harness.client(), harness.client()
    driver.ask("vm", 50, 0, 0)
    # sp changes the robot as well, and place_robot sets its encoders.
    for name, args in (("vm", (10, 0, 0)), ("pr", (10, 0, 0)), ("sp", (1, 1, 1)), ("place_robot", (0, 0, 0, 0))):
        assert refusal(watcher.ask(name, *args)) == (5,)
    assert watcher.ask("gs").slots[38] == 50
    # Any client may stop.
    assert watcher.ask("st").slots[38] == 0
    assert driver.ask("vm", 50, 0, 0).slots[38] == 50
    driver.leave()
    # The job of the disconnected owner stops the robot, which is then free.
    harness.run_pending()
    assert not any(line.emulator.simulation.robots[1].moving)
    assert watcher.ask("vm", 20, 0, 0).slots[38] == 20


def test_lp_releases_the_robot() -> None:
    harness, _ = on_line()
    driver, other = harness.client(), harness.client()
    driver.ask("vm", 50, 0, 0)
    driver.ask("lp")
    assert other.ask("vm", 20, 0, 0).slots[38] == 20
    # The former owner has to wait like any other client now.
    assert refusal(driver.ask("vm", 20, 0, 0)) == (5,)


def test_a_watcher_that_disconnects_stops_nothing() -> None:
    harness, line = on_line()
    driver, watcher = harness.client(), harness.client()
    driver.ask("vm", 50, 0, 0)
    watcher.leave()
    harness.run_pending()
    assert line.emulator.simulation.robots[1].moving[0]


def test_read_only_answers_queries_and_changes_nothing() -> None:
    robot = ScriptedRobot()
    harness = GatewayHarness(lambda: robot, read_only=True)
    client = harness.client()
    for name, args in (("vm", (1, 1, 1)), ("conf_tm", (1,)), ("dp", (1, 1)), ("zr", ())):
        assert refusal(client.ask(name, *args)) == (5,)
    assert client.ask("gs").slots[34] == 100
    assert client.ask("simulated_robot").values == (0,)
    # Closing sends no stop either.
    harness.proxy.close()
    assert robot.names() == ["gs", "gs"]


def test_every_client_may_stop_a_read_only_robot() -> None:
    robot = ScriptedRobot()
    harness = GatewayHarness(lambda: robot, read_only=True)
    assert harness.client().ask("st").kind == "state"
    # A stop is an exception: it must always be possible.
    assert robot.names() == ["gs", "st"]


def test_the_speed_limit_applies_to_robot_and_shadow() -> None:
    line = line_of(emulated())
    harness = GatewayHarness(
        lambda: line, shadow=True, wrap=lambda backend: SpeedLimiter(backend, max_speed_in_s=4, max_turn_deg_s=9)
    )
    client = harness.client()
    # 10 in/s are limited to 4; the steering to 9 deg/s.
    assert client.ask("vm", 100, -200, 50).slots[38] == 40
    simulated = harness.emulator.simulation.robots[1]
    for robot in (line.emulator.simulation.robots[1], simulated):
        assert robot.velocities == pytest.approx((4.0, -math.radians(9), math.radians(5)))
    client.ask("st")
    client.ask("pr", 240, 0, 0)
    assert simulated.velocities[0] == pytest.approx(4.0)
    assert client.ask("gs").slots[38] == 40


def test_a_bumper_stop_is_error_5_and_the_session_continues(caplog: pytest.LogCaptureFixture) -> None:
    harness, robot = scripted()
    client = harness.client()
    robot.trouble.append(BumperHit("gs", (3,)))
    assert refusal(client.ask("gs")) == (5,)
    assert client.ask("gs").kind == "state"
    assert "the real robot was stopped" in caplog.text


def test_clients_switch_between_real_and_simulated_robot() -> None:
    harness, line = on_line()
    client, other = harness.client(), harness.client()
    client.ask("vm", 50, 0, 0)
    # Another client must not take the robot from its owner.
    assert refusal(other.ask("simulated_robot")) == (5,)
    assert client.ask("real_robot").values == (0,)
    assert client.ask("simulated_robot").values == (0,)
    # Switching to the simulation stops the real robot, and back stops the simulated one.
    harness.run_pending()
    real, simulated = line.emulator.simulation.robots[1], harness.emulator.simulation.robots[1]
    assert not any(real.moving)
    assert other.ask("vm", 30, 0, 0).slots[38] == 30
    assert simulated.moving[0]
    assert other.ask("sim_truth").kind == "truth"
    assert client.ask("real_robot").values == (0,)
    assert not any(simulated.moving)
    assert refusal(client.ask("sim_truth")) == (4,)
    assert other.ask("vm", 20, 0, 0).slots[38] == 20
    assert real.moving[0]
    assert not simulated.moving[0]


def test_other_robots_are_answered_by_the_simulation() -> None:
    harness, _ = on_line()
    client = harness.client()
    assert client.ask("create_robot", 2, 1).values == (1,)
    assert refusal(client.ask("real_robot")) == (4,)
    assert client.ask("sim_truth").kind == "truth"


def test_ws_polls_the_state_and_a_stop_interrupts_it() -> None:
    # The clock is 296 ms before its 32-bit wrap; axis 0 moves.
    moving = Reply("state", {**LINE_STATE.slots, 41: 1}, clock=4_294_967_000)
    harness, robot = scripted()
    robot.state = moving
    waiter, other = harness.client(), harness.client()
    waiter.session.receive(codec.encode_tcp_request(Call("ws", (1, 0, 0, 1))))
    # 1. ws defers its reply and polls the state.
    assert waiter.session.process_requests(1) == b""
    assert waiter.session.tick() == b""
    harness.run_pending()
    assert waiter.session.tick() == b""
    harness.now_s += 0.01
    assert waiter.session.tick() == b""
    harness.run_pending()
    # 2. A stop of another client is executed between two polls.
    assert other.ask("st").kind == "state"
    assert robot.names() == ["gs", "st"]
    # 946 ms later: the clock began anew.
    robot.state = Reply("state", moving.slots, clock=650)
    harness.now_s += 1.0
    assert waiter.session.tick() == b""
    harness.run_pending()
    assert waiter.session.tick() == b""
    # 3. 704 + 296 = 1000 ms: the timeout of ws is over.
    robot.state = Reply("state", moving.slots, clock=704)
    harness.now_s += 1.0
    waiter.session.tick()
    harness.run_pending()
    (reply,) = waiter.wire.read("ws", waiter.session.tick())
    assert (reply.clock, reply.slots[41]) == (704, 1)


def test_ws_waits_for_the_named_axes_only() -> None:
    harness, robot = scripted()
    # Only the turret (bit 2) moves, which ws does not name.
    robot.state = Reply("state", {**LINE_STATE.slots, 41: 0b100}, clock=0)
    assert harness.client().ask("ws", 1, 1, 0, 255).slots[41] == 0b100


def test_gs_during_zr_returns_the_latest_state() -> None:
    harness, robot = scripted()
    watcher = harness.client()
    watcher.ask("gs")
    robot.names()
    # zr lasts for up to two minutes, in which the line answers nothing else.
    harness.proxy.robot.current_command = "zr"
    watcher.session.receive(codec.encode_tcp_request(Call("gs")))
    (state,) = watcher.wire.read("gs", watcher.session.process_requests(1))
    # The last known state, without a call to the robot.
    assert (state.slots[34], state.clock) == (100, 5000)
    assert robot.names() == []


def test_the_gateways_timeout_applies_until_a_client_sets_one() -> None:
    robot = ScriptedRobot()
    harness = GatewayHarness(lambda: robot)
    assert robot.calls == [Call("conf_tm", (5,)), Call("gs")]
    client, other = harness.client(), harness.client()
    client.ask("vm", 10, 0, 0)
    robot.names()
    harness.gateway.tick()
    harness.run_pending()
    # Just fed by vm: nothing is due.
    assert robot.names() == []
    # A third of the timeout later the gateway feeds it with gs.
    harness.now_s += TIMEOUT_S / 3
    harness.gateway.tick()
    harness.run_pending()
    assert robot.names() == ["gs"]
    client.ask("conf_tm", 2)
    # From now on the timeout is the client's own.
    assert robot.calls == [Call("conf_tm", (2,))]
    harness.now_s += 100
    harness.gateway.tick()
    harness.run_pending()
    client.ask("conf_tm", 0)
    # 0 never stops: the gateway's own timeout is used, and a stop is sent because the owner was silent for too long.
    assert robot.calls == [Call("conf_tm", (2,)), Call("st"), Call("conf_tm", (5,))]
    client.ask("conf_tm", 3)
    robot.calls.clear()
    other.leave()
    client.leave()
    harness.run_pending()
    # When the owner disconnects, the robot stops and gets the gateway's timeout again.
    assert robot.calls == [Call("st"), Call("conf_tm", (5,))]
    harness.now_s += 100
    harness.gateway.tick()
    harness.run_pending()
    assert len(robot.calls) == 2


@pytest.mark.long
def test_a_silent_owners_watchdog_is_not_fed_by_others() -> None:
    harness, line = on_line()
    real = line.emulator.simulation.robots[1]
    owner, watcher = harness.client(), harness.client()
    owner.ask("conf_tm", 2)
    owner.ask("vm", 10, 0, 0)
    watcher.ask("gs")
    assert not real.is_still((0,))
    # Each query of the watcher takes 0.1 s on this clock: 5 s in total.
    for _ in range(50):
        watcher.ask("gs")
        harness.gateway.tick()
    harness.run_pending()
    assert real.is_still((0,))


def test_a_silent_owners_robot_is_stopped(caplog: pytest.LogCaptureFixture) -> None:
    harness, robot = scripted()
    owner, watcher = harness.client(), harness.client()
    owner.ask("conf_tm", 2)
    owner.ask("vm", 10, 0, 0)
    robot.names()
    for _ in range(50):
        watcher.ask("gs")
        harness.gateway.tick()
    harness.run_pending()
    # One stop, although the owner stays silent.
    assert robot.names().count("st") == 1
    assert caplog.text.count("sent nothing for 2 s") == 1
    owner.ask("vm", 10, 0, 0)
    for _ in range(50):
        owner.ask("gs")
        harness.gateway.tick()
    # The robot moves, so that ws waits; a waiting owner is not silent.
    robot.state = Reply("state", {**LINE_STATE.slots, 41: 1}, clock=0)
    owner.session.receive(codec.encode_tcp_request(Call("ws", (1, 1, 1, 200))))
    owner.session.process_requests(1)
    for _ in range(50):
        harness.now_s += 0.1
        harness.run_pending()
        owner.session.tick()
        harness.gateway.tick()
    assert "st" not in robot.names()


# The interval is a third of the timeout in the robot's own time: at 10 times the speed a tenth of it.
@pytest.mark.parametrize(("speed", "fed_after_s"), [(None, 5 / 3), (10, 5 / 3), (100, 5 / 30), (0, None)])
def test_the_watchdog_is_fed_at_the_robots_pace(speed: int | None, fed_after_s: float | None) -> None:
    harness, robot = scripted()
    robot.state = Reply("state", LINE_STATE.slots if speed is None else {**LINE_STATE.slots, 0: speed}, clock=0)
    client, asked_s = harness.client(), harness.now_s
    client.ask("vm", 10, 0, 0)
    robot.names()
    while not robot.calls and harness.now_s < 10:
        harness.now_s += 0.02
        harness.gateway.tick()
        harness.run_pending()
    if fed_after_s is None:
        assert robot.names() == []
    else:
        assert robot.names() == ["gs"]
        assert harness.now_s - asked_s == pytest.approx(fed_after_s, abs=0.04)


def test_position_stamps_are_requested_once_for_all_clients() -> None:
    robot = ScriptedRobot(N200)
    harness = GatewayHarness(lambda: robot)
    # A N200 also gets the whole mask.
    assert robot.calls == [Call("conf_tm", (5,)), Call("ct", EVERYTHING.smask), Call("gs")]
    one, other = harness.client(), harness.client()
    robot.calls.clear()
    one.ask("ct", *EVERYTHING.with_position(2).smask)
    other.ask("ct", *EVERYTHING.with_position(4).smask)
    one.ask("ct", *EVERYTHING.with_position(2).smask)
    # Stamps of sonars (2), then of sonars and bumpers (6); the third request changes nothing.
    masks = [Call("ct", EVERYTHING.with_position(stamps).smask) for stamps in (2, 6)]
    assert robot.calls == [*masks, Call("gs")]
    other.leave()
    one.ask("ct", *EVERYTHING.smask)
    assert robot.calls[-1] == Call("ct", EVERYTHING.smask)


@pytest.mark.long
def test_stamps_of_another_nserver_are_passed_on() -> None:
    harness = GatewayHarness(lambda: open_backend("sim:thesis_room?step_s=0.1"))
    client = harness.client()
    client.ask("ct", *EVERYTHING.with_position(2).smask)
    client.ask("dp", 500, 600)
    client.ask("vm", 20, 0, 0)
    for _ in range(20):
        reply = client.ask("gs")
    # Stamps have the pose of their reading, y = 60.0 in.
    assert {stamp.y for stamp in reply.stamps.values()} == {600}
    assert refusal(harness.client().ask("sim_truth")) == (4,)
    harness.proxy.close()


def test_closing_stops_the_robot() -> None:
    harness, line = on_line()
    harness.client().ask("vm", 50, 0, 0)
    harness.proxy.close()
    assert not any(line.emulator.simulation.robots[1].moving)
    assert line.closed
    assert refusal(harness.client().ask("gs")) == (6,)


def test_a_simulated_robot_of_another_model_is_refused() -> None:
    with pytest.raises(AddressError, match=r"n200 .*simulation .* n150"):
        GatewayHarness(ScriptedRobot, emulator=emulated("n200"))


def test_an_unreachable_robot_is_an_error_at_the_start() -> None:
    def nowhere() -> ScriptedRobot:
        raise ConnectionLost("no such port")

    with pytest.raises(ConnectionLost):
        GatewayHarness(nowhere)


@pytest.mark.long
def test_the_shadow_of_a_simulation_differs_by_nothing() -> None:
    line = line_of(emulated())
    harness = GatewayHarness(lambda: line, emulator=emulated(pace=SimulationClock(lockstep_s=0.1)), shadow=True)
    harness.run_pending()
    harness.gateway.tick()
    client = harness.client()
    # the opening calls take simulated time as well
    harness.emulator.simulation.step(line.emulator.simulation.time_s - harness.emulator.simulation.time_s)
    client.ask("vm", 50, 100, -200)
    for _ in range(30):
        client.ask("gs")
    client.ask("get_sn")
    client.ask("st")
    assert harness.proxy.shadow is not None
    shadow = harness.proxy.shadow.report
    assert shadow.states > 30
    # Both simulations are ideal, so any difference would be an error of the shadow.
    for name, found in shadow.quantities.items():
        assert found.largest == 0, name
    assert harness.emulator.simulation.robots[1].actual == line.emulator.simulation.robots[1].actual


def test_a_shadow_starts_at_the_encoders_and_shows_noise(caplog: pytest.LogCaptureFixture) -> None:
    line = line_of(emulated(setup=NOISY, start=StartPose(20.0, 20.0, 1.0, 2.0)))
    real = line.emulator.simulation.robots[1]
    real.define_position(-300.0, 200.0)
    harness = GatewayHarness(lambda: line, emulator=emulated(), shadow=True)
    harness.run_pending()
    client = harness.client()
    client.ask("gs")
    encoder = harness.emulator.simulation.robots[1].encoder
    assert (encoder.x_in, encoder.y_in) == pytest.approx((-300.0, 200.0))
    assert harness.emulator.simulation.robots[1].actual.x_in == 0.0
    client.ask("place_robot", 600, 600, 0, 0)
    assert harness.emulator.simulation.robots[1].actual.x_in == pytest.approx(60.0)
    assert harness.proxy.shadow is not None
    assert harness.proxy.shadow.report.quantities["x_in"].largest == 0.0
    client.ask("place_robot", 9000, 600, 0, 0)
    assert "shadow: place_robot(9000, 600, 0, 0) in the simulation: place_robot was refused" in caplog.text
    # The encoders of the real robot are at 900 in, the shadow stayed at 60 in.
    assert harness.proxy.shadow.report.quantities["x_in"].last == pytest.approx(840.0)


def test_the_shadow_pauses_while_the_simulation_is_driven() -> None:
    line = line_of(emulated())
    harness = GatewayHarness(lambda: line, shadow=True)
    harness.run_pending()
    client = harness.client()
    assert client.ask("simulated_robot").values == (0,)
    harness.run_pending()
    harness.gateway.tick()
    assert harness.proxy.shadow is not None
    before = harness.proxy.shadow.report.states
    client.ask("gs")
    assert harness.proxy.shadow.report.states == before


def test_the_shadow_starts_slow_commands_with_the_robot() -> None:
    start = StartPose(0.0, 0.0, 1.0, 2.0)
    line = line_of(emulated(start=start))
    harness = GatewayHarness(lambda: line, emulator=emulated(start=start), shadow=True)
    client = harness.client()
    client.ask("gs")
    shadow = harness.emulator.simulation.robots[1]

    def is_zeroing() -> bool:
        return shadow.zeroing

    client.session.receive(codec.encode_tcp_request(Call("zr")))
    assert client.session.process_requests(1) == b""
    assert is_zeroing()
    # The simulated robot zeroes by itself, long before the real one's reply.
    harness.emulator.simulation.step(60.0)
    assert not is_zeroing()
    harness.run_pending()
    assert client.wire.read("zr", client.session.tick())[0].slots[36] == 0
    assert not is_zeroing()
    assert harness.proxy.shadow is not None
    assert harness.proxy.shadow.report.quantities["steering_deg"].last == 0.0


def test_a_hold_stops_the_real_robot_and_refuses_motions() -> None:
    harness, line = on_line("n200")
    real = line.emulator.simulation.robots[1]
    client = harness.client()
    client.ask("vm", 100, 0, 0)
    assert not real.is_still((0,))
    harness.gateway.hold(1, "viewer 1")
    harness.run_pending()
    assert real.is_still((0,))
    for name, args in (("vm", (100, 0, 0)), ("pr", (100, 0, 0)), ("zr", ()), ("mv", (1, 50, 0, 0, 0, 0))):
        assert refusal(client.ask(name, *args)) == (7,)
        assert real.is_still((0, 1, 2))
    assert refusal(client.ask("arm_mv", 2, 10, 2, 10)) == (7,)
    assert client.ask("gs").slots[44] == 7
    assert text_of(client.ask("held_by").values) == "viewer 1"
    # Four motions of the axes and one of the arm.
    assert harness.emulator.estop.as_dict() == {"1": {"by": "viewer 1", "ignored": 5}}
    harness.emulator.release(1)
    assert client.ask("vm", 100, 0, 0).slots[38] == 100


@pytest.mark.long
def test_refused_motion_is_answered_when_the_real_robot_got_st() -> None:
    harness, robot = scripted()
    client = harness.client()
    harness.gateway.hold(1, "viewer 1")
    harness.run_pending()
    robot.names()
    # A program that repeats its motion waits for each reply: stops do not pile up in the queue of a slow line.
    # Five times the same motion: only the first one is executed until its reply is sent.
    client.session.receive(codec.encode_tcp_request(Call("vm", (100, 0, 0))) * 5)
    assert client.session.process_requests(max_requests=100) == b""
    harness.run_pending()
    assert robot.names() == ["st"]
    (reply,) = client.wire.read("vm", client.session.tick())
    assert refusal(reply) == (7,)


def test_a_hold_of_the_simulated_robot_sends_nothing_to_the_real() -> None:
    harness, line = on_line()
    client = harness.client()
    client.ask("simulated_robot")
    client.ask("vm", 100, 0, 0)
    harness.run_pending()
    before = line.emulator.simulation.time_s
    harness.gateway.hold(1, "viewer 1")
    harness.run_pending()
    assert harness.emulator.simulation.robots[1].is_still((0,))
    assert line.emulator.simulation.time_s == before
