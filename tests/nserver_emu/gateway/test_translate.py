"""Translation of calls for a real robot, by row of the command table, and the State rebuilt from its reply."""

from __future__ import annotations

import numpy as np
import pytest

from docs.generate.commands import examples
from nclient.protocol.commands import BY_NAME, COMMANDS, Call, exists_on_serial
from nclient.protocol.replies import Reply
from nclient.protocol.types import (
    EVERYTHING,
    LINES,
    MODELS,
    N150,
    N200,
    PIXELS,
    POINTS,
    SCOUT,
    Mask,
    Model,
    Stamp,
    serial_wire_state,
    tcp_wire_state,
)
from nserver_emu.gateway.real_robot import (
    Link,
    TranslatedCall,
    convert_laser,
    moving_axes,
    plan,
    state_for,
    stays_here,
    whole_state,
)
from nserver_emu.server.session import ConnectionContext
from nserver_emu.simulation.sensors import ANGLES_RAD, LineFit, pixels, points
from tests.nserver_emu.gateway.harness import LINE_STATE
from worlds.robots import N200 as N200_BODY

LINE, SERVER = Link(N150, own_line=True), Link(N150, own_line=False)
N200_LINE = Link(N200, own_line=True)


def context(mask: Mask = EVERYTHING, laser_mode: int = 51) -> ConnectionContext:
    made = ConnectionContext(tcp_wire_state(N150), robot_id=1)
    made.wire_state.set_mask(mask)
    made.wire_state.set_laser_mode(laser_mode)
    return made


def planned(name: str, *args: int, link: Link = LINE, of: ConnectionContext | None = None) -> TranslatedCall:
    found = plan(Call(name, args), of or context(), link)
    assert isinstance(found, TranslatedCall), found
    return found


def shaped(name: str, reply: Reply, *args: int, link: Link = LINE, of: ConnectionContext | None = None) -> Reply:
    asking = of or context()
    return planned(name, *args, link=link, of=asking).build_reply(asking, reply, link)


def test_each_command_is_translated_local_or_unsupported() -> None:
    staying = {row.name for row in COMMANDS if stays_here(row.name)}
    assert staying == {
        "create_robot", "connect_robot", "disconnect_robot", "get_rpx", "add_obstacle", "delete_obstacle",
        "move_obstacle", "new_world", "predict_sensors", "motion_check", "draw_robot", "draw_line", "draw_arc",
        "real_robot", "simulated_robot", "quit_server", "held_by",
        *[row.name for row in COMMANDS if "refresh_" in row.name],
    }  # fmt: skip


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
@pytest.mark.parametrize("own_line", [True, False])
def test_translated_calls_exist_on_the_models_line(model: Model, own_line: bool) -> None:
    # Whatever the gateway sends must exist on the line of the model.
    lacking = set()
    for row in COMMANDS:
        found = plan(Call(row.name, examples(row)), context(), Link(model, own_line))
        if isinstance(found, int):
            assert found == 4
            lacking |= set() if stays_here(row.name) else {row.name}
        elif own_line:
            assert all(exists_on_serial(BY_NAME[call.name], model) for call in found.calls)
    n200_only = {row.name for row in COMMANDS if row.line_models == {"n200"}}
    expected = {"sim_truth", "sim_control"}
    if own_line:
        expected |= {"conf_ser"} if model is N200 else n200_only - {"ct", "get_cp"}
    assert lacking == expected


def test_place_robot_sets_the_encoders() -> None:
    found = planned("place_robot", 10, -20, 900, 1800)
    assert found.calls == (Call("dp", (10, -20)), Call("da", (900, 1800)))
    assert found.build_reply(context(), LINE_STATE, LINE) == Reply("simple", values=(0,))


def test_get_cp_uses_the_state_where_the_line_has_no_query() -> None:
    assert planned("get_cp").calls == (Call("gs"),)
    reply = shaped("get_cp", LINE_STATE)
    assert (reply.kind, dict(reply.slots), reply.clock) == ("compass", {43: 450}, 5000)
    assert planned("get_cp", link=SERVER).calls == planned("get_cp", link=N200_LINE).calls == (Call("get_cp"),)


