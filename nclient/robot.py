"""Robot: a method a command, in plain verbs and named units, whatever is at the other end.

    robot.drive(translation_m_s=0.2, steering_deg_s=-5)    the unit stands in the keyword; what is not given is 0
    state = robot.refresh()                                motion, configuration and questions give the RobotState

Rules: thin: units in, a Call, the state out; the C name in the docstring. Two units of one quantity at once are a
TypeError. Every method may raise ConnectionLost, ReplyTimeout and RobotRefused (errors.py says what is left after).
A Scout has no turret: drive, move and their kin turn translation and steering into its wheels (scout_vm's arithmetic).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from types import TracebackType
from typing import NamedTuple, Self

from nclient.errors import BumperHit, ConnectionLost, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE, SONAR_RATE_STEP_S, Mask, Position
from nclient.robot_world import RobotWorld
from nclient.state import WHEEL_IN_PER_DEG, RobotState
from nclient.units import AxisCommand, firing_order, tenths_of

RING = range(16)
_HEAD = 4
_LEAVE = AxisCommand()


class Accelerations(NamedTuple):
    """What get_ra answers: inches and degrees a second squared; a Scout's are its right and left wheel's, and 0."""

    translation_in_s2: float
    steering_deg_s2: float
    turret_deg_s2: float


class ArmAnswer(NamedTuple):
    """What the arm says after waiting: a result, and what is left of the timeout."""

    result: int
    remaining: int


class Robot(RobotWorld):
    """A robot, connected. Made by nclient.connect; leaving its `with` block stops the robot and disconnects."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            with contextlib.suppress(ConnectionLost, ReplyTimeout):
                self.stop()
        except (RobotRefused, BumperHit):
            if error is None:
                raise
        finally:
            self.disconnect()

    def disconnect(self) -> None:
        """End the conversation; the robot is not told to stop. Twice is fine. C: disconnect_robot"""
        self._backend.close()

    # motion

    def drive(
        self,
        *,
        translation_in_s: float | None = None,
        translation_m_s: float | None = None,
        steering_deg_s: float | None = None,
        steering_rad_s: float | None = None,
        turret_deg_s: float | None = None,
        turret_rad_s: float | None = None,
    ) -> RobotState:
        """Drive each axis at a velocity until told otherwise; an axis that is not named stands still. C: vm"""
        return self._axes(
            "vm",
            tenths_of(translation_in_s=translation_in_s, translation_m_s=translation_m_s),
            tenths_of(steering_deg_s=steering_deg_s, steering_rad_s=steering_rad_s),
            tenths_of(turret_deg_s=turret_deg_s, turret_rad_s=turret_rad_s),
        )

    def move(
        self,
        *,
        translation_in: float | None = None,
        translation_m: float | None = None,
        steering_deg: float | None = None,
        steering_rad: float | None = None,
        turret_deg: float | None = None,
        turret_rad: float | None = None,
    ) -> RobotState:
        """Move each axis by a distance, all at once, at the speeds of set_speeds; returns at once. C: pr"""
        return self._axes(
            "pr",
            tenths_of(translation_in=translation_in, translation_m=translation_m),
            tenths_of(steering_deg=steering_deg, steering_rad=steering_rad),
            tenths_of(turret_deg=turret_deg, turret_rad=turret_rad),
        )

    def move_to(
        self,
        *,
        translation_in: float | None = None,
        translation_m: float | None = None,
        steering_deg: float | None = None,
        steering_rad: float | None = None,
        turret_deg: float | None = None,
        turret_rad: float | None = None,
    ) -> RobotState:
        """Move each axis to a position, 0 where not named; only an N200 can. C: pa"""
        return self._ask(
            "pa",
            tenths_of(translation_in=translation_in, translation_m=translation_m),
            tenths_of(steering_deg=steering_deg, steering_rad=steering_rad),
            tenths_of(turret_deg=turret_deg, turret_rad=turret_rad),
        )

    def drive_axes(
        self, translation: AxisCommand = _LEAVE, steering: AxisCommand = _LEAVE, turret: AxisCommand = _LEAVE
    ) -> RobotState:
        """Command each axis in a mode of its own; a Scout's are right wheel, left wheel, none. C: mv

        With nothing named it changes nothing: old programs ping a robot like that.
        """
        return self._ask("mv", *translation, *steering, *turret)

    def drive_wheels(
        self,
        *,
        right_in_s: float | None = None,
        left_in_s: float | None = None,
        right_m_s: float | None = None,
        left_m_s: float | None = None,
    ) -> RobotState:
        """Drive a Scout's wheels at velocities; RobotRefused for another model. C: vm"""
        self._require_wheels("vm")
        right = tenths_of(right_in_s=right_in_s, right_m_s=right_m_s)
        return self._ask("vm", right, tenths_of(left_in_s=left_in_s, left_m_s=left_m_s), 0)

    def move_wheels(
        self,
        *,
        right_in: float | None = None,
        left_in: float | None = None,
        right_m: float | None = None,
        left_m: float | None = None,
    ) -> RobotState:
        """Move a Scout's wheels by distances; RobotRefused for another model. C: pr"""
        self._require_wheels("pr")
        right = tenths_of(right_in=right_in, right_m=right_m)
        return self._ask("pr", right, tenths_of(left_in=left_in, left_m=left_m), 0)

    def stop(self) -> RobotState:
        """Stop and hold. C: st"""
        return self._ask("st")

    def release(self) -> RobotState:
        """Let the motors go limp. C: lp"""
        return self._ask("lp")

    def zero(self) -> RobotState:
        """Turn steering and turret to the bumper's zero; position and angles then read 0. Takes a while. C: zr"""
        return self._ask("zr")

    def wait_until_still(
        self, timeout_s: float = 20, *, translation: bool = True, steering: bool = True, turret: bool = True
    ) -> RobotState:
        """The state when the named axes are still, or after the timeout, which stops nothing. C: ws

        `timeout_s`: of the robot's time, rounded up to whole seconds; on a robot's own line at most 255.
        """
        return self._ask("ws", int(translation), int(steering), int(turret), _whole_seconds(timeout_s))

    # configuration

    def set_speeds(
        self,
        *,
        translation_in_s: float | None = None,
        translation_m_s: float | None = None,
        steering_deg_s: float | None = None,
        steering_rad_s: float | None = None,
        turret_deg_s: float | None = None,
        turret_rad_s: float | None = None,
    ) -> RobotState:
        """Set the speeds of `move`; an axis that is not named gets 0. A Scout's wheels both get translation's. C: sp"""
        return self._limits(
            "sp",
            tenths_of(translation_in_s=translation_in_s, translation_m_s=translation_m_s),
            tenths_of(steering_deg_s=steering_deg_s, steering_rad_s=steering_rad_s),
            tenths_of(turret_deg_s=turret_deg_s, turret_rad_s=turret_rad_s),
        )

    def set_accelerations(
        self,
        *,
        translation_in_s2: float | None = None,
        translation_m_s2: float | None = None,
        steering_deg_s2: float | None = None,
        steering_rad_s2: float | None = None,
        turret_deg_s2: float | None = None,
        turret_rad_s2: float | None = None,
    ) -> RobotState:
        """Set the accelerations; an axis that is not named gets 0. A Scout's wheels both get translation's. C: ac"""
        return self._limits(
            "ac",
            tenths_of(translation_in_s2=translation_in_s2, translation_m_s2=translation_m_s2),
            tenths_of(steering_deg_s2=steering_deg_s2, steering_rad_s2=steering_rad_s2),
            tenths_of(turret_deg_s2=turret_deg_s2, turret_rad_s2=turret_rad_s2),
        )

    def set_position(
        self,
        *,
        x_in: float | None = None,
        y_in: float | None = None,
        x_m: float | None = None,
        y_m: float | None = None,
    ) -> RobotState:
        """Set what the encoders say of the position, 0 where not named; the robot stays where it is. C: dp"""
        return self._ask("dp", tenths_of(x_in=x_in, x_m=x_m), tenths_of(y_in=y_in, y_m=y_m))

    def set_angles(
        self,
        *,
        steering_deg: float | None = None,
        steering_rad: float | None = None,
        turret_deg: float | None = None,
        turret_rad: float | None = None,
    ) -> RobotState:
        """Set what the encoders say of the angles, 0 where not named; nothing turns. C: da"""
        steering = tenths_of(steering_deg=steering_deg, steering_rad=steering_rad)
        return self._ask("da", steering, tenths_of(turret_deg=turret_deg, turret_rad=turret_rad))

    def set_timeout(self, timeout_s: float) -> RobotState:
        """Have the robot stop when no command comes for so many seconds (rounded up); 0 never. C: conf_tm"""
        return self._ask("conf_tm", _whole_seconds(timeout_s))

    def select_sensors(
        self,
        *,
        infrareds: Iterable[int] = RING,
        sonars: Iterable[int] = RING,
        bumpers: bool = True,
        motion: bool = True,
        compass: bool = True,
        laser: bool = True,
    ) -> RobotState:
        """Say which sensors the states carry from now on; the others keep what they read last. C: ct

        `motion`: pose and velocities. What position_data asked for stays asked.
        """
        position = self._backend.wire_state.mask.position
        seen = [int(number in frozenset(wanted)) for wanted in (infrareds, sonars) for number in RING]
        mask = Mask((position, *seen, int(bumpers), *[int(motion)] * 7, 1, int(laser), int(compass)))
        return self._ask("ct", *mask.smask)

    def position_data(
        self,
        *,
        infrareds: bool = False,
        sonars: bool = False,
        bumpers: bool = False,
        laser: bool = False,
        compass: bool = False,
    ) -> RobotState:
        """Say for which sensors the states carry position stamps (RobotState.stamps) from now on. C: posDataRequest"""
        wanted = zip((infrareds, sonars, bumpers, laser, compass), Position, strict=True)
        bits = sum(bit for asked, bit in wanted if asked)
        return self._ask("ct", *self._backend.wire_state.mask.with_position(bits).smask)

    def configure_sonars(
        self, *, rate: int | None = None, interval_s: float | None = None, order: Iterable[int] = DEFAULT_SONAR_ORDER
    ) -> RobotState:
        """Set the sonars' firing and restart the ring: its first sensor fires at the clock of the answer. C: conf_sn

        `rate` in steps of 4 ms between sensors, or `interval_s` in seconds (to the nearest step), 15 = 60 ms where
        neither is given; `order`: sensors 0..15 as they fire, none of them: off. Raises ValueError for others.
        """
        if rate is not None and interval_s is not None:
            raise TypeError("rate or interval_s, not both")
        if interval_s is not None:
            rate = round(interval_s / SONAR_RATE_STEP_S)
        return self._ask("conf_sn", DEFAULT_SONAR_RATE if rate is None else rate, *firing_order(order))

    def configure_infrareds(self, *, history: int = 1, order: Iterable[int] = DEFAULT_SONAR_ORDER) -> RobotState:
        """Set how many readings an infrared averages (10 at most) and the firing order. C: conf_ir"""
        return self._ask("conf_ir", history, *firing_order(order))

    def configure_compass(self, mode: int) -> RobotState:
        """Set the compass: 0 off, 1 on, 2 calibrating. C: conf_cp"""
        return self._ask("conf_cp", mode)

    def configure_laser(
        self, mode: int, *, threshold: int = 20, width: int = 20, num_data: int = 20, processing: int = 4
    ) -> RobotState:
        """Set the laser: mode 51 points, 33 lines (with bit 0 clear it is off), how many columns count (0: all).

        threshold, width and processing are the camera's; in a simulation they have no effect. C: conf_ls
        """
        return self._ask("conf_ls", mode, threshold, width, num_data, processing)

    def configure_segments(self, threshold: int, min_points: int, gap: int) -> RobotState:
        """Set how laser points become line segments. C: conf_sg"""
        return self._ask("conf_sg", threshold, min_points, gap)

    def configure_serial_port(self, port: int, baud: int) -> RobotState:
        """Set the speed of another serial port of the robot; exists on the robot's own line only. C: conf_ser"""
        return self._ask("conf_ser", port, baud)

    # questions

    def refresh(self) -> RobotState:
        """Ask for the whole state. C: gs"""
        return self._ask("gs")

    def read_infrareds(self) -> RobotState:
        """Ask for the infrareds. C: get_ir"""
        return self._ask("get_ir")

    def read_sonars(self) -> RobotState:
        """Ask for the sonars. C: get_sn"""
        return self._ask("get_sn")

    def read_pose(self) -> RobotState:
        """Ask for position and angles. C: get_rc"""
        return self._ask("get_rc")

    def read_velocities(self) -> RobotState:
        """Ask for the velocities. C: get_rv"""
        return self._ask("get_rv")

    def read_accelerations(self) -> Accelerations:
        """Ask for the accelerations; the state holds none. C: get_ra"""
        slots = self.execute(Call("get_ra")).slots
        return Accelerations(*[slots.get(slot, 0) / 10 for slot in (38, 39, 40)])

    def read_compass(self) -> RobotState:
        """Ask for the compass. C: get_cp"""
        return self._ask("get_cp")

    def read_laser(self) -> RobotState:
        """Ask for the laser. C: get_ls"""
        return self._ask("get_ls")

    def read_bumpers(self) -> RobotState:
        """Ask for the bumpers. C: get_bp"""
        return self._ask("get_bp")

    def read_segments(self) -> RobotState:
        """Ask for the laser's line segments. C: get_sg"""
        return self._ask("get_sg")

    # speech, special packets, the arm

    def say(self, text: str) -> None:
        """Say a text, Latin-1, at most 255 characters. C: tk"""
        self._values("tk", text)

    def send_packet(self, packet_type: int, data: bytes = b"") -> bytes:
        """Send a user packet; the data of the packet that answers. C: special_request"""
        values = self._values("special_request", packet_type, *data, at_least=_HEAD)
        return bytes(value & 255 for value in values[_HEAD:])

    def arm_zero(self, override: bool = False) -> int:
        """Zero the arm; its result. C: arm_zr"""
        return self._arm("arm_zr", int(override)).result

    def arm_wait(self, *, lift: bool = True, grip: bool = True, timeout: int = 0) -> ArmAnswer:
        """Wait until the arm is still; `timeout` in the arm's own unit. C: arm_ws"""
        return self._arm("arm_ws", int(lift), int(grip), timeout)

    def arm_move(self, *, lift_mode: int = 0, lift_value: int = 0, grip_mode: int = 0, grip_value: int = 0) -> int:
        """Move the arm, in its own modes and units; its result. C: arm_mv"""
        return self._arm("arm_mv", lift_mode, lift_value, grip_mode, grip_value).result

    def _arm(self, name: str, *args: int) -> ArmAnswer:
        data = bytes(value & 255 for value in self._values(name, *args, at_least=_HEAD + 4)[_HEAD:])
        return ArmAnswer(int.from_bytes(data[:4], "little", signed=True), int.from_bytes(data[4:8], "little"))

    def _axes(self, name: str, translation: int, steering: int, turret: int) -> RobotState:
        if self.model.has_turret:
            return self._ask(name, translation, steering, turret)
        self._refuse_turret(name, turret)
        turn = int(steering * WHEEL_IN_PER_DEG)
        return self._ask(name, translation + turn, translation - turn, 0)

    def _limits(self, name: str, translation: int, steering: int, turret: int) -> RobotState:
        if self.model.has_turret:
            return self._ask(name, translation, steering, turret)
        self._refuse_turret(name, turret or steering)
        return self._ask(name, translation, translation, 0)

    def _refuse_turret(self, name: str, value: int) -> None:
        if value:
            raise RobotRefused(name, None, f"a {self.model.name} has no such axis")

    def _require_wheels(self, name: str) -> None:
        if self.model.has_turret:
            raise RobotRefused(name, None, f"a {self.model.name} does not drive by its right and left wheel")


def _whole_seconds(seconds: float) -> int:
    if not 0 <= seconds < math.inf:
        raise ValueError(f"timeout_s is 0 or more seconds, not {seconds}")
    return math.ceil(seconds)
