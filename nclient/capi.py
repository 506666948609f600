"""Nclient.h in Python: the same names and argument orders, State, Smask, Laser, TRUE and FALSE.

    from nclient import capi               # strcpy(SERVER_MACHINE_NAME, "lab"); SERV_TCP_PORT = 7654;
    from nclient.capi import *
    capi.SERVER_MACHINE_NAME = "lab"
    capi.SERV_TCP_PORT = 7654
    if connect_robot(1):
        sp(200, 450, 450)
        vm(100, 0, 0)
        while State[17] > 20:              # while (State[STATE_SONAR_0] > 20)
            gs()
        st()
        print("stopped at", State[34], State[35], "tenths of an inch")
        disconnect_robot(1)

As in the C library nothing is raised and nothing printed: a call returns TRUE, or FALSE if it was refused or the link
is lost (`last_error` has the reason); State[44] has the code of a refusal, 111 without a server. Calls whose reply has
no values, such as tk and place_robot, return TRUE also if the server refuses them. Numbers are in wire units, truncated
to integers as in C, and clamped on a serial line to what it can carry. A list stands for a C array or pointer and is
filled in place. One program, one thread, one robot. The settings in capitals are module variables: assign them as
`capi.NAME`, since an import with * only copies them.
connect_robot(1, MODEL_N150, "/dev/ttyUSB0", 38400), as in the direct library, opens a robot's serial line: bumper bits
as they come (State[33] is 0xF00000 at rest), a NAK is a success, State[0], [42] and [44] are left alone.
"""

from collections.abc import Callable, MutableSequence, Sequence
from typing import Any

from nclient.backends.base import Backend
from nclient.connector import ConnectOptions, is_listening, open_line, open_machine
from nclient.errors import ConnectionLost, NomadError, RobotRefused
from nclient.protocol import types
from nclient.protocol.client_state import STATE_SIZE, ClientState
from nclient.protocol.codec import clamp_to_serial
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.layouts import MAX_LASER_READINGS, MOTION_LINE
from nclient.protocol.replies import SIMPLE, Reply, text_of
from nclient.protocol.types import CPU_RANGE_V, EVERYTHING, MOTOR_RANGE_V, N150, N200, Position, volts
from nclient.state import WHEEL_IN_PER_DEG

__all__ = [
    "FALSE", "LEFT", "MODEL_N150", "MODEL_N200", "MODEL_SCOUT", "RIGHT", "ROTATION_CONSTANT", "TRUE", "Laser",
    "Smask", "State", "ac", "add_obstacle", "arm_mv", "arm_ws", "arm_zr", "conf_cp", "conf_ir", "conf_ls", "conf_ser",
    "conf_sg", "conf_sn", "conf_tm", "connect_robot", "create_robot", "ct", "da", "delete_obstacle",
    "disconnect_robot", "dp", "draw_arc", "draw_line", "draw_robot", "get_bp", "get_cp", "get_ir", "get_ls", "get_ra",
    "get_rc", "get_robot_conf", "get_rpx", "get_rv", "get_sg", "get_sn", "gs", "held_by", "last_error", "lp",
    "motion_check", "move_obstacle", "mv", "new_world", "pa", "place_robot", "posBumperGet", "posCompassGet",
    "posDataCheck", "posDataRequest", "posInfraredGet", "posInfraredRingGet", "posLaserGet", "posSonarGet",
    "posSonarRingGet", "posTimeGet", "pr", "predict_sensors", "quit_server", "real_robot", "refresh_actual_trace",
    "refresh_all", "refresh_all_sensors", "refresh_all_traces", "refresh_bumper_sensor", "refresh_client_graphics",
    "refresh_encoder_trace", "refresh_infrared_sensor", "refresh_laser_sensor", "refresh_sonar_sensor", "scout_pr",
    "scout_vm", "server_is_running", "sim_control", "sim_truth", "simulated_robot", "sp", "special_request", "st",
    "tk", "vm", "voltCpuGet", "voltMotorGet", "ws", "zr",
]  # fmt: skip

TRUE, FALSE = 1, 0
MODEL_N200, MODEL_N150, MODEL_SCOUT = N200.number, N150.number, types.SCOUT.number
ROTATION_CONSTANT = WHEEL_IN_PER_DEG
"""Inches that a wheel of a Scout travels per degree of turn."""

