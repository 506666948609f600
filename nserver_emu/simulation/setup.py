"""Setups: how much like a real robot a simulated one is. Data; whoever uses a number explains it.

ideal     axes jump to their speed, motion is exact, one exact ray a sonar
noisy     axes ramp, motion strays like a random walk, sonars with 1 % noise: the settings of the experiments
measured  as noisy, but the sonars hear like a Polaroid ring: cone, mirrors, second echoes, cross-talk;
          infrareds, compass and clock err as well
worn      as noisy, on wheels that err the same way every time: at the end of UMBmark's square of 4 m a robot with
          a synchro drive is 126 mm off, a Scout 338 mm, as robots are that nobody has calibrated

Files can make more of them: setup_toml.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians
from types import MappingProxyType
from typing import Final

from nserver_emu.simulation.compass import TRUE_NEEDLE, CompassNoise
from nserver_emu.simulation.infrared import CLEAR_SIGHT, InfraredNoise
from nserver_emu.simulation.noise import NO_NOISE, MotionNoise
from nserver_emu.simulation.odometry import EXACT, Odometry
from nserver_emu.simulation.polaroid import Polaroid
from nserver_emu.simulation.sonar import EchoModel, SonarNoise


@dataclass(frozen=True, slots=True)
class RobotSetup:
    """A named way to simulate a robot.

    name      what users call it
    ramps     False: axes jump to their speed, as the original documents; True: trapezoids
    motion    how the true motion strays from the commanded one: alpha1 to alpha4
    sonar     what the sonars hear, and how readings stray from the true range
    odometry  what the wheels get wrong every time: scales, drifts, slip
    infrared  how light comes back to the infrareds
    compass   noise and deviation of the compass
    clock_step_s   the robot's clock goes in steps of this; 0: in milliseconds
    """

    name: str
    ramps: bool
    motion: MotionNoise
    sonar: EchoModel
    odometry: Odometry = EXACT
    infrared: InfraredNoise = CLEAR_SIGHT
    compass: CompassNoise = TRUE_NEEDLE
    clock_step_s: float = 0.0

    @property
    def moves_as_told(self) -> bool:
        """Whether every motion is as commanded; there may be slip."""
        return self.motion == NO_NOISE and self.odometry.turns_as_told


IDEAL: Final = RobotSetup("ideal", ramps=False, motion=NO_NOISE, sonar=SonarNoise())
NOISY: Final = RobotSetup(
    "noisy",
    ramps=True,
    motion=MotionNoise.walk(along=0.1, turn=0.1, drift=0.005),
    sonar=SonarNoise(std_share=0.01, least_std_in=0.05),
)
MEASURED: Final = RobotSetup(
    "measured",
    ramps=True,
    motion=NOISY.motion,
    sonar=Polaroid(),
    infrared=InfraredNoise(std_share=0.05, slanted=True),
    compass=CompassNoise(std_rad=radians(0.5), deviation_rad=radians(6.0)),
    clock_step_s=0.0164,
)
WORN: Final = replace(
    NOISY,
    name="worn",
    odometry=Odometry(scales=(1.0015, 1.0, 1.0), drifts=(7e-5, 0.0), slip_in=0.1),
)

SETUPS: Final[Mapping[str, RobotSetup]] = MappingProxyType(
    {setup.name: setup for setup in (IDEAL, NOISY, MEASURED, WORN)}
)
"""Every setup by its name."""


def setup_names() -> tuple[str, ...]:
    """The setups that have a name."""
    return tuple(SETUPS)
