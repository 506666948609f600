"""Robot: one method per command, in plain verbs and units, for every kind of connection.

    robot.drive(translation_m_s=0.2, steering_deg_s=-5)    the keyword names the unit; what is not given is 0
    state = robot.refresh()                                motions, settings and queries return the RobotState

Each docstring names the function of Nclient.h ("C: vm"). Every method may raise ConnectionLost, ReplyTimeout and
RobotRefused; methods with a quantity raise TypeError if it is given in two units, and ValueError if it is not finite.
Inches per second are `_in_s`, metres `_m_s`, degrees `_deg_s`, radians `_rad_s`; angles are counter-clockwise positive.
A Scout has no turret and two wheels: translation and steering of `drive`, `move` and settings are converted to them.
"""

import contextlib
import math
import os
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from types import TracebackType
from typing import Any, Final, Literal, NamedTuple, Self

import nclient.state as states
from nclient.backends.base import Backend, LinkStatistics
from nclient.errors import BumperHit, ConnectionLost, ReplyTimeout, RobotHeld, RobotRefused, WireError
from nclient.protocol import types
from nclient.protocol.client_state import READ, RESTART, RING_PACKET, ClientState, RingReadings, parse_ring
from nclient.protocol.commands import Call
from nclient.protocol.layouts import MOTION_ARC, MOTION_LINE
from nclient.protocol.replies import Reply, text_of
from nclient.protocol.types import SONAR_SLOTS, Mask, Model, Position, rad_from_tenths, tenths_from_rad, unwrap_word
from nclient.state import AxisCommand, Points, Pose, RobotState, Truth, points_tenths, tenths_of

RING: Final = range(SONAR_SLOTS)
_PACKET_HEAD: Final = 4
"""Bytes of a special packet before its data: length (two bytes), serial number, type."""
_LEAVE: Final = AxisCommand()
_TIME_VERBS: Final = {"pause": 1, "resume": 2, "speed": 3, "step": 4}
_TIME_SCALES: Final = {"speed": 10, "step": 1000}
"""sim_control takes tenths of a factor, and milliseconds."""
_MAX_STEP_S: Final = 1.0
"""Longest step of simulated time in one request, so that a signal ends a long `sleep`."""
_PAUSED_POLL_S: Final = 0.05
"""Interval between two queries of a clock that stands."""
_NOT_IN_STATE: Final = frozenset({"get_ra"})
"""Its reply has accelerations where the state has velocities; the C library overwrites them, `Robot` does not."""


class Accelerations(NamedTuple):
    """The reply to get_ra, in inches and degrees per second squared; of a Scout right wheel, left wheel, 0."""

    translation_in_s2: float
    steering_deg_s2: float
    turret_deg_s2: float


class ArmAnswer(NamedTuple):
    """The arm's reply: its result, and the rest of the timeout in the arm's unit."""

    result: int
    remaining: int


class Arc(NamedTuple):
    """A circular path: start point, start and end angle, radius, centre; inches and radians."""

    x_in: float
    y_in: float
    from_rad: float
    to_rad: float
    radius_in: float
    centre_x_in: float
    centre_y_in: float


class Collision(NamedTuple):
    """The point where a path first touches an obstacle, and the direction of the normal away from it."""

    x_in: float
    y_in: float
    normal_rad: float


class RobotPlace(NamedTuple):
    """Position and heading of one of the server's robots."""

    x_in: float
    y_in: float
    heading_rad: float


class Prediction(NamedTuple):
    """Predicted readings: infrareds 0..15, sonars in inches, the laser vector in 1/10 inch."""

    infrareds: tuple[int, ...]
    sonars_in: tuple[int, ...]
    laser: tuple[int, ...]


class SimulatedTime(NamedTuple):
    """The clock of a simulation in seconds, its speed (0: as fast as possible), and True if it is paused."""

    time_s: float
    factor: float
    paused: bool