SERVER_MACHINE_NAME = ""
"""Host of the server, host:port, or an address such as nserver://lab:7654/1 or sim:thesis_room, whose robot number must
agree with that of connect_robot. If empty, the address of NOMAD_ROBOT as for C programs, else this machine."""
SERV_TCP_PORT = 7019
"""Port of the server, if its name has none."""
ANSWER_TIMEOUT_S: float | None = None
"""Maximum time for a reply in seconds; None: 5 over TCP, on a serial line as in the C library."""

State: list[int] = [0] * STATE_SIZE
Smask: list[int] = list(EVERYTHING.smask)
"""The mask that ct sends, 44 numbers. connect_robot switches everything on and position data off."""
Laser: list[int] = [0] * (1 + 2 * MAX_LASER_READINGS)

Ints = Sequence[int]
Out = MutableSequence[Any]
NO_SERVER = 111
"""State[44] after a call that found no server or lost it."""
_PACKET_HEAD = 4
_NO_SUCH_MODES = frozenset({6, 7, 8})
_NAK = Reply("nak")
"""A refusal that the C library takes for success."""

_backend: Backend | None = None
_client_state = ClientState()
_error: NomadError | None = None


def last_error() -> NomadError | None:
    """Return the error of the last call that failed; the C library has no such function."""
    return _error


def _command(name: str, about: str) -> Callable[[], int]:
    """Return the function of a command without arguments; `about` is its docstring."""

    def call() -> int:
        return _send(name)

    call.__name__ = call.__qualname__ = name
    call.__doc__ = about
    return call


# -- connecting -------------------------------------------------------------------------------------------------------


def connect_robot(robot_id: int, model: int | None = None, dev: str = "", conn: int = 0) -> int:
    """Connect to a robot, after disconnecting from the last one.

    Parameters
    ----------
    robot_id
        Number of the robot on the server.
    model
        MODEL_N200, MODEL_N150 or MODEL_SCOUT: open the robot's serial line, as the direct library does.
    dev, conn
        With a model: a device (/dev/ttyUSB0) and its baud rate, or a host and its TCP port.

    Returns
    -------
    int
        The server's port, TRUE on a serial line, or FALSE.
    """
    return _connect(robot_id, line=None if model is None else (int(model), dev, int(conn)))


def create_robot(robot_id: int) -> int:
    """Create a robot of that number and connect to it; return the server's port, or FALSE."""
    return _connect(robot_id, create=True)


def disconnect_robot(robot_id: int) -> int:
    """Disconnect."""
    global _backend
    del robot_id
    # Forgotten before it is closed, so that an error while closing leaves no half-closed connection.
    open_backend, _backend = _backend, None
    if open_backend is None or open_backend.closed:
        return FALSE
    open_backend.close()
    return TRUE


def server_is_running() -> int:
    """Return TRUE if a server accepts connections at SERVER_MACHINE_NAME and SERV_TCP_PORT."""
    return int(is_listening(SERVER_MACHINE_NAME, int(SERV_TCP_PORT)))


quit_server = _command("quit_server", "End the server, if its setup allows it.")
real_robot = _command("real_robot", "Send commands to the real robot.")
simulated_robot = _command("simulated_robot", "Send commands to the simulation.")


# -- motion -----------------------------------------------------------------------------------------------------------


def ac(t_ac: int, s_ac: int, r_ac: int) -> int:
    """Set the accelerations of translation, steering and turret."""
    return _send("ac", t_ac, s_ac, r_ac)


def sp(t_sp: int, s_sp: int, r_sp: int) -> int:
    """Set the speeds of pr."""
    return _send("sp", t_sp, s_sp, r_sp)


def pr(t_pr: int, s_pr: int, r_pr: int) -> int:
    """Move each axis by a distance."""
    return _send("pr", t_pr, s_pr, r_pr)


def pa(t_pa: int, s_pa: int, r_pa: int) -> int:
    """Move each axis to an absolute position: only on an N200's serial line, refused by the client elsewhere."""
    # Only the direct library sends pa.
    if _backend is not None and _backend.wire_state.line:
        return _send("pa", t_pa, s_pa, r_pa)
    return _refuse("pa", "clients of an Nserver do not send it")