def test_replies_of_get_robot_conf_and_get_ra() -> None:
    pose = Reply("configuration", {34: 1, 35: 2, 36: 3, 37: 4})
    assert planned("get_robot_conf").calls == (Call("get_rc"),)
    assert shaped("get_robot_conf", pose).values == (1, 2, 3, 4)
    assert shaped("get_ra", Reply("velocity")) == Reply("error", values=(4,))
    velocities = Reply("velocity", {38: 1, 39: 2, 40: 3})
    asking = context()
    assert shaped("get_ra", velocities, of=asking) == velocities
    # get_ra uses the slots of the velocities, but must not count as velocities that were sent.
    assert asking.last_sent[38] == 0
    assert shaped("get_rv", velocities, of=asking) == velocities
    assert asking.last_sent[38:41] == [1, 2, 3]


def test_replies_after_conf_cp_and_tk() -> None:
    scores = Reply("compass", values=(9, 9, 1))
    assert planned("conf_cp", 1, link=N200_LINE).calls == (Call("conf_cp", (1,)), Call("gs"))
    assert shaped("conf_cp", LINE_STATE, 1, link=N200_LINE).kind == "state"
    assert shaped("tk", LINE_STATE, link=N200_LINE) == Reply("simple", values=(0,))
    # A host on a robot's own line gets the line's kind of reply.
    host = ConnectionContext(serial_wire_state(N200), robot_id=1)
    assert shaped("conf_cp", scores, 1, link=N200_LINE, of=host) == scores
    assert shaped("tk", LINE_STATE, link=N200_LINE, of=host).kind == "state"


def test_user_packets_are_unchanged() -> None:
    packet = Reply("special", values=(4, 0, 0, 99))
    assert shaped("special_request", packet, 99, 1) is packet


@pytest.mark.parametrize(
    ("call", "args", "sent"),
    [
        # Signed numbers end at 7fff, unsigned ones at 0 and ffff, bytes at 255.
        ("vm", (40_000, -40_000, 5), (0x7FFF, -0x7FFF, 5)), ("sp", (-5, 100, 70_000), (0, 100, 0xFFFF)),
        ("ac", (1, 2, 3), (1, 2, 3)), ("conf_tm", (300,), (255,)), ("conf_tm", (-1,), (0,)),
        ("pr", (40_000, 0, -40_000), (0x7FFF, 0, -0x7FFF)), ("mv", (2, 40_000, 0, 0, 0, 0), (2, 0x7FFF, 0, 0, 0, 0)),
        ("dp", (-40_000, 3), (-0x7FFF, 3)), ("da", (1, 40_000), (1, 0x7FFF)),
    ],
)  # fmt: skip
def test_values_are_clamped_to_the_range_of_the_line(
    call: str, args: tuple[int, ...], sent: tuple[int, ...]
) -> None:
    assert planned(call, *args).calls == (Call(call, sent),)


def test_values_for_another_nserver_are_not_clamped() -> None:
    assert planned("vm", 40_000, 0, 0, link=SERVER).calls == (Call("vm", (40_000, 0, 0)),)


def test_mv_modes_that_clients_refuse_are_refused() -> None:
    assert plan(Call("mv", (6, 0, 0, 0, 0, 0)), context(), LINE) == 2
    assert planned("mv", 5, 1, 0, 0, 0, 0).calls == (Call("mv", (5, 1, 0, 0, 0, 0)),)


def test_stamps_are_error_4_on_a_line_without_stamps() -> None:
    asking = context(EVERYTHING.with_position(2))
    # The N150's line has no stamps; another Nserver has.
    assert plan(Call("ct", asking.wire_state.mask.smask), asking, LINE) == 4
    assert isinstance(plan(Call("ct", asking.wire_state.mask.smask), asking, SERVER), TranslatedCall)


def test_a_line_packet_becomes_a_whole_clean_state() -> None:
    state = whole_state(LINE_STATE, LINE)
    # Speed 1.0, infrareds without a reading (15), 16 sonars, no bumper, pose, velocities, motors, laser, compass,
    # error.
    assert state == [10, *[15] * 16, *[40] * 16, 0, 100, -50, 900, 1800, 0, 0, 0, 0, 0, 450, 0]
    touching = Reply("state", {**LINE_STATE.slots, 33: 0xF00002})
    # Bit 1, without the rest value f00000.
    assert whole_state(touching, LINE)[33] == 2
    assert whole_state(Reply("state", {33: 0x20}), Link(SCOUT, own_line=True))[33] == 0x20
    served = Reply("state", {0: 100, **LINE_STATE.slots})
    assert whole_state(served, SERVER)[0] == 100


