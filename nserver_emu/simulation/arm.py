"""The arm of a Nomad 200: a lift and a gripper that move independently. No wire format, no clock, no robot.

Each is an axis of the robot's kind (axis.py) between two ends. The limits are assumptions, for no source gives them:
the lift moves 0..48 in at up to 5 in/s, the gripper opens 0..5 in at up to 2 in/s, both ramped; they start at 0.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from nserver_emu.simulation.axis import Axis, AxisLimits, AxisState, Command

LIFT: Final = AxisLimits(
    top_speed=5.0, top_acceleration=20.0, min_acceleration=0.1, speed=5.0, acceleration=10.0, resolution=0.1
)
GRIP: Final = AxisLimits(
    top_speed=2.0, top_acceleration=20.0, min_acceleration=0.1, speed=2.0, acceleration=10.0, resolution=0.1
)
LIFT_TRAVEL_IN: Final = 48.0
GRIP_TRAVEL_IN: Final = 5.0


class SlideState(NamedTuple):
    """The state of a slide in a snapshot."""

    position_in: float
    axis: AxisState


class Slide:
    """One axis between its ends: position 0 to `travel_in` inches."""

    def __init__(self, limits: AxisLimits, travel_in: float) -> None:
        self.travel_in = travel_in
        self.position_in = 0.0
        self._axis = Axis(limits, ramps=True)

    def to_state(self) -> SlideState:
        """Return all that changes."""
        return SlideState(self.position_in, self._axis.to_state())

    def set_state(self, state: SlideState) -> None:
        """Continue from a state; raise ValueError if it lies beyond the ends."""
        if not 0.0 <= state.position_in <= self.travel_in:
            raise ValueError("an arm beyond its end")
        self.position_in = state.position_in
        self._axis.set_state(state.axis)

    @property
    def moving(self) -> bool:
        """True from the command that starts a motion until it is done."""
        return self._axis.moving

    def command(self, command: Command, value_in: float) -> None:
        """Execute a command of arm_mv for one axis, in inches and seconds; relative targets are clamped to the ends."""
        # A target beyond an end would leave the axis moving against it.
        if command is Command.RELATIVE:
            value_in = min(max(value_in, -self.position_in), self.travel_in - self.position_in)
        self._axis.command(command, value_in)

    def seek_zero(self) -> None:
        """Move to 0 at the speed set, or at the top speed where that is 0."""
        self._axis.move_by(-self.position_in, self._axis.speed or self._axis.limits.top_speed)

    def stop(self) -> None:
        """Brake and hold."""
        self._axis.stop()

    def advance(self, dt_s: float) -> None:
        """Advance by dt_s seconds; the motion ends at an end of the travel."""
        # The axis itself has no ends: clamp, and stop it there.
        reached = self.position_in + self._axis.advance(dt_s)
        self.position_in = min(max(reached, 0.0), self.travel_in)
        if reached != self.position_in:
            self._axis.halt()


class ArmState(NamedTuple):
    """The state of an arm in a snapshot."""

    lift: SlideState
    grip: SlideState
    time_s: float


class Arm:
    """Lift and gripper."""

    def __init__(self) -> None:
        self.lift = Slide(LIFT, LIFT_TRAVEL_IN)
        self.grip = Slide(GRIP, GRIP_TRAVEL_IN)
        self.time_s = 0.0

    def to_state(self) -> ArmState:
        """Return all that changes."""
        return ArmState(self.lift.to_state(), self.grip.to_state(), self.time_s)

    @classmethod
    def from_state(cls, state: ArmState) -> Arm:
        """Return the arm of a state; raise ValueError if there is none."""
        arm = cls()
        arm.lift.set_state(state.lift)
        arm.grip.set_state(state.grip)
        arm.time_s = state.time_s
        return arm

    def advance_to(self, time_s: float) -> None:
        """Advance to an instant that is not before the current one."""
        for slide in (self.lift, self.grip):
            slide.advance(time_s - self.time_s)
        self.time_s = time_s

    def stop(self) -> None:
        """Brake and hold both axes."""
        self.lift.stop()
        self.grip.stop()

    def zero(self) -> None:
        """Move both axes to 0."""
        self.lift.seek_zero()
        self.grip.seek_zero()

    def is_still(self, lift: bool = True, grip: bool = True) -> bool:
        """Return True if none of the selected axes moves."""
        return not (lift and self.lift.moving) and not (grip and self.grip.moving)