def vm(t_vm: int, s_vm: int, r_vm: int) -> int:
    """Drive each axis at a velocity."""
    return _send("vm", t_vm, s_vm, r_vm)


def mv(t_mode: int, t_mv: int, s_mode: int, s_mv: int, r_mode: int, r_mv: int) -> int:
    """Command each axis in its own mode: 0 leave, 1 velocity, 2 relative, 3 limp, 4 acceleration, 5 speed.

    Modes 6, 7 and 8 are refused by the client, and not sent.
    """
    if not _NO_SUCH_MODES.isdisjoint((int(t_mode), int(s_mode), int(r_mode))):
        return _refuse("mv", "clients of an Nserver do not send modes 6, 7 and 8")
    return _send("mv", t_mode, t_mv, s_mode, s_mv, r_mode, r_mv)


def RIGHT(trans: int, steer: int) -> int:
    """Return the velocity of a Scout's right wheel (1/10 in/s) for a translation and a steering (1/10 deg/s)."""
    return trans + int(steer * ROTATION_CONSTANT)


def LEFT(trans: int, steer: int) -> int:
    """Return the velocity of a Scout's left wheel (1/10 in/s) for a translation and a steering (1/10 deg/s)."""
    return trans - int(steer * ROTATION_CONSTANT)


def scout_vm(trans: int, steer: int) -> int:
    """Send vm to a Scout, by translation and steering."""
    return vm(RIGHT(trans, steer), LEFT(trans, steer), 0)


def scout_pr(trans: int, steer: int) -> int:
    """Send pr to a Scout, by translation and steering."""
    return pr(RIGHT(trans, steer), LEFT(trans, steer), 0)


st = _command("st", "Stop and hold.")
lp = _command("lp", "Switch the motors off.")
zr = _command("zr", "Turn steering and turret to the bumper's zero.")


def ws(t_ws: int, s_ws: int, r_ws: int, timeout: int) -> int:
    """Wait until the axes with a flag are still, at most `timeout` seconds."""
    return _send("ws", t_ws, s_ws, r_ws, timeout)


def dp(x: int, y: int) -> int:
    """Set the position of the encoders."""
    return _send("dp", x, y)


def da(th: int, tu: int) -> int:
    """Set the angles of the encoders."""
    return _send("da", th, tu)


def place_robot(x: int, y: int, th: int, tu: int) -> int:
    """Place the robot and its encoders."""
    return _send("place_robot", x, y, th, tu)


# -- settings ---------------------------------------------------------------------------------------------------------


def ct() -> int:
    """Send Smask: the sensors and numbers that State has from now on."""
    return _send("ct", Smask[0], *[int(bool(flag)) for flag in Smask[1:types.SLOTS]])


def conf_ir(history: int, order: Ints) -> int:
    """Set history and firing order (int[16]) of the infrareds."""
    return _send("conf_ir", history, *order[:16])


def conf_sn(rate: int, order: Ints) -> int:
    """Set firing rate (4 ms steps) and order (int[16], 255 ends it) of the sonars."""
    return _send("conf_sn", rate, *order[:16])


def conf_cp(mode: int) -> int:
    """Set the compass: 0 off, 1 on, 2 calibrate."""
    return _send("conf_cp", mode)


def conf_ls(mode: int, threshold: int, width: int, num_data: int, processing: int) -> int:
    """Set mode and parameters of the laser."""
    return _send("conf_ls", mode, threshold, width, num_data, processing)


def conf_tm(timeout: int) -> int:
    """Set the motion timeout in seconds: the robot stops if no command arrives for that long."""
    return _send("conf_tm", timeout)


def conf_sg(threshold: int, min_points: int, gap: int) -> int:
    """Set how laser points are combined to line segments."""
    return _send("conf_sg", threshold, min_points, gap)


def conf_ser(port: int, baud: int) -> int:
    """Set the speed of another serial port; on a serial line only."""
    return _send("conf_ser", port, baud)


# -- queries ----------------------------------------------------------------------------------------------------------


