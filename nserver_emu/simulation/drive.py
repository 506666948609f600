"""Drives: what the axes of a model do to the robot. Mechanical angles live here; places and encoders do not.

    SynchroDrive    translation, steering, turret: three wheels steer and roll together, the body never turns

A drive answers the robot in the same words whatever its wheels: `stretch` for the path, `advance` to let time pass,
three mechanical angles against the body's yaw. A differential drive fits in as a second class: its heading is its
body's, so that its steering, turret and bumper frame are one angle. No noise, no contact, no clock.
"""

from __future__ import annotations

from nserver_emu.simulation.angles import short_way
from nserver_emu.simulation.axis import Axis, AxisLimits
from nserver_emu.simulation.stretch import Stretch


class SynchroDrive:
    """The drive of the N150 and N200.

    steering_rad, turret_rad    mechanical angles against the body, unwrapped; 0 is the bumpers' zero
    bumper_frame_rad            angle of the bumpers against the body's yaw: the body does not turn
    """

    bumper_frame_rad = 0.0

    def __init__(self, limits: tuple[AxisLimits, ...], ramps: bool) -> None:
        self.translation, self.steering, self.turret = (Axis(limit, ramps) for limit in limits)
        self.steering_rad = 0.0
        self.turret_rad = 0.0

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """In the order of the commands: translation, steering, turret."""
        return self.translation, self.steering, self.turret

    def stretch(self, longest_s: float) -> Stretch:
        """The path of the next `longest_s` seconds, or of less where the wheels change their acceleration sooner."""
        translation, steering = self.translation, self.steering
        return Stretch(
            min(longest_s, translation.phase_left_s, steering.phase_left_s),
            translation.velocity,
            translation.phase_acceleration,
            steering.velocity,
            steering.phase_acceleration,
        )

    def advance(self, dt_s: float) -> None:
        """Let dt_s seconds pass in all axes."""
        self.translation.advance(dt_s)
        self.steering_rad += self.steering.advance(dt_s)
        self.turret_rad += self.turret.advance(dt_s)

    def block(self) -> None:
        """Something is in the way: the wheels no longer roll; steering and turret go on."""
        self.translation.halt()

    def put(self, steering_rad: float, turret_rad: float) -> None:
        """Set the mechanical angles, as hands would; motions under way go on from there."""
        self.steering_rad = steering_rad
        self.turret_rad = turret_rad

    def seek_zero(self) -> None:
        """Turn steering and turret to the bumpers' zero, the short way, at the speeds set; the wheels stop.

        An axis whose speed was set to 0 turns at its top speed: a robot that never finds its zero helps nobody.
        """
        self.translation.stop()
        for axis, angle in ((self.steering, self.steering_rad), (self.turret, self.turret_rad)):
            axis.move_by(-short_way(angle), axis.speed or axis.limits.top_speed)

    def found_zero(self) -> None:
        """The search is over: what is left of both angles is rounding and whole turns."""
        self.put(0.0, 0.0)