class Robot:
    """A connected robot, made by `nclient.connect`. Leaving its `with` block stops the robot and disconnects.

    Methods may be called from several threads; exchanges do not overlap.
    """

    def __init__(self, backend: Backend, *, lockstep: bool = False) -> None:
        self._backend = backend
        # True if time passes by the requests of this robot only: sim: and replay: addresses.
        self._lockstep = lockstep
        self._unslept_s = 0.0
        self._client_state = ClientState()
        self._applied: Reply | None = None
        self._lock = threading.RLock()
        self._pid = os.getpid()
        # Readings of a ring that State has no room for; None: those of State.
        self._ring_in: tuple[float, ...] | None = None
        # Replies update the client state, of which every exchange takes an immutable snapshot.
        if backend.greeting is not None:
            self._client_state.apply_reply(backend.greeting)
        self._state = states.snapshot(self._client_state, backend.wire_state.model)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._is_inherited:
            return
        try:
            # A lost link raises nothing here: the robot stops by its motion timeout.
            with contextlib.suppress(ConnectionLost, ReplyTimeout):
                self.stop()
        except (RobotRefused, BumperHit):
            if error is None:
                raise
        finally:
            self.disconnect()

    @property
    def model(self) -> Model:
        """The robot's model, as the address or the recording names it."""
        return self._backend.wire_state.model

    def _repr_html_(self) -> str:
        return states.state_html(self.state, ", disconnected" if self.closed else "")

    @property
    def closed(self) -> bool:
        """True if the connection is over; every method then raises ConnectionLost."""
        return self._backend.closed

    @property
    def _is_inherited(self) -> bool:
        """True in a forked child: the connection is its parent's, and is neither stopped nor closed by the child."""
        return os.getpid() != self._pid

    @property
    def link(self) -> LinkStatistics | None:
        """Statistics of the link; print them for a summary. None over TCP without `reconnect=` in the address."""
        return self._backend.link

    @property
    def state(self) -> RobotState:
        """The state after the last exchange; sends nothing and never waits."""
        return self._state

    def execute(self, call: Call) -> Reply:
        """Execute a command of `nclient.protocol.commands` in wire units and return its reply."""
        with self._lock:
            try:
                reply = self._backend.execute(call)
            except RobotRefused as refusal:
                # As in the C library, State[44] has the code of an ERROR reply; a NAK has none.
                if refusal.code is not None:
                    self._apply(Reply("error", values=(refusal.code,)))
                raise
            if call.name not in _NOT_IN_STATE:
                self._apply(reply)
            return reply

    def disconnect(self) -> None:
        """Close the connection; the robot is not stopped. May be called twice. C: disconnect_robot."""
        if not self._is_inherited:
            self._backend.close()

    # -- motion -------------------------------------------------------------------------------------------------------

    def drive(self, *, translation_in_s: float | None = None, translation_m_s: float | None = None,
              steering_deg_s: float | None = None, steering_rad_s: float | None = None,
              turret_deg_s: float | None = None, turret_rad_s: float | None = None) -> RobotState:
        """Drive each axis at a velocity until the next motion command; an axis that is not given stands. C: vm.

        Parameters
        ----------
        translation_in_s, translation_m_s
            Velocity along the steering direction, in steps of 0.1 in/s.
        steering_deg_s, steering_rad_s
            Turn rate of the steering, of a Scout of its body, in steps of 0.1 deg/s.
        turret_deg_s, turret_rad_s
            Turn rate of the turret.

        Raises
        ------
        RobotRefused
            If a Scout gets a turn rate of the turret.
        """
        return self._command_axes("vm", tenths_of(translation_in_s=translation_in_s, translation_m_s=translation_m_s),
                                  tenths_of(steering_deg_s=steering_deg_s, steering_rad_s=steering_rad_s),
                                  tenths_of(turret_deg_s=turret_deg_s, turret_rad_s=turret_rad_s))

    def move(self, *, translation_in: float | None = None, translation_m: float | None = None,
             steering_deg: float | None = None, steering_rad: float | None = None,
             turret_deg: float | None = None, turret_rad: float | None = None) -> RobotState:
        """Move all axes by distances, at the speeds of `set_speeds`; does not wait for the end. C: pr.

        Parameters
        ----------
        translation_in, translation_m
            Distance along the steering direction, negative backwards, in steps of 0.1 in.
        steering_deg, steering_rad
            Angle of the steering, of a Scout of its body, in steps of 0.1 deg.
        turret_deg, turret_rad
            Angle of the turret.

        Raises
        ------
        RobotRefused
            If a Scout gets an angle of the turret.
        """
        return self._command_axes("pr", tenths_of(translation_in=translation_in, translation_m=translation_m),
                                  tenths_of(steering_deg=steering_deg, steering_rad=steering_rad),
                                  tenths_of(turret_deg=turret_deg, turret_rad=turret_rad))

    def move_to(self, *, translation_in: float | None = None, translation_m: float | None = None,
                steering_deg: float | None = None, steering_rad: float | None = None,
                turret_deg: float | None = None, turret_rad: float | None = None) -> RobotState:
        """Move each axis to an absolute encoder position, 0 where not given; only on an N200's serial line. C: pa.

        Units as in `move`. Raises RobotRefused for other models and for servers.
        """
        return self._command("pa", tenths_of(translation_in=translation_in, translation_m=translation_m),
                             tenths_of(steering_deg=steering_deg, steering_rad=steering_rad),
                             tenths_of(turret_deg=turret_deg, turret_rad=turret_rad))

    def drive_axes(self, translation: AxisCommand = _LEAVE, steering: AxisCommand = _LEAVE,
                   turret: AxisCommand = _LEAVE) -> RobotState:
        """Command each axis in its own mode. C: mv.

        Without arguments it changes nothing, which old programs use as a ping.

        Parameters
        ----------
        translation, steering, turret
            From `AxisCommand`; of a Scout right wheel, left wheel, none.
        """
        return self._command("mv", *translation, *steering, *turret)

    def drive_wheels(self, *, right_in_s: float | None = None, left_in_s: float | None = None,
                     right_m_s: float | None = None, left_m_s: float | None = None) -> RobotState:
        """Drive the wheels of a Scout at velocities. Raises RobotRefused for other models. C: vm."""
        self._require_wheels("vm")
        right = tenths_of(right_in_s=right_in_s, right_m_s=right_m_s)
        return self._command("vm", right, tenths_of(left_in_s=left_in_s, left_m_s=left_m_s), 0)

    def move_wheels(self, *, right_in: float | None = None, left_in: float | None = None,
                    right_m: float | None = None, left_m: float | None = None) -> RobotState:
        """Move the wheels of a Scout by distances. Raises RobotRefused for other models. C: pr."""
        self._require_wheels("pr")
        right = tenths_of(right_in=right_in, right_m=right_m)
        return self._command("pr", right, tenths_of(left_in=left_in, left_m=left_m), 0)

    def stop(self) -> RobotState:
        """Stop all axes and hold them. C: st."""
        return self._command("st")

    def release(self) -> RobotState:
        """Switch the motors off, so that the robot can be pushed. C: lp."""
        return self._command("lp")

    def zero(self) -> RobotState:
        """Turn steering and turret to the bumper's zero and set position and angles to 0; may take 120 s. C: zr."""
        return self._command("zr")

    def wait_until_still(self, timeout_s: float = 20, *, translation: bool = True, steering: bool = True,
                         turret: bool = True) -> RobotState:
        """Wait until the selected axes are still. A timeout stops nothing and raises nothing. C: ws.

        Parameters
        ----------
        timeout_s
            Maximum wait in seconds of the robot's time, rounded up to whole seconds.
        translation, steering, turret
            The axes to wait for.

        Returns
        -------
        RobotState
            The state at the end; `moving` is True after a timeout.
        """
        return self._command("ws", int(translation), int(steering), int(turret), _whole_seconds(timeout_s))

    def sleep(self, seconds: float) -> None:
        """Let time of the robot pass, simulated or real; the robot goes on with what it does.

        A program that paces its loop by it runs alike on `sim:`, on a server of any speed, and on a real robot.

        Parameters
        ----------
        seconds
            Seconds of the robot's time, 0 or more.
        """
        for pause_s in self._pauses(seconds):
            if pause_s:
                time.sleep(pause_s)

    def _pauses(self, seconds: float) -> Iterator[float]:
        """Yield pauses in real seconds after which time of the robot has passed; simulated time passes meanwhile."""
        if not 0 <= seconds < math.inf:
            raise ValueError(f"seconds is 0 or more, not {seconds}")
        # 1. A simulation in this process advances by the time; a recording refuses that, and goes on by its requests.
        if self._lockstep:
            # A step is a whole number of ms: what is less waits for the next sleep.
            whole_s = math.floor(1000.0 * (seconds + self._unslept_s) + 1e-6) / 1000.0
            self._unslept_s += seconds - whole_s
            with contextlib.suppress(RobotRefused):
                for step_s in _split(whole_s, _MAX_STEP_S) if whole_s else ():
                    self.control_time("step", step_s)
                    yield 0.0
        # 2. Real time, as fast as the server runs; a serial line has no factor.
        elif self.state.speed_factor or self._backend.wire_state.line:
            yield seconds / (self.state.speed_factor or 1.0)
        # 3. A server that is paused, or advances with each request; without a clock, real time.
        elif (now_s := self.refresh().clock_s) is None:
            yield seconds
        else:
            # 1e-9 s absorbs the rounding of clock differences.
            until_s = now_s + seconds - 1e-9
            while now_s < until_s:
                last_s, now_s = now_s, self.refresh().clock_s or 0.0
                yield _PAUSED_POLL_S if now_s == last_s else 0.0

    # -- settings -----------------------------------------------------------------------------------------------------

    def set_speeds(self, *, translation_in_s: float | None = None, translation_m_s: float | None = None,
                   steering_deg_s: float | None = None, steering_rad_s: float | None = None,
                   turret_deg_s: float | None = None, turret_rad_s: float | None = None) -> RobotState:
        """Set the speeds of `move`; an axis that is not given gets 0. C: sp.

        Both wheels of a Scout get the speed of translation; RobotRefused if another one is given.
        """
        return self._set_axes("sp", tenths_of(translation_in_s=translation_in_s, translation_m_s=translation_m_s),
                              tenths_of(steering_deg_s=steering_deg_s, steering_rad_s=steering_rad_s),
                              tenths_of(turret_deg_s=turret_deg_s, turret_rad_s=turret_rad_s))

    def set_accelerations(self, *, translation_in_s2: float | None = None, translation_m_s2: float | None = None,
                          steering_deg_s2: float | None = None, steering_rad_s2: float | None = None,
                          turret_deg_s2: float | None = None, turret_rad_s2: float | None = None) -> RobotState:
        """Set the accelerations; an axis that is not given gets 0. C: ac.

        Both wheels of a Scout get the acceleration of translation; RobotRefused if another one is given.
        """
        return self._set_axes("ac", tenths_of(translation_in_s2=translation_in_s2, translation_m_s2=translation_m_s2),
                              tenths_of(steering_deg_s2=steering_deg_s2, steering_rad_s2=steering_rad_s2),
                              tenths_of(turret_deg_s2=turret_deg_s2, turret_rad_s2=turret_rad_s2))

    def set_position(self, *, x_in: float | None = None, y_in: float | None = None,
                     x_m: float | None = None, y_m: float | None = None) -> RobotState:
        """Set the position of the encoders, 0 where not given; the robot does not move. C: dp."""
        return self._command("dp", tenths_of(x_in=x_in, x_m=x_m), tenths_of(y_in=y_in, y_m=y_m))

    def set_angles(self, *, steering_deg: float | None = None, steering_rad: float | None = None,
                   turret_deg: float | None = None, turret_rad: float | None = None) -> RobotState:
        """Set the angles of the encoders, 0 where not given; nothing turns. C: da."""
        steering = tenths_of(steering_deg=steering_deg, steering_rad=steering_rad)
        return self._command("da", steering, tenths_of(turret_deg=turret_deg, turret_rad=turret_rad))

    def set_timeout(self, timeout_s: float) -> RobotState:
        """Set the motion timeout: the robot stops if no command arrives for that long. C: conf_tm.

        From then on the program is responsible: the connection's keep-alive ends.

        Parameters
        ----------
        timeout_s
            Seconds, rounded up to whole ones; 0 switches the timeout off.
        """
        return self._command("conf_tm", _whole_seconds(timeout_s))

    def select_sensors(self, *, infrareds: Iterable[int] = RING, sonars: Iterable[int] = RING, bumpers: bool = True,
                       motion: bool = True, compass: bool = True, laser: bool = True) -> RobotState:
        """Select the sensors whose readings replies carry; others keep their last reading. C: ct.

        Parameters
        ----------
        infrareds, sonars
            Numbers of sensors, 0..15.
        bumpers, compass, laser
            True to include them.
        motion
            True to include pose and velocities.
        """
        # The mask has position bits, 16 infrareds, 16 sonars, bumpers, 7 numbers of motion, laser and compass.
        position = self._backend.wire_state.mask.position
        selections = frozenset(infrareds), frozenset(sonars)
        rings = [int(number in selected) for selected in selections for number in RING]
        mask = Mask((position, *rings, int(bumpers), *[int(motion)] * 7, 1, int(laser), int(compass)))
        return self._command("ct", *mask.smask)

    def position_data(self, *, infrareds: bool = False, sonars: bool = False, bumpers: bool = False,
                      laser: bool = False, compass: bool = False) -> RobotState:
        """Select the sensors whose readings get position stamps (`RobotState.stamps`). C: posDataRequest."""
        # The order of Position's members: bit 0 infrareds to bit 4 compass.
        selected = zip((infrareds, sonars, bumpers, laser, compass), Position, strict=True)
        bits = sum(bit for is_selected, bit in selected if is_selected)
        return self._command("ct", *self._backend.wire_state.mask.with_position(bits).smask)

    def configure_sonars(self, *, rate: int | None = None, interval_s: float | None = None,
                         order: Iterable[int] = types.DEFAULT_SONAR_ORDER) -> RobotState:
        """Set rate and order of the sonars. The first one then fires at the clock of the reply. C: conf_sn.

        Parameters
        ----------
        rate
            Interval between two firings in steps of 4 ms; default 15 (60 ms).
        interval_s
            The same in seconds, rounded to a step; not both.
        order
            At most 16 sensors 0..15; none of them switches the sonars off.

        Raises
        ------
        TypeError
            If rate and interval are given.
        ValueError
            If the order is not valid.
        """
        if rate is not None and interval_s is not None:
            raise TypeError("rate or interval_s, not both")
        if interval_s is not None:
            # The wire has steps of 4 ms.
            rate = round(interval_s / types.SONAR_RATE_STEP_S)
        return self._command("conf_sn", types.DEFAULT_SONAR_RATE if rate is None else rate, *states.firing_order(order))

    def configure_infrareds(self, *, history: int = 1, order: Iterable[int] = types.DEFAULT_SONAR_ORDER) -> RobotState:
        """Set the number of readings that an infrared averages (1..10), and the firing order. C: conf_ir."""
        return self._command("conf_ir", history, *states.firing_order(order))

    def configure_compass(self, mode: int) -> RobotState:
        """Set the mode of the compass: 0 off, 1 on, 2 calibrate. C: conf_cp."""
        return self._command("conf_cp", mode)

    def configure_laser(self, mode: int, *, threshold: int = 20, width: int = 20, num_data: int = 20,
                        processing: int = 4) -> RobotState:
        """Set the mode of the laser. C: conf_ls.

        Parameters
        ----------
        mode
            51 points, 33 lines; with bit 0 clear the laser is off.
        num_data
            Number of camera columns that count, 0 for all.
        threshold, width, processing
            Settings of the camera; without effect in a simulation.
        """
        return self._command("conf_ls", mode, threshold, width, num_data, processing)

    def configure_segments(self, threshold: int, min_points: int, gap: int) -> RobotState:
        """Set how laser points are combined to line segments. C: conf_sg."""
        return self._command("conf_sg", threshold, min_points, gap)

    def configure_serial_port(self, port: int, baud: int) -> RobotState:
        """Set the speed of another serial port of the robot; on a serial line only. C: conf_ser."""
        return self._command("conf_ser", port, baud)

    # -- queries ------------------------------------------------------------------------------------------------------

    def refresh(self) -> RobotState:
        """Query the whole state. C: gs."""
        return self._command("gs")

    def read_infrareds(self) -> RobotState:
        """Query the infrareds. C: get_ir."""
        return self._command("get_ir")

    def read_sonars(self) -> RobotState:
        """Query the sonars. C: get_sn."""
        return self._command("get_sn")

    def read_pose(self) -> RobotState:
        """Query position and angles of the encoders. C: get_rc."""
        return self._command("get_rc")

    def read_velocities(self) -> RobotState:
        """Query the velocities. C: get_rv."""
        return self._command("get_rv")

    def read_accelerations(self) -> Accelerations:
        """Query the accelerations, which the state does not have. C: get_ra."""
        slots = self.execute(Call("get_ra")).slots
        return Accelerations(*[slots.get(slot, 0) / 10 for slot in (38, 39, 40)])

    def read_compass(self) -> RobotState:
        """Query the compass. C: get_cp."""
        return self._command("get_cp")

    def read_laser(self) -> RobotState:
        """Query the laser. C: get_ls."""
        return self._command("get_ls")

    def read_bumpers(self) -> RobotState:
        """Query the bumpers. C: get_bp."""
        return self._command("get_bp")

    def read_segments(self) -> RobotState:
        """Query the laser's line segments. C: get_sg."""
        return self._command("get_sg")

    # -- speech, special packets, the arm -----------------------------------------------------------------------------

    def say(self, text: str) -> None:
        """Speak a text, Latin-1, at most 255 characters. C: tk."""
        self._query("tk", text)

    def send_packet(self, packet_type: int, data: bytes = b"") -> bytes:
        """Send a special packet and return the data of the packet that replies. C: special_request."""
        values = self._query("special_request", packet_type, *data, at_least=_PACKET_HEAD)
        return bytes(value & 255 for value in values[_PACKET_HEAD:])

    def read_ring(self, *, restart: bool = False) -> RingReadings:
        """Query all sonars of a simulated ring with their own resolution. User packet of this project's servers.

        Parameters
        ----------
        restart
            Restart the ring with order and interval of its model; its first sonars then fire at the reply's clock.

        Raises
        ------
        RobotRefused
            If the other end is no simulation of this project.
        """
        return parse_ring(self.send_packet(RING_PACKET, bytes((RESTART if restart else READ,))))

    def watch_ring(self) -> RingReadings:
        """Restart the ring of a model file, and have all its sonars in `RobotState.ring_in` from now on.

        Each command then also sends `read_ring`. Raises as that.
        """
        readings = self.read_ring(restart=True)
        self._ring_in = readings.readings_in
        return readings

    def arm_zero(self, override: bool = False) -> int:
        """Zero the arm and return its result. C: arm_zr."""
        return self._query_arm("arm_zr", int(override)).result

    def arm_wait(self, *, lift: bool = True, grip: bool = True, timeout: int = 0) -> ArmAnswer:
        """Wait until the arm is still; `timeout` in the arm's unit. C: arm_ws."""
        return self._query_arm("arm_ws", int(lift), int(grip), timeout)

    def arm_move(self, *, lift_mode: int = 0, lift_value: int = 0, grip_mode: int = 0, grip_value: int = 0) -> int:
        """Move the arm, in its own modes and units, and return its result. C: arm_mv."""
        return self._query_arm("arm_mv", lift_mode, lift_value, grip_mode, grip_value).result

    # -- the server's robots and world; a real robot's serial line has none of these ----------------------------------

    def connect_robot(self, robot_id: int) -> RobotState:
        """Switch this connection to another robot of the server. C: connect_robot.

        Raises RobotRefused if there is none of that number; nserver then keeps the current robot.
        """
        with self._lock:
            self.execute(Call("connect_robot", (robot_id, os.getpid())))
            return self._command("gs")

    def create_robot(self, robot_id: int) -> RobotState:
        """Create a robot of that number and switch to it. C: create_robot."""
        with self._lock:
            self.execute(Call("create_robot", (robot_id, os.getpid())))
            return self._command("gs")

    def place(self, pose: Pose) -> None:
        """Place the robot and its encoders at a pose. C: place_robot.

        Raises RobotRefused if it would touch an obstacle there.
        """
        self._query("place_robot", *_pose_tenths(pose))

    def read_robots(self) -> tuple[RobotPlace, ...]:
        """Query position and heading of all robots. C: get_rpx."""
        # The count, then three numbers per robot: x and y in 1/10 in, heading in 1/10 deg.
        count, *numbers = self._query("get_rpx", at_least=1)
        if len(numbers) != 3 * count:
            raise WireError(f"get_rpx: {count} robots with {len(numbers)} numbers")
        triples = zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)
        return tuple(RobotPlace(x / 10, y / 10, rad_from_tenths(heading)) for x, y, heading in triples)

    def ask_pose(self) -> Pose:
        """Wait for a pose clicked in the server's window; without window the robot's pose. C: get_robot_conf."""
        x, y, steering, turret = self._query("get_robot_conf", at_least=4)
        return Pose(x / 10, y / 10, rad_from_tenths(steering), rad_from_tenths(turret))

    def add_obstacle(self, *, corners_in: Points | None = None, corners_m: Points | None = None) -> None:
        """Add a polygon of at most ten corners (x, y), counter-clockwise. C: add_obstacle."""
        self._query("add_obstacle", *_polygon(corners_in, corners_m))

    def delete_obstacle(self, *, corners_in: Points | None = None, corners_m: Points | None = None) -> None:
        """Remove the polygon with these corners. C: delete_obstacle."""
        self._query("delete_obstacle", *_polygon(corners_in, corners_m))

    def move_obstacle(self, *, corners_in: Points | None = None, shift_in: tuple[float, float] | None = None,
                      corners_m: Points | None = None,
                      shift_m: tuple[float, float] | None = None) -> tuple[tuple[float, float], ...]:
        """Shift the polygon with these corners and return its new corners in inches. C: move_obstacle."""
        # Inches or metres, but the same unit for corners and shift is not required.
        shift = points_tenths(None if shift_in is None else [shift_in], None if shift_m is None else [shift_m])
        _, *moved = self._query("move_obstacle", *_polygon(corners_in, corners_m), *shift, at_least=1)
        return tuple((x / 10, y / 10) for x, y in zip(moved[::2], moved[1::2], strict=True))

    def clear_world(self) -> None:
        """Remove all obstacles; marked walls stay. C: new_world."""
        self._query("new_world")

    def predict_sensors(self, pose: Pose) -> Prediction:
        """Predict the readings of the sensors at another pose. C: predict_sensors."""
        # The reply is a State vector: infrareds in [1] to [16], sonars in [17] to [32].
        reply = self.execute(Call("predict_sensors", _pose_tenths(pose)))
        return Prediction(reply.values[1:17], reply.values[17:33], reply.laser or (0,))

    def check_motion(self, *, line_in: Points | None = None, line_m: Points | None = None,
                     arc: Arc | None = None) -> Collision | None:
        """Find the first collision of a path. C: motion_check.

        Parameters
        ----------
        line_in, line_m
            Start and end point (x, y) of a straight path.
        arc
            A circular path instead.

        Returns
        -------
        Collision or None
            None if the path is free.
        """
        # The doubles of the C call are taken to be tenths of an inch as all its lengths, sent in thousandths.
        args: tuple[float, ...]
        if arc is None:
            args = (MOTION_LINE, *[1000 * number for number in points_tenths(line_in, line_m)])
        else:
            x, y, radius, *centre = [10000 * inches for inches in arc[:2] + arc[4:]]
            args = (MOTION_ARC, x, y, 1000 * arc.from_rad, 1000 * arc.to_rad, radius, *centre)
        # The reply has thousandths of an inch, and the normal in microradians.
        hit, x_hit, y_hit, normal = self._query("motion_check", *args, at_least=4)
        return Collision(x_hit / 1000, y_hit / 1000, normal / 1e6) if hit else None

    def use_real_robot(self) -> None:
        """Send commands to the real robot from now on. C: real_robot."""
        self._query("real_robot")

    def use_simulated_robot(self) -> None:
        """Send commands to the simulation from now on. C: simulated_robot."""
        self._query("simulated_robot")

    def quit_server(self) -> None:
        """End the server. Raises RobotRefused unless its setup allows it. C: quit_server."""
        self._query("quit_server")

    # -- the server's window ------------------------------------------------------------------------------------------

    def draw_robot(self, pose: Pose, mode: int = 1) -> None:
        """Draw a robot. C: draw_robot.

        Parameters
        ----------
        pose
            The pose to draw it at.
        mode
            1 black XOR, 2 the same with an arrow that stays, 3 black, above 3 colour mode - 3, XOR.
        """
        self._query("draw_robot", *_pose_tenths(pose), mode)

    def draw_line(self, *, points_in: Points | None = None, points_m: Points | None = None, mode: int = 1) -> None:
        """Draw a line between two points. C: draw_line.

        Parameters
        ----------
        points_in, points_m
            Start and end point (x, y).
        mode
            1 black, 2 black XOR, above 2 colour mode - 2, XOR.
        """
        self._query("draw_line", *points_tenths(points_in, points_m), mode)

    def draw_arc(self, *, box_in: tuple[float, float, float, float] | None = None,
                 box_m: tuple[float, float, float, float] | None = None,
                 angles_rad: tuple[float, float] = (0.0, math.tau), mode: int = 1) -> None:
        """Draw an arc of an ellipse. C: draw_arc.

        Parameters
        ----------
        box_in, box_m
            Bounding box of the ellipse: x, y, width, height.
        angles_rad
            Start and end angle.
        mode
            As in `draw_line`.
        """
        box = points_tenths(_halves(box_in), _halves(box_m))
        self._query("draw_arc", *box, *[tenths_from_rad(angle) for angle in angles_rad], mode)

    def redraw_all(self) -> None:
        """Redraw everything. C: refresh_all."""
        self._query("refresh_all")

    def redraw_all_traces(self) -> None:
        """Redraw both traces. C: refresh_all_traces."""
        self._query("refresh_all_traces")

    def redraw_actual_trace(self) -> None:
        """Redraw the trace of the actual robot. C: refresh_actual_trace."""
        self._query("refresh_actual_trace")

    def redraw_encoder_trace(self) -> None:
        """Redraw the trace of the encoder robot. C: refresh_encoder_trace."""
        self._query("refresh_encoder_trace")

    def redraw_all_sensors(self) -> None:
        """Redraw all sensors. C: refresh_all_sensors."""
        self._query("refresh_all_sensors")

    def redraw_bumper_sensor(self) -> None:
        """Redraw the bumpers. C: refresh_bumper_sensor."""
        self._query("refresh_bumper_sensor")

    def redraw_infrared_sensor(self) -> None:
        """Redraw the infrareds. C: refresh_infrared_sensor."""
        self._query("refresh_infrared_sensor")

    def redraw_sonar_sensor(self) -> None:
        """Redraw the sonars. C: refresh_sonar_sensor."""
        self._query("refresh_sonar_sensor")

    def redraw_laser_sensor(self) -> None:
        """Redraw the laser. C: refresh_laser_sensor."""
        self._query("refresh_laser_sensor")

    def redraw_client_graphics(self) -> None:
        """Redraw the drawings of clients. C: refresh_client_graphics."""
        self._query("refresh_client_graphics")

    # -- simulations of this project ----------------------------------------------------------------------------------

    def truth(self) -> Truth:
        """Query the ground truth of a simulation. Wire name: sim_truth.

        Raises RobotRefused (error 1 or 4) if the other end is no simulation of this project.
        """
        # Lengths in 1/1000 in, angles in 1/1000 deg; the time is an unsigned 32-bit word of ms.
        _, time_ms, x, y, heading, turret, seed, robot_id = self._query("sim_truth", at_least=8)
        angles = (math.radians(heading / 1000), math.radians(turret / 1000))
        return Truth(x / 1000, y / 1000, *angles, time_s=unwrap_word(time_ms) / 1000, seed=seed, robot_id=robot_id)

    def is_simulated(self) -> bool:
        """Return True if the other end is a simulation of this project, by sending sim_truth.

        A server of the 1990s does not have that command: it refuses it, or leaves it unanswered and the connection
        is closed after the timeout.
        """
        # Only a simulation of this project answers.
        with contextlib.suppress(RobotRefused):
            self.truth()
            return True
        return False

    def held_by(self) -> str:
        """Query which person holds the robot (Stop on the page, `nserver ctl stop`); "" if none does.

        Raises RobotRefused (error 1) if the server is not one of this project. Wire name: held_by.
        """
        return text_of(self._query("held_by", at_least=1))

    def wait_until_released(self, timeout_s: float | None = None, *, every_s: float = 0.2) -> RobotState:
        """Wait until no person holds the robot; sends gs at intervals of `every_s` real seconds.

        Parameters
        ----------
        timeout_s
            Maximum time in real seconds; None waits without limit.

        Raises
        ------
        RobotHeld
            If the robot is held still at the end of that time.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while (state := self.refresh()).is_held:
            if end_s is not None and time.monotonic() >= end_s:
                raise RobotHeld("wait_until_released", by=self.held_by())
            time.sleep(every_s)
        return state

    def control_time(self, verb: Literal["pause", "resume", "speed", "step"], value: float = 0.0) -> SimulatedTime:
        """Control the time of a simulation. Wire name: sim_control.

        Parameters
        ----------
        verb
            "pause", "resume", "step" or "speed".
        value
            For "step" seconds; for "speed" a multiple of real time, 0 for as fast as possible.

        Raises
        ------
        RobotRefused
            If the server does not allow it.
        ValueError
            For another verb.
        """
        if verb not in _TIME_VERBS:
            raise ValueError(f"a verb is one of {', '.join(_TIME_VERBS)}, not {verb!r}")
        # Steps are sent in ms, speeds as ten times the factor.
        number = round(value * _TIME_SCALES.get(verb, 0))
        _, time_ms, speed, paused = self._query("sim_control", _TIME_VERBS[verb], number, at_least=4)
        return SimulatedTime(unwrap_word(time_ms) / 1000, speed / 10, bool(paused))

    # -- exchanges ----------------------------------------------------------------------------------------------------

    def _apply(self, reply: Reply) -> None:
        # The backend returns the same object for the same bytes: nothing has changed since it was applied. The ground
        # truth is no part of the state.
        if reply is self._applied or reply.kind == "truth":
            return
        self._applied = reply
        self._client_state.apply_reply(reply)
        self._state = states.snapshot(self._client_state, self._backend.wire_state.model)
        if self._ring_in is not None:
            self._state = replace(self._state, ring_in=self._ring_in)

    def _command(self, name: str, *args: Any) -> RobotState:
        """Execute a command by its C name and return the state after it."""
        with self._lock:
            self.execute(Call(name, args))
            if self._ring_in is not None:
                # Refused during an emergency stop: then the last readings remain.
                with contextlib.suppress(RobotRefused):
                    self._ring_in = self.read_ring().readings_in
                self._state = replace(self._state, ring_in=self._ring_in)
            return self._state

    def _query(self, name: str, *args: Any, at_least: int = 0) -> tuple[int, ...]:
        """Execute a command by its C name and return the numbers of its reply."""
        values = self.execute(Call(name, args)).values
        if len(values) < at_least:
            raise WireError(f"{name}: the reply has {len(values)} numbers, expected {at_least}")
        return values

    def _query_arm(self, name: str, *args: int) -> ArmAnswer:
        # The packet's head, then result and remaining time, four bytes each, low byte first.
        data = bytes(value & 255 for value in self._query(name, *args, at_least=_PACKET_HEAD + 4)[_PACKET_HEAD:])
        return ArmAnswer(int.from_bytes(data[:4], "little", signed=True), int.from_bytes(data[4:8], "little"))

    def _command_axes(self, name: str, translation: int, steering: int, turret: int) -> RobotState:
        """Command all axes; of a Scout its wheels, with the arithmetic of scout_vm."""
        if self.model.has_turret:
            return self._command(name, translation, steering, turret)
        self._refuse_axis(name, turret)
        # Truncated as in the C library, so that both send the same bytes.
        turn = int(steering * states.WHEEL_IN_PER_DEG)
        return self._command(name, translation + turn, translation - turn, 0)

    def _set_axes(self, name: str, translation: int, steering: int, turret: int) -> RobotState:
        if self.model.has_turret:
            return self._command(name, translation, steering, turret)
        # A wheel has one speed limit: that of translation applies to both.
        self._refuse_axis(name, turret or steering)
        return self._command(name, translation, translation, 0)

    def _refuse_axis(self, name: str, value: int) -> None:
        if value:
            raise RobotRefused(name, None, f"a {self.model.name} has no such axis")

    def _require_wheels(self, name: str) -> None:
        if self.model.has_turret:
            raise RobotRefused(name, None, f"a {self.model.name} does not drive by its right and left wheel")


def _split(total_s: float, piece_s: float) -> Iterator[float]:
    """Yield durations of at most `piece_s`, which add up to a total."""
    while total_s > piece_s:
        yield piece_s
        total_s -= piece_s
    yield total_s


def _whole_seconds(seconds: float) -> int:
    if not 0 <= seconds < math.inf:
        raise ValueError(f"timeout_s is 0 or more seconds, not {seconds}")
    # Rounded up, so that a short timeout does not become 0, which means none.
    return math.ceil(seconds)


def _pose_tenths(pose: Pose) -> tuple[int, int, int, int]:
    # 1/10 in and 1/10 deg.
    x, y = tenths_of(x_in=pose.x_in), tenths_of(y_in=pose.y_in)
    return x, y, tenths_of(steering_rad=pose.steering_rad), tenths_of(turret_rad=pose.turret_rad)


def _polygon(corners_in: Points | None, corners_m: Points | None) -> tuple[int, ...]:
    numbers = points_tenths(corners_in, corners_m)
    return len(numbers) // 2, *numbers


def _halves(box: Iterable[float] | None) -> Points | None:
    if box is None:
        return None
    x, y, width, height = box
    return [(x, y), (width, height)]