gs = _command("gs", "Query the whole State.")
get_ir = _command("get_ir", "Query the infrareds: State[1] to State[16].")
get_sn = _command("get_sn", "Query the sonars: State[17] to State[32].")
get_rc = _command("get_rc", "Query position and angles: State[34] to State[37].")
get_rv = _command("get_rv", "Query the velocities: State[38] to State[40].")
get_ra = _command("get_ra", "Query the accelerations, in the slots of the velocities: State[38] to State[40].")
get_cp = _command("get_cp", "Query the compass: State[43].")
get_ls = _command("get_ls", "Query the laser: Laser.")
get_sg = _command("get_sg", "Query the laser's line segments: Laser.")
get_bp = _command("get_bp", "Query the bumpers: State[33].")


def get_rpx(robot_pos: Out) -> int:
    """Query all robots: robot_pos is filled with n and n times x, y, heading."""
    return _fill(robot_pos, _values("get_rpx"))


def get_robot_conf(conf: Out) -> int:
    """Query a pose clicked in the server's window: conf is filled with x, y, steering, turret."""
    return _fill(conf, _values("get_robot_conf"))


# -- position data, clock, battery ------------------------------------------------------------------------------------


def posDataRequest(posRequest: int) -> int:
    """Select position data: the sum of 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass. FALSE for other bits."""
    if int(posRequest) not in range(sum(Position) + 1):
        return _refuse("posDataRequest", f"{posRequest} is no sum of 1, 2, 4, 8, 16")
    Smask[0] = int(posRequest)
    return ct()


def posDataCheck() -> int:
    """Return the selected position data."""
    return Smask[0]


def posInfraredRingGet(posData: Out) -> int:
    """Fill posData with the position data of the sixteen infrareds, each a list of nine numbers.

    These are x, y, steer, turret, v_trans, v_steer, v_turret, time of the pose, time of the reading.
    """
    return _fill(posData, [_stamp(key) for key in types.INFRARED_KEYS])


def posInfraredGet(posData: Out, infraredNumber: int) -> int:
    """Fill posData with the nine numbers of one infrared."""
    return _fill(posData, _stamp(f"ir_{infraredNumber}") if infraredNumber in range(16) else None)


def posSonarRingGet(posData: Out) -> int:
    """Fill posData with the position data of the sixteen sonars, each a list of nine numbers."""
    return _fill(posData, [_stamp(key) for key in types.SONAR_KEYS])


def posSonarGet(posData: Out, sonarNumber: int) -> int:
    """Fill posData with the nine numbers of one sonar."""
    return _fill(posData, _stamp(f"sonar_{sonarNumber}") if sonarNumber in range(16) else None)


def posBumperGet(posData: Out) -> int:
    """Fill posData with the nine numbers of the bumpers."""
    return _fill(posData, _stamp("bumper"))


def posLaserGet(posData: Out) -> int:
    """Fill posData with the nine numbers of the laser."""
    return _fill(posData, _stamp("laser"))


def posCompassGet(posData: Out) -> int:
    """Fill posData with the nine numbers of the compass."""
    return _fill(posData, _stamp("compass"))


def posTimeGet() -> int:
    """Return the robot's clock in milliseconds, as last received."""
    return _client_state.clock or 0


def voltCpuGet() -> float:
    """Return the voltage of the computer's battery, as last received."""
    return volts(_client_state.volts[0], CPU_RANGE_V) if _client_state.volts else 0.0


def voltMotorGet() -> float:
    """Return the voltage of the motors' battery, as last received."""
    return volts(_client_state.volts[1], MOTOR_RANGE_V) if _client_state.volts else 0.0


# -- speech, special packets, the arm ---------------------------------------------------------------------------------


def tk(talk: str) -> int:
    """Speak a text."""
    return int(_reply("tk", talk) is not None)


def special_request(user_send_buffer: Ints, user_receive_buffer: Out) -> int:
    """Send a whole packet (length low, length high, serial, type, bytes) and fill the receive buffer with the reply."""
    if len(user_send_buffer) < _PACKET_HEAD:
        return _refuse("special_request", "a packet starts with its length (two bytes), serial and type")
    # The length includes its own two bytes, serial and type; the type is the first byte that is sent.
    length = user_send_buffer[0] | user_send_buffer[1] << 8
    return _fill(user_receive_buffer, _values("special_request", *user_send_buffer[3:length]))


def arm_zr(override: int) -> int:
    """Zero the arm; return its result, or FALSE."""
    return _arm("arm_zr", override)[0]


