"""What a live trial is run with: world and path, how the simulated robot errs, and what the filter knows of it. Data.

Rules: numbers only. A scenario makes the text of a setup file for each seed, for what is drawn anew with each run; the
simulation is reached by a `sim:` address like any robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from localization.filters.base import THESIS_ODOMETRY
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar
from localization.live.sensor_input import CLOCK_STEP_S

COURSES: Final[Mapping[str, str]] = MappingProxyType(
    {"5.4": "thesis_room", "5.8": "several_walls", "5.9": "centre_vertex"}
)
"""The paths that live trials are driven on, by their figures, and the world of each."""

START_STD: Final = (0.2, 0.2, 0.01)
"""How well the robot is placed: inches, inches, radians."""
QUIET: Final = OdometryNoise(translation_std=0.05, rotation_std=0.05, drift_std=0.002)
"""How the true motion strays from the encoders', in the figures' model."""
EXACT_RAYS: Final = RaySonar(
    relative_std=0.0, floor_std_in=0.02, rounding_var_in2=1.0 / 12.0, lowest_in=6.0, highest_in=255.0
)
"""Rays without noise, read in whole inches."""
SCALE, BAD = 1, 2
"""Which stream of a seed's chance each is drawn from."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """One way to run a trial; the filter is told all of it but the draws.

    base                 the simulation's named setup          odometry      its random walk, known to the filter
    scale_std            std of the odometry's scale, drawn for each run; the filter finds it out
    bad_share            of the readings replaced by one anywhere from 6 to 255 in
    sonar                how the filter understands readings   method        its method
    judged_after_in      inches of way after which the estimate is judged
    line                 over the robot's own line: no stamps, and a clock in steps of 16.4 ms
    """

    name: str
    base: str
    sonar: RaySonar | ConeSonar
    odometry: OdometryNoise = QUIET
    scale_std: float = 0.0
    bad_share: float = 0.0
    judged_after_in: float = 0.0
    speed_in_s: float = 5.0
    method: str = "ekf"
    line: bool = False

    def setup(self, seed: int) -> str:
        """The setup file of a run, in TOML."""
        noise = self.odometry
        clock = f"clock_step_s = {CLOCK_STEP_S}\n" if self.line else ""
        return (
            f'base = "{self.base}"\nramps = true\nname = "{self.name}"\n{clock}'
            f"[odometry]\nscales = [{self.scale(seed)!r}, 1.0, 1.0]\n"
            f"[motion]\nalpha1 = {noise.rotation_std**2!r}\nalpha2 = {noise.drift_std**2!r}\n"
            f"alpha3 = {noise.translation_std**2!r}\nalpha4 = 0.0\n"
        )

    def scale(self, seed: int) -> float:
        """True travel per counted travel in the run of this seed."""
        draw = float(np.random.default_rng([seed, SCALE]).standard_normal())
        return 1.0 + self.scale_std * float(np.clip(draw, -4.0, 4.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """What else the filter finds out, as uncertain as it is (systematic)."""
        return (self.scale_std,) if self.scale_std else ()


SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType(
    {
        scenario.name: scenario
        for scenario in (
            Scenario("exact", "ideal", EXACT_RAYS),
            Scenario("noisy", "noisy", WIRE_SONAR, THESIS_ODOMETRY),
            Scenario("measured", "measured", ConeSonar(), scale_std=0.05, bad_share=0.2, judged_after_in=24.0),
            Scenario("exact_line", "ideal", EXACT_RAYS, line=True),
            Scenario("measured_line", "measured", ConeSonar(), scale_std=0.05, bad_share=0.2, judged_after_in=24.0,
                     line=True),
        )
    }
)
"""`exact`: exact rays. `noisy`: rays and odometry as noisy as the figures'. `measured`: a real ring's sonars, a fifth
of its readings bad besides, and a scale to find. `_line`: the same over the robot's own line."""
