"""The command table: every command once, for client, server, C library, command line, documentation and tests.

    a row   C name | Robot's method | type over TCP, type on the line | arguments | reply there and there | models

A new command needs a row, a handler in nserver_emu/server/handlers and a method of Robot; all steps are in
docs/architecture.md, How to add. `ALL` (models) means that the command exists on every model's serial line. Lengths are
1/10 inch and angles 1/10 degree, as on the wire.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from construct import Construct

from nclient.protocol import layouts
from nclient.protocol import replies as shape
from nclient.protocol.layouts import LINE_BYTE, LINE_SIGNED, LINE_UNSIGNED, MAX_LASER_READINGS
from nclient.protocol.replies import LineLayout, TcpLayout
from nclient.protocol.types import MODELS, Model

ALL = frozenset(MODELS)
N200 = frozenset({"n200"})
NOT_N200 = ALL - N200


class Argument(NamedTuple):
    """An argument of a command: its name, and its field on the serial line; over TCP it is a word."""

    name: str
    line: Construct = LINE_SIGNED

    @property
    def is_flag(self) -> bool:
        """True for an argument that is 0 or 1."""
        return self.line is layouts.FLAG_BYTE


class Call(NamedTuple):
    """A command with its arguments: a flat tuple of integers in the order of the C call (a string for tk).

    Some calls have arguments that the C call does not: connect_robot its pid (last), ct the 44 numbers of Smask,
    special_request its packet type (first).
    """

    name: str
    args: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True)
class Command:
    """A row of the command table."""

    name: str
    """C name."""
    method: str
    """Method of `Robot` that sends the command."""
    summary: str
    arguments: tuple[Argument, ...]
    tcp_type: int | None
    tcp_request: layouts.TcpArguments | None
    """None where each argument is a word."""
    tcp_words: tuple[int, int]
    """Minimum and maximum words of a request."""
    tcp_reply: TcpLayout
    line_type: int | None
    line_request: Construct
    line_reply: LineLayout
    line_models: frozenset[str]
    """Models with this command on their serial line."""
    line_timeout_s: float
    """Time that a host waits for the reply on the serial line in seconds (ws adds its own timeout)."""
    extra_arguments: tuple[str, slice] | None
    """Name and place of arguments that the C call does not have."""
    packet_type: int | None
    has_tcp_reply: bool
    any_length: bool
    """True if the number of arguments varies."""


def _row(name: str, method: str, types: tuple[int | None, int | None], arguments: Iterable[Argument],
         reply: tuple[TcpLayout, LineLayout], summary: str, **special: Any) -> Command:
    arguments = tuple(arguments)
    count = len(arguments)
    are_flags = [argument.is_flag for argument in arguments]
    fields: dict[str, Any] = {
        "tcp_request": layouts.FlagWords(are_flags) if any(are_flags) else None, "tcp_words": (count, count),
        "line_request": layouts.Fields(*[a.name / a.line for a in arguments]), "line_models": ALL,
        "line_timeout_s": 1.0, "extra_arguments": None, "packet_type": None, "has_tcp_reply": True, "any_length": False,
    }  # fmt: skip
    return Command(name, method, summary, arguments, types[0], tcp_reply=reply[0], line_type=types[1],
                   line_reply=reply[1], **(fields | special))


def _signed(*names: str) -> tuple[Argument, ...]:
    return tuple(Argument(name) for name in names)


def _unsigned(*names: str) -> tuple[Argument, ...]:
    return tuple(Argument(name, line=LINE_UNSIGNED) for name in names)


def _bytes(*names: str) -> tuple[Argument, ...]:
    return tuple(Argument(name, line=LINE_BYTE) for name in names)


_AXES = _signed("translation", "steering", "turret")
_ORDER = _bytes(*[f"order_{k}" for k in range(16)])
_MODES = [argument for axis in ("translation", "steering", "turret")
          for argument in (Argument(f"{axis}_mode", line=LINE_UNSIGNED), Argument(f"{axis}_value"))]
_FLAGS = tuple(Argument(name, layouts.FLAG_BYTE) for name in ("translation", "steering", "turret"))
_POSE = _signed("x", "y", "steering", "turret")
_SMASK = _signed(*[f"Smask_{k}" for k in range(44)])
_STATE = (shape.STATE, shape.LINE_STATE)
_SIMPLE = (shape.SIMPLE, shape.LINE_STATE)
_LIST = (shape.SIMPLE_LIST, shape.LINE_STATE)
_SPECIAL = (shape.SPECIAL, shape.LINE_SPECIAL)
_OBSTACLE_WORDS = (3, 1 + 2 * layouts.MAX_OBSTACLE_VERTICES)
_PACKET = layouts.UserPacket()


def _arm(name: str, method: str, packet: layouts.ArmPacket, packet_type: int, arguments: tuple[str, ...],
         summary: str) -> Command:
    size = packet.octets
    return _row(name, method, (300, 128), _signed(*arguments), _SPECIAL, summary, tcp_request=layouts.ByteWords(packet),
                tcp_words=(size, size), line_request=packet, line_timeout_s=30.0, packet_type=packet_type)


def _drawing(name: str, tcp_type: int, what: str) -> Command:
    method = f"redraw_{name.removeprefix('refresh_')}"
    return _row(name, method, (tcp_type, None), (), _SIMPLE, f"redraw {what}")


COMMANDS: tuple[Command, ...] = (
    _row("create_robot", "create_robot", (101, None), _signed("robot_id", "pid"), (shape.SIMPLE, shape.LINE_STATE),
         "make a robot of that number and connect to it", extra_arguments=("pid", slice(1, 2))),
    _row("connect_robot", "connect_robot", (102, None), _signed("robot_id", "pid"), (shape.SIMPLE, shape.LINE_STATE),
         "connect to a robot; the answer is a port, 0 for no such robot", extra_arguments=("pid", slice(1, 2))),
    _row("disconnect_robot", "disconnect", (103, None), _signed("robot_id", "pid"), (shape.SIMPLE, shape.LINE_STATE),
         "end the connection; there is no answer", extra_arguments=("pid", slice(1, 2)), has_tcp_reply=False),
    # motion
    _row("ac", "set_accelerations", (10, 1), _unsigned("translation", "steering", "turret"), _STATE,
         "set the accelerations of the axes"),
    _row("sp", "set_speeds", (11, 2), _unsigned("translation", "steering", "turret"), _STATE,
         "set the speeds that pr and pa use"),
    _row("pr", "move", (13, 3), _AXES, _STATE, "move each axis by a distance, all at once"),
    _row("pa", "move_to", (14, 4), _AXES, _STATE, "move each axis to a position (N200)", line_models=N200),
    _row("vm", "drive", (12, 5), _AXES, _STATE, "drive each axis at a velocity until the next command"),
    _row("mv", "drive_axes", (43, 43), _MODES, _STATE, "command each axis in a mode of its own"),
    _row("st", "stop", (17, 9), (), _STATE, "stop and hold"),
    _row("lp", "release", (18, 10), (), _STATE, "let the motors go limp"),
    _row("zr", "zero", (20, 13), (), _STATE, "turn to the bumper's zero, then read position and angles as 0",
         line_timeout_s=120.0),
    _row("ws", "wait_until_still", (39, 31), (*_FLAGS, Argument("timeout_s", line=LINE_BYTE)), _STATE,
         "answer when the named axes are still, or after the timeout"),
    _row("dp", "set_position", (21, 12), _signed("x", "y"), _STATE, "set what the encoders say of the position"),
    _row("da", "set_angles", (38, 30), _signed("steering", "turret"), _STATE,
         "set what the encoders say of the angles"),
    # configuration
    _row("ct", "select_sensors", (16, 6), _SMASK, _STATE, "select the sensors and numbers in replies",
         tcp_request=layouts.TcpMask(), tcp_words=(7, 7), line_request=layouts.LineMask(), line_models=N200,
         extra_arguments=("mask", slice(0, 44))),
    _row("conf_ir", "configure_infrareds", (22, 14), (Argument("history", line=layouts.HISTORY_BYTE), *_ORDER), _STATE,
         "set the infrareds' history and firing order", line_models=N200),
    _row("conf_sn", "configure_sonars", (23, 15), (*_bytes("rate"), *_ORDER), _STATE,
         "set the sonars' firing rate (4 ms steps) and order, and restart the ring"),
    _row("conf_cp", "configure_compass", (24, 16), _bytes("mode"), (shape.STATE, shape.LINE_CALIBRATION),
         "compass off, on, or calibrating", line_models=N200),
    _row("conf_ls", "configure_laser", (25, 17),
         (Argument("mode", line=layouts.LASER_MODE_BYTE), *_bytes("threshold", "width"), *_unsigned("num_data"),
          *_bytes("processing")), _STATE,
         "set the laser's mode and number of columns; threshold, width, processing: no effect in a simulation",
         line_models=N200),
    _row("conf_tm", "set_timeout", (26, 18), _bytes("timeout_s"), _STATE,
         "stop the motion when no command comes for so many seconds; 0 never"),
    _row("conf_sg", "configure_segments", (36, 28), _bytes("threshold", "min_points", "gap"), _STATE,
         "set how laser points become line segments", line_models=N200),
    _row("conf_ser", "configure_serial_port", (None, 35), (*_bytes("port"), *_unsigned("baud")), _STATE,
         "set the speed of another serial port of the robot", line_models=NOT_N200),
    # queries
    _row("gs", "refresh", (15, 7), (), _STATE, "ask for the state"),
    _row("get_ir", "read_infrareds", (27, 19), (), (shape.INFRARED, shape.LINE_INFRARED), "ask for the infrareds",
         line_models=N200),
    _row("get_sn", "read_sonars", (28, 20), (), (shape.SONAR, shape.LINE_SONAR), "ask for the sonars"),
    _row("get_rc", "read_pose", (29, 21), (), (shape.CONFIGURATION, shape.LINE_CONFIGURATION),
         "ask for position and angles"),
    _row("get_rv", "read_velocities", (30, 22), (), (shape.VELOCITY, shape.LINE_VELOCITY), "ask for the velocities"),
    _row("get_ra", "read_accelerations", (31, 23), (), (shape.VELOCITY, shape.LINE_NOTHING),
         "ask for the accelerations"),
    _row("get_cp", "read_compass", (32, 24), (), (shape.COMPASS, shape.LINE_COMPASS), "ask for the compass",
         line_models=N200),
    _row("get_ls", "read_laser", (33, 25), (), (shape.LASER, shape.LINE_LASER), "ask for the laser",
         line_models=N200),
    _row("get_bp", "read_bumpers", (35, 27), (), (shape.BUMPER, shape.LINE_BUMPER), "ask for the bumpers"),
    _row("get_sg", "read_segments", (37, 29), (), (shape.SEGMENTS, shape.LINE_SEGMENTS),
         "ask for the laser's line segments", line_models=N200),
    _row("get_rpx", "read_robots", (75, None), (), _LIST, "ask where all robots are"),
    # speech, special packets, the arm
    _row("tk", "say", (19, 11), (Argument("text"),), _SIMPLE, "say a text",
         tcp_request=layouts.TextWords(), tcp_words=(1, layouts.MAX_TEXT_WORDS), line_request=layouts.LineText(),
         line_models=N200),
    _arm("arm_zr", "arm_zero", layouts.ARM_ZERO, 40, ("override",), "zero the arm"),
    _arm("arm_ws", "arm_wait", layouts.ARM_WAIT, 41, ("lift", "grip", "timeout"), "wait until the arm is still"),
    _arm("arm_mv", "arm_move", layouts.ARM_MOVE, 42, ("lift_mode", "lift_value", "grip_mode", "grip_value"),
         "move the arm"),
    _row("special_request", "send_packet", (300, 128), (Argument("packet_type"),), _SPECIAL,
         "send a user packet; the answer is one too", tcp_request=layouts.ByteWords(_PACKET),
         tcp_words=(4, 4 + layouts.MAX_PACKET_DATA), line_request=_PACKET, line_timeout_s=30.0,
         extra_arguments=("packet_type", slice(0, 1)), any_length=True),
    # the world and its windows (an Nserver only)
    _row("place_robot", "place", (41, None), _POSE, _SIMPLE, "put the robot, and what its encoders say, somewhere"),
    _row("add_obstacle", "add_obstacle", (50, None), _signed("n"), _SIMPLE, "add a polygon to the world",
         tcp_request=layouts.ObstacleWords(), tcp_words=_OBSTACLE_WORDS, any_length=True),
    _row("delete_obstacle", "delete_obstacle", (51, None), _signed("n"), _SIMPLE, "take a polygon away",
         tcp_request=layouts.ObstacleWords(), tcp_words=_OBSTACLE_WORDS, any_length=True),
    _row("move_obstacle", "move_obstacle", (52, None), _signed("n"), _LIST, "shift a polygon",
         tcp_request=layouts.ObstacleWords(tail=2), tcp_words=(5, 3 + 2 * layouts.MAX_OBSTACLE_VERTICES),
         any_length=True),
    _row("new_world", "clear_world", (53, None), (), _SIMPLE, "take all obstacles away"),
    _row("predict_sensors", "predict_sensors", (42, None), _POSE, (shape.PREDICTION, shape.LINE_STATE),
         "ask what the sensors would read elsewhere"),
    _row("motion_check", "check_motion", (400, None), _signed("type"), (shape.COLLISION, shape.LINE_STATE),
         "ask whether a line or an arc hits something", tcp_request=layouts.MotionWords(), tcp_words=(8, 8),
         any_length=True),
    _row("get_robot_conf", "ask_pose", (200, None), (), (shape.CLICKED_CONFIGURATION, shape.LINE_STATE),
         "ask for a pose clicked in the window"),
    _row("draw_robot", "draw_robot", (60, None), (*_POSE, *_signed("mode")), _SIMPLE, "draw a robot"),
    _row("draw_line", "draw_line", (61, None), _signed("x1", "y1", "x2", "y2", "mode"), _SIMPLE, "draw a line"),
    _row("draw_arc", "draw_arc", (62, None), _signed("x0", "y0", "w", "h", "th1", "th2", "mode"), _SIMPLE,
         "draw an arc"),
    _drawing("refresh_all", 150, "everything"),
    _drawing("refresh_all_traces", 151, "both traces"),
    _drawing("refresh_actual_trace", 152, "the trace of the actual robot"),
    _drawing("refresh_encoder_trace", 153, "the trace of the encoder robot"),
    _drawing("refresh_all_sensors", 154, "all sensors"),
    _drawing("refresh_bumper_sensor", 155, "the bumpers"),
    _drawing("refresh_infrared_sensor", 156, "the infrareds"),
    _drawing("refresh_sonar_sensor", 157, "the sonars"),
    _drawing("refresh_laser_sensor", 158, "the laser"),
    _drawing("refresh_client_graphics", 159, "the client's drawings"),
    _row("real_robot", "use_real_robot", (71, None), (), _SIMPLE, "pass the commands to the real robot"),
    _row("simulated_robot", "use_simulated_robot", (74, None), (), _SIMPLE, "pass the commands to the simulation"),
    _row("quit_server", "quit_server", (70, None), (), _SIMPLE, "end the server, if its setup allows it"),
    # additions of this project (docs/protocol.md, Additional messages)
    _row("sim_truth", "truth", (1000, None), (), (shape.TRUTH, shape.LINE_STATE),
         "ask a simulation where the actual robot is"),
    _row("sim_control", "control_time", (1001, None), _signed("verb", "value"), (shape.CONTROL, shape.LINE_STATE),
         "pause, resume, speed or step the simulated time"),
    _row("held_by", "held_by", (1002, None), (), _LIST, "ask which person holds the robot (Stop)"),
)

BY_NAME = {row.name: row for row in COMMANDS}
BY_TCP_TYPE = {row.tcp_type: row for row in COMMANDS if row.tcp_type is not None and row.packet_type is None}
BY_LINE_TYPE = {row.line_type: row for row in COMMANDS if row.line_type is not None and row.packet_type is None}
BY_PACKET_TYPE = {row.packet_type: row for row in COMMANDS if row.packet_type is not None}

NAK_TYPE = 8
ERROR_TYPE = 91
REPLY_TYPES: dict[TcpLayout, int] = {
    shape.STATE: 80, shape.PREDICTION: 80, shape.SIMPLE: 82, shape.SIMPLE_LIST: 82, shape.COLLISION: 82,
    shape.INFRARED: 83, shape.SONAR: 84, shape.LASER: 85, shape.SEGMENTS: 85, shape.COMPASS: 86,
    shape.BUMPER: 87, shape.CONFIGURATION: 88, shape.CLICKED_CONFIGURATION: 88, shape.VELOCITY: 89,
    shape.ERROR: ERROR_TYPE, shape.SPECIAL: 300, shape.TRUTH: 1000, shape.CONTROL: 1001,
}
"""Type of a reply over TCP by layout. Clients only check for ERROR_TYPE."""

# Maximum sizes: a stamp has 9 words, a laser block a count and up to 4 words per reading.
_STAMP_WORDS = 9
_LASER_WORDS = 1 + 4 * MAX_LASER_READINGS
_STATE_WORDS = 45 + _LASER_WORDS + 35 * _STAMP_WORDS + 3
MAX_REPLY_WORDS = {
    80: _STATE_WORDS, 81: _STATE_WORDS, 82: 1024, 83: 17 + 16 * _STAMP_WORDS, 84: 17 + 16 * _STAMP_WORDS,
    85: _LASER_WORDS + _STAMP_WORDS + 1, 86: 2 + _STAMP_WORDS, 87: 2 + _STAMP_WORDS, 88: 4, 89: 3, 90: 3,
    ERROR_TYPE: 1, 300: 4 + layouts.MAX_PACKET_DATA, 1000: 8, 1001: 4,
}
"""Maximum words of a reply by type; types 81 and 90 exist in old servers."""


def exists_on_serial(row: Command, model: Model) -> bool:
    """Return True if the command exists on this model's serial line."""
    return row.line_type is not None and model.name in row.line_models