def arm_ws(lift: int, grip: int, timeout: int, time_remain: Out) -> int:
    """Wait until the arm is still; return its result, or FALSE. time_remain[0] is the rest of the timeout."""
    result, remaining = _arm("arm_ws", lift, grip, timeout)
    _fill(time_remain, [remaining])
    return result


def arm_mv(l_mode: int, l_v: int, g_mode: int, g_v: int) -> int:
    """Move lift and grip of the arm; return its result, or FALSE."""
    return _arm("arm_mv", l_mode, l_v, g_mode, g_v)[0]


# -- the world and its windows ----------------------------------------------------------------------------------------


def add_obstacle(obs: Ints) -> int:
    """Add a polygon: n, x1, y1 .. xn, yn."""
    return _send("add_obstacle", *_polygon(obs))


def delete_obstacle(obs: Ints) -> int:
    """Remove a polygon: n, x1, y1 .. xn, yn."""
    return _send("delete_obstacle", *_polygon(obs))


def move_obstacle(obs: Out, dx: int, dy: int) -> int:
    """Shift a polygon; obs is filled with its new corners."""
    return _fill(obs, _values("move_obstacle", *_polygon(obs), dx, dy))


new_world = _command("new_world", "Remove all obstacles.")


def predict_sensors(x: int, y: int, th: int, tu: int, state: Out, laser: Out) -> int:
    """Predict the readings of the sensors at another pose: fill state[1] to state[32] and the laser vector."""
    # state[0] and state[33] on are not changed.
    reply = _reply("predict_sensors", x, y, th, tu)
    if reply is None:
        return FALSE
    state[1:33] = reply.values[1:33]
    return _fill(laser, reply.laser or (0,))


def motion_check(type: int, a1: float, a2: float, a3: float, a4: float, a5: float, a6: float, a7: float,
                 collide: Out) -> int:
    """Check a line (type 0: x1 y1 x2 y2) or an arc (type 1: x1 y1 angle1 angle2 radius xc yc) for collisions.

    Returns 1 if there is one, and fills collide with x, y and the inward normal in radians; 0 if not, or on error.
    """
    # A line has four numbers, an arc seven; doubles are sent in thousandths.
    numbers = (a1, a2, a3, a4) if type == MOTION_LINE else (a1, a2, a3, a4, a5, a6, a7)
    reply = _reply("motion_check", type, *[1000 * number for number in numbers])
    if reply is None:
        return FALSE
    hit, x, y, normal = reply.values
    _fill(collide, [x / 100, y / 100, normal / 1e6])
    return hit


def draw_robot(x: int, y: int, th: int, tu: int, mode: int) -> int:
    """Draw a robot."""
    return _send("draw_robot", x, y, th, tu, mode)


def draw_line(x_1: int, y_1: int, x_2: int, y_2: int, mode: int) -> int:
    """Draw a line."""
    return _send("draw_line", x_1, y_1, x_2, y_2, mode)


def draw_arc(x_0: int, y_0: int, w: int, h: int, th1: int, th2: int, mode: int) -> int:
    """Draw an arc of the ellipse in a bounding box."""
    return _send("draw_arc", x_0, y_0, w, h, th1, th2, mode)


refresh_all = _command("refresh_all", "Redraw everything.")
refresh_all_traces = _command("refresh_all_traces", "Redraw both traces.")
refresh_actual_trace = _command("refresh_actual_trace", "Redraw the trace of the actual robot.")
refresh_encoder_trace = _command("refresh_encoder_trace", "Redraw the trace of the encoder robot.")
refresh_all_sensors = _command("refresh_all_sensors", "Redraw all sensors.")
refresh_bumper_sensor = _command("refresh_bumper_sensor", "Redraw the bumpers.")
refresh_infrared_sensor = _command("refresh_infrared_sensor", "Redraw the infrareds.")
refresh_sonar_sensor = _command("refresh_sonar_sensor", "Redraw the sonars.")
refresh_laser_sensor = _command("refresh_laser_sensor", "Redraw the laser.")
refresh_client_graphics = _command("refresh_client_graphics", "Redraw the drawings of clients.")


# -- simulations of this project; Nclient.h has none of these ---------------------------------------------------------


