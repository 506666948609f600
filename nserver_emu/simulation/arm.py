"""The arm of a Nomad 200: a lift and a grip that move by themselves. A device without wire, clock or robot.

Each axis is one of the robot's own kind (simulation/axis.py) between two ends. What the numbers mean on the wire is
packets.py's; what they are is a decision of ours, for no source gives them: the lift goes 0..48 in at up to 5 in/s,
the grip opens 0..5 in at up to 2 in/s, both ramped; they wake at 0.
"""

from __future__ import annotations

from typing import Final

from nserver_emu.simulation.axis import Axis, AxisLimits, Command

LIFT: Final = AxisLimits(
    top_speed=5.0, top_acceleration=20.0, least_acceleration=0.1, speed=5.0, acceleration=10.0, resolution=0.1
)
GRIP: Final = AxisLimits(
    top_speed=2.0, top_acceleration=20.0, least_acceleration=0.1, speed=2.0, acceleration=10.0, resolution=0.1
)
LIFT_TRAVEL_IN: Final = 48.0
GRIP_TRAVEL_IN: Final = 5.0


class Slide:
    """One axis between its ends: position 0 to `travel_in` inches."""

    def __init__(self, limits: AxisLimits, travel_in: float) -> None:
        self.travel_in = travel_in
        self.position_in = 0.0
        self._axis = Axis(limits, ramps=True)

    @property
    def moving(self) -> bool:
        """True from the command that starts a motion until it is done."""
        return self._axis.moving

    def command(self, command: Command, value_in: float) -> None:
        """Do what one axis of arm_mv says, in inches and seconds; a relative target stays between the ends."""
        if command is Command.RELATIVE:
            value_in = min(max(value_in, -self.position_in), self.travel_in - self.position_in)
        self._axis.command(command, value_in)

    def seek_zero(self) -> None:
        """Go down to 0, at the speed set, or at the top speed where that is 0."""
        self._axis.move_by(-self.position_in, self._axis.speed or self._axis.limits.top_speed)

    def stop(self) -> None:
        """Brake and hold."""
        self._axis.stop()

    def advance(self, dt_s: float) -> None:
        """Let dt_s seconds pass; at an end the motion is over."""
        reached = self.position_in + self._axis.advance(dt_s)
        self.position_in = min(max(reached, 0.0), self.travel_in)
        if reached != self.position_in:
            self._axis.halt()


class Arm:
    """Lift and grip. Time comes in as instants of the simulation."""

    def __init__(self) -> None:
        self.lift = Slide(LIFT, LIFT_TRAVEL_IN)
        self.grip = Slide(GRIP, GRIP_TRAVEL_IN)
        self._time_s = 0.0

    def advance_to(self, time_s: float) -> None:
        """Let time pass until an instant that is not before the last."""
        for slide in (self.lift, self.grip):
            slide.advance(time_s - self._time_s)
        self._time_s = time_s

    @property
    def time_s(self) -> float:
        """The instant that it has come to."""
        return self._time_s

    def stop(self) -> None:
        """Both axes brake and hold."""
        self.lift.stop()
        self.grip.stop()

    def zero(self) -> None:
        """Send both axes to 0."""
        self.lift.seek_zero()
        self.grip.seek_zero()

    def still(self, lift: bool = True, grip: bool = True) -> bool:
        """Whether none of the named axes moves."""
        return not (lift and self.lift.moving) and not (grip and self.grip.moving)
