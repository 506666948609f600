"""The table: what PROTOCOL's own tables say of types, models and waiting times, and that no number is given twice."""

from __future__ import annotations

import pytest

from nclient.protocol.commands import (
    BY_LINE_TYPE,
    BY_NAME,
    BY_PACKET_TYPE,
    BY_TCP_TYPE,
    COMMANDS,
    MAX_REPLY_WORDS,
    NAK_TYPE,
    REPLY_TYPES,
    Command,
    exists_on_serial,
)
from nclient.protocol.types import MODELS, N150, N200, SCOUT

# The tables of docs/protocol.md, copied by hand: an oracle independent of the command table.
TCP_TYPES = {
    "ac": 10, "sp": 11, "pr": 13, "vm": 12, "mv": 43, "pa": 14, "gs": 15, "st": 17, "lp": 18, "zr": 20, "ct": 16,
    "tk": 19, "dp": 21, "da": 38, "ws": 39, "conf_ir": 22, "conf_sn": 23, "conf_cp": 24, "conf_ls": 25, "conf_tm": 26,
    "conf_sg": 36, "get_ir": 27, "get_sn": 28, "get_rc": 29, "get_rv": 30, "get_ra": 31, "get_cp": 32, "get_bp": 35,
    "get_ls": 33, "get_sg": 37, "get_rpx": 75, "add_obstacle": 50, "delete_obstacle": 51, "move_obstacle": 52,
    "new_world": 53, "draw_robot": 60, "draw_line": 61, "draw_arc": 62, "quit_server": 70, "real_robot": 71,
    "simulated_robot": 74, "place_robot": 41, "predict_sensors": 42, "get_robot_conf": 200, "special_request": 300,
    "arm_zr": 300, "arm_ws": 300, "arm_mv": 300, "motion_check": 400, "create_robot": 101, "connect_robot": 102,
    "disconnect_robot": 103, "sim_truth": 1000, "sim_control": 1001, "held_by": 1002, "conf_ser": None,
}
REFRESHES = (
    "refresh_all", "refresh_all_traces", "refresh_actual_trace", "refresh_encoder_trace", "refresh_all_sensors",
    "refresh_bumper_sensor", "refresh_infrared_sensor", "refresh_sonar_sensor", "refresh_laser_sensor",
    "refresh_client_graphics",
)
LINE_TYPES = {
    "ac": 1, "sp": 2, "pr": 3, "pa": 4, "vm": 5, "mv": 43, "ct": 6, "gs": 7, "st": 9, "lp": 10, "zr": 13, "tk": 11,
    "dp": 12, "da": 30, "conf_ir": 14, "conf_sn": 15, "conf_cp": 16, "conf_ls": 17, "conf_tm": 18, "get_ir": 19,
    "get_sn": 20, "get_rc": 21, "get_rv": 22, "get_ra": 23, "get_cp": 24, "get_ls": 25, "get_bp": 27, "get_sg": 29,
    "conf_sg": 28, "ws": 31, "conf_ser": 35, "special_request": 128, "arm_zr": 128, "arm_ws": 128, "arm_mv": 128,
}
N200_ONLY = {"pa", "ct", "tk", "conf_ir", "conf_cp", "conf_ls", "conf_sg", "get_ir", "get_cp", "get_ls", "get_sg"}


def test_every_type_over_tcp() -> None:
    # The refresh commands have the consecutive types 150 to 159.
    expected = TCP_TYPES | {name: 150 + k for k, name in enumerate(REFRESHES)}
    assert {row.name: row.tcp_type for row in COMMANDS} == expected


def test_every_type_on_the_line_and_on_whose() -> None:
    assert {row.name: row.line_type for row in COMMANDS if row.line_type is not None} == LINE_TYPES
    # The commands of a model's line are all except these.
    missing = {
        model.name: {n for n in LINE_TYPES if not exists_on_serial(BY_NAME[n], model)} for model in MODELS.values()
    }
    assert missing == {"n150": N200_ONLY, "scout": N200_ONLY, "n200": {"conf_ser"}}
    assert not exists_on_serial(BY_NAME["get_rpx"], N200)


def test_no_name_type_or_method_is_given_twice() -> None:
    assert len(BY_NAME) == len({row.method for row in COMMANDS}) == len(COMMANDS)
    # The three arm commands share a message type, 300 over TCP and 128 on the serial line, and differ by packet type.
    arms = [row for row in COMMANDS if row.packet_type is not None]
    assert [row.name for row in arms] == ["arm_zr", "arm_ws", "arm_mv"]
    assert sorted(BY_PACKET_TYPE) == [40, 41, 42]
    assert len(BY_TCP_TYPE) == sum(row.tcp_type is not None for row in COMMANDS) - len(arms)
    assert len(BY_LINE_TYPE) == len(LINE_TYPES) - len(arms)
    assert NAK_TYPE not in BY_LINE_TYPE


def test_how_long_a_host_waits_on_the_line() -> None:
    # A host waits 1 s; zr turns the turret, and user packets may move an arm.
    others = {row.name: row.line_timeout_s for row in COMMANDS if row.line_timeout_s != 1.0}
    assert others == {"zr": 120.0, "special_request": 30.0, "arm_zr": 30.0, "arm_ws": 30.0, "arm_mv": 30.0}


def test_only_a_disconnect_has_no_answer() -> None:
    assert [row.name for row in COMMANDS if not row.has_tcp_reply] == ["disconnect_robot"]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda row: row.name)
def test_a_row_is_whole(command: Command) -> None:
    assert command.summary
    assert command.method.isidentifier()
    assert REPLY_TYPES[command.tcp_reply] in MAX_REPLY_WORDS
    names = [argument.name for argument in command.arguments]
    assert len(set(names)) == len(names)
    if command.extra_arguments:
        name, place = command.extra_arguments
        assert name in ("pid", "mask", "packet_type")
        # An argument that the C call does not have is one number (pid, packet type) or the 44 of a mask.
        assert command.any_length or len(names[place]) in (1, 44)


def test_scout_and_n150_have_the_same_commands() -> None:
    assert all(exists_on_serial(row, N150) == exists_on_serial(row, SCOUT) for row in COMMANDS)