def sim_truth(truth: Out) -> int:
    """Fill truth with eight numbers: 1, ms, x, y (1/1000 in), heading, turret (1/1000 deg), seed, id."""
    return _fill(truth, _values("sim_truth"))


def held_by() -> str:
    """Return which person holds the robot (Stop on the page), "" if no person does or the server cannot say."""
    values = _values("held_by")
    return text_of(values) if values else ""


def sim_control(verb: int, value: int) -> int:
    """Control simulated time: 1 pause, 2 resume, 3 speed x 10, 4 step by ms."""
    return _send("sim_control", verb, value)


# -- helpers ----------------------------------------------------------------------------------------------------------


def _connect(robot_id: int, *, create: bool = False, line: tuple[int, str, int] | None = None) -> int:
    global _backend, _error, _client_state
    if _backend is not None:
        disconnect_robot(robot_id)
    try:
        # Settings in capitals are read at each connection, since a program may assign them at any time.
        options = ConnectOptions(ANSWER_TIMEOUT_S, int(robot_id), create)
        if line is None:
            _backend = open_machine(SERVER_MACHINE_NAME, int(SERV_TCP_PORT), options)
        else:
            _backend = open_line(*line, options)
    except NomadError as error:
        _error = error
        if isinstance(error, ConnectionLost):
            _apply(Reply("error", values=(NO_SERVER,)))
        return FALSE
    # What the C library sets on connecting: the mask in force, and the state that came with it.
    Smask[:] = (_backend.wire_state.mask if _backend.wire_state.model.sends_mask else EVERYTHING).smask
    _client_state = ClientState()
    if _backend.greeting is not None:
        _apply(_backend.greeting)
    return _backend.port


def _reply(name: str, *args: Any) -> Reply | None:
    """Return the reply to a call; None if it failed, with the error in `_error`."""
    global _error
    if _backend is None:
        _error = ConnectionLost(f"{name}: connect_robot first")
        _apply(Reply("error", values=(NO_SERVER,)))
        return None
    try:
        call = Call(name, args)
        reply = _backend.execute(clamp_to_serial(call) if _backend.wire_state.line else call)
    except NomadError as error:
        _error = error
        if not isinstance(error, RobotRefused):
            if _backend.closed:
                _apply(Reply("error", values=(NO_SERVER,)))
            return None
        # As in the C library a NAK on the serial line is a success, and a call whose reply has no values succeeds also
        # if the server refuses it. Another refusal sets State[44].
        if error.is_nak or (error.code is not None and BY_NAME[name].tcp_reply is SIMPLE):
            return _NAK
        if error.code is not None:
            _apply(Reply("error", values=(error.code,)))
        return None
    _apply(reply)
    return reply


def _send(name: str, *args: float) -> int:
    """Send a command with integer arguments; return TRUE or FALSE."""
    return int(_reply(name, *[int(number) for number in args]) is not None)


def _values(name: str, *args: float) -> Sequence[int] | None:
    reply = _reply(name, *[int(number) for number in args])
    return None if reply is None else reply.values


def _arm(name: str, *args: int) -> tuple[int, int]:
    """Return result and rest of the timeout from the arm's packet."""
    data = bytes(value & 255 for value in _values(name, *args) or ())[_PACKET_HEAD:]
    return int.from_bytes(data[:4], "little", signed=True), int.from_bytes(data[4:8], "little")


def _apply(reply: Reply) -> None:
    _client_state.apply_reply(reply)
    # In place: `from nclient.capi import *` has bound the lists to the program's own names.
    State[:] = [old if value is None else value for old, value in zip(State, _client_state.slots, strict=True)]
    if _client_state.laser is not None:
        Laser[: len(_client_state.laser)] = _client_state.laser


def _fill(target: Out, values: Sequence[Any] | None) -> int:
    """Write values to the start of a C array; FALSE if there are none."""
    if values is None:
        return FALSE
    target[: len(values)] = values
    return TRUE


def _stamp(key: str) -> list[int]:
    return list(_client_state.stamps.get(key, types.NO_STAMP))


def _polygon(obs: Ints) -> Ints:
    # obs[0] corners follow; a C array may be longer than that.
    return obs[: 1 + 2 * obs[0]] if obs else obs


def _refuse(name: str, reason: str) -> int:
    global _error
    _error = RobotRefused(name, None, reason)
    return FALSE
