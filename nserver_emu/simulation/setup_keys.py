"""Every key of a setup file: where it goes, what it may be, what it means. Data; reader and page of keys read it.

    Key    table | field of the table's dataclass | lowest and highest | unit | meaning

Rules: one row for each field of the dataclasses that a setup is made of; a field in radians is a key in degrees.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from nserver_emu.simulation.setup import RobotSetup

SONAR_NUMBERS: Final = "sonars"
"""The unit of a list of sonars, 0 to 15."""


class Key(NamedTuple):
    """A row; "" as table: the top of the file. `ears`: which of the two sonar models has it, "" for both."""

    table: str
    field: str
    low: float
    high: float
    unit: str
    meaning: str
    ears: str = ""

    @property
    def name(self) -> str:
        """What users write."""
        return f"{self.field.removesuffix('_rad')}_deg" if self.in_degrees else self.field

    @property
    def in_degrees(self) -> bool:
        """Whether it is an angle, which physics has in radians."""
        return self.field.endswith("_rad")

    def of(self, setup: RobotSetup) -> object:
        """What a setup has there, in physics' units; None where its sonar model has no such thing."""
        return getattr(getattr(setup, self.table) if self.table else setup, self.field, None)


RAY, POLAROID = "ray", "polaroid"
"""The two sonar models: one exact ray with noise; a Polaroid ring."""

KEYS: Final = (
    Key("", "ramps", 0, 1, "", "axes ramp as trapezoids; else they jump to their speed"),
    Key("", "clock_step_s", 0, 1, "s", "the robot's clock goes in steps of this; 0: in milliseconds"),
    Key("motion", "alpha1", 0, 10, "rad", "variance of the turn a radian turned"),
    Key("motion", "alpha2", 0, 10, "rad^2/in", "variance of the turn an inch driven"),
    Key("motion", "alpha3", 0, 10, "in", "variance of the way an inch driven"),
    Key("motion", "alpha4", 0, 10, "in^2/rad", "variance of the way a radian turned"),
    Key("odometry", "scales", 0.5, 2, "", "true travel per counted travel: translation, steering, turret (Scout: "
        "right, left wheel, nothing)"),
    Key("odometry", "drifts", -0.1, 0.1, "rad/in, rad/rad", "turn of the body per counted travel of the first two axes "
        "(Scout: rad/in both)"),
    Key("odometry", "slip_in", 0, 10, "in", "way the wheels roll on the spot at every contact"),
    Key("sonar", "std_share", 0, 1, "", "standard deviation of a range as a share of it"),
    Key("sonar", "least_std_in", 0, 10, "in", "and never less than this"),
    Key("sonar", "dead", 0, 15, SONAR_NUMBERS, "sonars that read 0 for ever"),
    Key("sonar", "offsets_in", -24, 24, "in", "what each of the 16 sonars reads more than the range, always"),
    Key("sonar", "turned_rad", -45, 45, "deg", "the ring stands turned by this against the turret"),
    Key("sonar", "cone_rad", 1, 90, "deg", "whole angle of the cone inside which a sonar cries and hears", POLAROID),
    Key("sonar", "sound_in_s", 1000, 100000, "in/s", "speed of sound", POLAROID),
    Key("sonar", "margin_db", 0, 200, "dB", "how much louder than just audible a near wall is, met head-on", POLAROID),
    Key("sonar", "margin_std_db", 0, 20, "dB", "standard deviation of that from cry to cry", POLAROID),
    Key("sonar", "cone_loss_db", 0, 200, "dB", "lost at the rim of the cone, out and back together", POLAROID),
    Key("sonar", "way_loss_db_in", 0.02, 100, "dB/in", "lost an inch of range", POLAROID),
    Key("sonar", "bounce_loss_db", 0, 200, "dB", "lost at each wall after the first", POLAROID),
    Key("sonar", "edge_loss_db", 0, 200, "dB", "lost at an edge, against a wall", POLAROID),
    Key("sonar", "skin_loss_db", 0, 200, "dB", "lost at the skin of a robot that does not face the sonar", POLAROID),
    Key("sonar", "blanking_in", 0, 24, "in", "echoes of neighbours from nearer are not heard", POLAROID),
    Key("sonar", "recess_in", 0, 4, "in", "how deep behind the ring the transducers sit", POLAROID),
    Key("infrared", "std_share", 0, 1, "", "standard deviation of a range as a share of it"),
    Key("infrared", "slanted", 0, 1, "", "what is seen at a slant looks farther"),
    Key("compass", "std_rad", 0, 90, "deg", "standard deviation of a reading"),
    Key("compass", "deviation_rad", 0, 90, "deg", "the robot's iron, until calibrated: d sin(heading + phase)"),
    Key("compass", "phase_rad", -360, 360, "deg", "the phase in that"),
)  # fmt: skip