def test_masked_slots_repeat_their_last_value() -> None:
    asking = context()
    assert state_for(asking, LINE_STATE, LINE).slots[20] == 40
    # Slots 34 to 43 only.
    asking.wire_state.set_mask(Mask((0, *[0] * 33, *[1] * 10)))
    nearer = Reply("state", {**LINE_STATE.slots, 20: 7, 34: 101}, clock=5001, volts=(1, 2))
    reply = state_for(asking, nearer, LINE)
    assert (reply.slots[20], reply.slots[34], reply.slots[1], reply.slots[0]) == (40, 101, 15, 10)
    assert (reply.clock, reply.volts) == (5001, (1, 2))
    asking.wire_state.set_mask(EVERYTHING)
    assert state_for(asking, nearer, LINE).slots[20] == 7


def test_stamps_are_passed_on_and_moving_axes_read() -> None:
    stamp = Stamp(1, 2, 3, 4, 5, 6, 7, 8, 9)
    reply = state_for(context(), Reply("state", LINE_STATE.slots, stamps={"sonar_0": stamp}), N200_LINE)
    assert reply.stamps == {"sonar_0": stamp}
    # The three lowest bits are the axes.
    assert moving_axes(Reply("state", {41: 0b0101_1010})) == 0b010
    assert moving_axes(Reply("state")) == 0


def wall_ahead(x_in: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return what each laser column measures of a wall ahead, by plain trigonometry: range = d / cos(angle)."""
    return (x_in - N200_BODY.radius_in) / np.cos(ANGLES_RAD)


def test_camera_rows_become_points_on_the_wall() -> None:
    rows = pixels(wall_ahead(60.0))
    count, *numbers = convert_laser((len(rows), *rows), POINTS, N200_BODY, LineFit())
    found = np.reshape(numbers, (-1, 2)) / 10
    assert count == len(found) == 482
    # A row is 0.9 in here.
    assert found[:, 0] == pytest.approx(60.0, abs=0.5)
    assert found[0, 1] < 0 < found[-1, 1]
    # Row 0 in all columns: no laser line is visible.
    blind = (482, *[0] * 482)
    assert convert_laser(blind, POINTS, N200_BODY, LineFit()) == (0,)


def test_points_become_lines_and_not_vice_versa() -> None:
    found = points(wall_ahead(60.0), N200_BODY)
    vector = (len(found), *np.rint(found.ravel() * 10).astype(int).tolist())
    count, x1, y1, x2, y2 = convert_laser(vector, LINES, N200_BODY, LineFit())
    assert count == 1
    assert (x1, x2) == pytest.approx((600, 600), abs=2)
    assert -y1 == y2 == pytest.approx(10 * (60.0 - N200_BODY.radius_in) * np.tan(np.pi / 6), abs=2)
    assert convert_laser(vector, POINTS, N200_BODY, LineFit()) == vector
    assert convert_laser(vector, PIXELS, N200_BODY, LineFit()) == (0,)
    # Lines have four words each and cannot become points.
    assert convert_laser((1, 1, 2, 3, 4), POINTS, N200_BODY, LineFit()) == (0,)
    assert convert_laser((0,), LINES, N200_BODY, LineFit()) == (0,)


def test_the_laser_has_the_connections_shape() -> None:
    rows = pixels(wall_ahead(60.0))
    reply = Reply("state", LINE_STATE.slots, laser=(len(rows), *rows))
    asking = context(laser_mode=51)
    seen = state_for(asking, reply, N200_LINE)
    assert seen.laser is not None
    # A count and two words per point.
    assert (len(seen.laser), seen.slots[42]) == (1 + 2 * 482, 51)
    assert state_for(context(laser_mode=3), reply, N200_LINE).laser == reply.laser
    assert state_for(context(Mask((0,) + (1,) * 41 + (0, 1))), reply, N200_LINE).laser is None
    assert state_for(asking, reply, LINE).laser is None
    segment = Reply("laser", laser=(1, 1, 2, 3, 4))
    assert shaped("get_sg", segment, link=N200_LINE) == segment
    asked = shaped("get_ls", Reply("laser", laser=reply.laser), link=N200_LINE)
    assert asked.laser == seen.laser
