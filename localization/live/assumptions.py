"""Assumptions about a robot that neither the user nor the robot states: its model and its sonars.

Everything is derived from the address, the setup file it names, and the options --body and --sonars.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.base import sonar_of
from localization.filters.belief import POSE, Belief
from localization.filters.global_localization import is_wide
from localization.filters.range_table import sampled_echoes
from localization.filters.sonar_ray import ranges_from, wall_map
from localization.filters.update import Refusal
from localization.live.estimate import Echo
from localization.live.sensor_input import SensorInput
from nclient.connector import address_or_default
from nclient.errors import AddressError, WorldFileError, suggest
from nclient.protocol.types import MAX_SONAR_IN, MIN_SONAR_IN
from nclient.url import split_address
from worlds.robots import BODIES, Body, load_bodies
from worlds.schema import parse_toml, read_text

SIMULATION: Final = "sim"
MODEL_FILE: Final = "model_file"
"""Option of sim: addresses."""


def resolve_robot_model(option: str | None, model: str, address: str | None) -> str:
    """Return the name of the robot model: from the address, or from --body if the address does not name one.

    Parameters
    ----------
    option : str or None
        Value of --body.
    model : str
        Model of the connected robot.
    address : str or None
        Address of the robot; None for the default address.

    Raises
    ------
    AddressError
        If option and address contradict each other: sizes, sonars and turret of another robot would make every
        estimate wrong.
    """
    there = split_address(address_or_default(address))
    # A robot of a model file has a name of its own, while its protocol is that of a Nomad.
    if there.scheme == SIMULATION and MODEL_FILE in there.options:
        model = there.options.get("robot", model).lower()
    is_given = there.scheme == SIMULATION or "model" in there.options
    if option is None or (is_given and option == model):
        return model
    if is_given:
        raise AddressError(f"--body {option}: the robot at {there.text} is of model {model}; omit --body")
    return option


def resolve_body(name: str, model_file: Path | None, address: str | None) -> Body:
    """Return the body of a robot model: from a model file, that of a sim: address, or a Nomad's.

    Raises
    ------
    AddressError
        If there is no model of that name.
    WorldFileError
        If the file cannot be read.
    """
    there = split_address(address_or_default(address))
    if model_file is None and there.scheme == SIMULATION and MODEL_FILE in there.options:
        model_file = Path(there.options[MODEL_FILE])
    bodies = BODIES if model_file is None else load_bodies(model_file)
    if name not in bodies:
        hint = suggest(name, bodies)
        raise AddressError(f"no robot model {name!r}{hint}; there are {', '.join(bodies)} (--model-file for others)")
    return bodies[name]


MIN_READINGS: Final = 30
"""With fewer readings a bad fit may be random."""


class SonarAssumption(NamedTuple):
    """Assumed sonar model.

    Attributes
    ----------
    rays
        True for exact rays, False for cones.
    guessed
        True if neither the user nor the address states it.
    building
        True for the walls of a real building.
    evidence
        What the first readings say, where these decide.
    """

    rays: bool
    guessed: bool
    building: bool = False
    evidence: str = ""

    def line(self) -> str:
        """Return the guess as text; "" if the model was given or is that of a real robot."""
        if self.evidence:
            model = "measure exact rays" if self.rays else "have cones"
            return f"assuming that sonars {model}: {self.evidence} (see --sonars)"
        if not (self.rays and self.guessed):
            return ""
        return (
            "assuming that sonars measure exact rays, as this is a simulation (with setup measured use --sonars cones)"
        )


ASSUME_CONES: Final = SonarAssumption(rays=False, guessed=False)
RING_SETUPS: Final = ("measured", "building")
"""Named setups that simulate a real ring."""
BUILDING_SETUP: Final = "building"
"""The one of them with the walls of a real building, and the value of --sonars for them."""
RING_MODEL: Final = "polaroid"
"""Sonar model of a real ring in setup files."""


def resolve_sonar_model(option: str | None, simulated: bool, address: str | None = None) -> SonarAssumption:
    """Return the sonar model to assume.

    Without the option: for a sim: address that of its setup (exact rays for ideal, noisy and worn, cones for
    measured, those in a building for building), for other simulations rays, as a server does not report its setup, and
    for robots cones.

    Parameters
    ----------
    option : str or None
        Value of --sonars: "rays", "cones", "building" or None.
    simulated : bool
        True if the robot is simulated.
    address : str or None
        Address of the robot; None for the default address.
    """
    if option is not None:
        return SonarAssumption(option == "rays", guessed=False, building=option == BUILDING_SETUP)
    address = address_or_default(address)
    has_rays = sonar_model_of_address(address)
    if has_rays is None:
        return SonarAssumption(simulated, guessed=True)
    is_building = (setup_of(address) or {}).get("base") == BUILDING_SETUP
    return SonarAssumption(has_rays, guessed=False, building=not has_rays and is_building)


# The model, from the first readings.

MIN_RAY_FIT: Final = 0.78
"""Fraction of readings from which sonars measure exact rays: of those from a pose that is known to 1 in and 2 degrees
all fit, to 3 in and 5 degrees 62 to 100 %; of a ring with cones 14 to 69 %."""
MAX_NOTHING_PROBABILITY: Final = 1e-3
"""Of so many readings of "nothing" where exact rays would meet walls, from an unknown pose."""
SAMPLED_POSES: Final = 200
"""Poses of the belief that are compared."""
TOLERANCE_IN, TOLERANCE = 3.0, 0.05
"""A reading fits a range within an offset of the ring and a fraction of the range: sonars have noise of 1 %."""
PLACES: Final = 48
"""Random places that stand for an unknown pose."""
FAR_IN: Final = 240.0
"""Beyond this range, nothing and an echo are the same."""


def decide_by_readings(sonars: SonarAssumption, belief: Belief | None, state: SensorInput, walls: npt.ArrayLike,
                       body: Body) -> SonarAssumption:
    """Return the sonar model that the readings of a standing robot fit; unchanged where it is not guessed to be rays.

    Exact rays always return the distance to the wall ahead of a sonar; a ring with cones returns the nearest part of a
    wall, or nothing of one that slants.

    Parameters
    ----------
    sonars : SonarAssumption
    belief : Belief or None
        Of the pose; None or a wide one if it is unknown.
    state : SensorInput
        State after a full round of the ring.
    walls : (m, 4) array
        The map.
    body : Body
    """
    if not (sonars.rays and sonars.guessed) or not state.sonars_in:
        return sonars
    readings = np.array(state.sonars_in[: body.ring.count], dtype=np.float64)
    angles = np.array(body.sonar_angles_rad[: len(readings)]) + (state.turret_rad - state.steering_rad)
    # Always the same samples, so that a run can be repeated.
    rng = np.random.default_rng(0)
    if belief is None or is_wide(belief):
        ranges, probabilities = sampled_echoes(walls, body, sonar_of(body.ring, rays=True), body.radius_in, PLACES)
        nothing = 1.0 - float(((probabilities > 0.0) & (ranges < FAR_IN)).mean()) if ranges.size else 1.0
        count = int((readings >= FAR_IN).sum())
        probability = sum(
            comb(len(readings), k) * nothing**k * (1.0 - nothing) ** (len(readings) - k)
            for k in range(count, len(readings) + 1)
        )
        return sonars._replace(
            rays=probability >= MAX_NOTHING_PROBABILITY,
            evidence=f"{count} of the first {len(readings)} readings are no echo, {nothing:.0%} would be of exact rays",
        )
    # 1. The poses that the belief covers; the first is its mean.
    poses = belief.mean[:POSE] + rng.standard_normal((SAMPLED_POSES, POSE)) * belief.std[:POSE]
    poses[0] = belief.mean[:POSE]
    # 2. The best fit of any. Nearer than the shortest reading, and nothing from far away, fit everything.
    expected = ranges_from(poses, angles, body, wall_map(walls)).range_in
    expected = np.clip(np.nan_to_num(expected, nan=MAX_SONAR_IN, posinf=MAX_SONAR_IN), MIN_SONAR_IN, MAX_SONAR_IN)
    counts = ((expected < FAR_IN) | (readings < FAR_IN)) & ((expected > MIN_SONAR_IN) | (readings > MIN_SONAR_IN + 2))
    fits = np.abs(readings - expected) <= TOLERANCE_IN + TOLERANCE * expected
    fractions = (fits & counts).sum(axis=-1) / np.maximum(counts.sum(axis=-1), 1)
    if not counts.any():
        return sonars
    fit = float(fractions.max())
    return sonars._replace(rays=fit >= MIN_RAY_FIT, evidence=f"{fit:.0%} of the first readings fit exact rays")


def setup_of(address: str) -> dict[str, Any] | None:
    """Return the values of the setup of a sim: address, of a named one its base; None if they are unknown."""
    there = split_address(address)
    if there.scheme != SIMULATION:
        return None
    setup = there.options.get("setup", "")
    if not setup.endswith(".toml"):
        return {"base": setup}
    try:
        return parse_toml(read_text(Path(setup)), setup)
    except WorldFileError:
        return None


def sonar_model_of_address(address: str) -> bool | None:
    """Return True if the setup of a sim: address has exact rays, False for cones, None if unknown."""
    values = setup_of(address)
    if values is None:
        return None
    sonar = values.get("sonar", {})
    model = sonar.get("model") if isinstance(sonar, dict) else None
    return values.get("base") not in RING_SETUPS if model is None else model != RING_MODEL


# Consistency of a whole run.

MAX_NIS: Final = 1.5
MAX_REFUSED: Final = {True: 0.1, False: 0.35}
"""By whether sonars are exact rays; many readings of a real ring are outliers anyway."""


@dataclass
class Consistency:
    """NIS and refusals over a run. With a noise model that is too optimistic the NIS is above 1.

    `rays` is True if sonars are taken for exact rays.
    """

    rays: bool
    used: int = 0
    refused: int = 0
    nis_sum: float = 0.0

    def add(self, echoes: Iterable[Echo]) -> None:
        """Add the echoes of a period."""
        for echo in echoes:
            if echo.refusal is Refusal.NONE:
                self.used += 1
                self.nis_sum += echo.nis
            elif echo.refusal is Refusal.GATE:
                self.refused += 1

    @property
    def nis(self) -> float:
        """Mean NIS of the readings used, 1 for a consistent filter; 0 of none."""
        return self.nis_sum / self.used if self.used else 0.0

    @property
    def refused_fraction(self) -> float:
        """Fraction of ranges that the gate refused; 0 of none."""
        return self.refused / (self.used + self.refused) if self.refused else 0.0

    @property
    def is_good(self) -> bool:
        """True if the estimate can be trusted as far as its covariance says."""
        return self.nis <= MAX_NIS and self.refused_fraction <= MAX_REFUSED[self.rays]

    def line(self) -> str:
        """Return the figures in words, with the remedy where they are not good."""
        text = f"readings fit with a NIS of {self.nis:.2f} (1 is right), {self.refused_fraction:.1%} refused"
        if self.is_good:
            return text
        ring = "a real ring's cones are taken for rays (--sonars cones), " if self.rays else ""
        return (
            f"{text}: do not believe this. The encoders miss more than --odometry-noise says, "
            f"{ring}--start is elsewhere, or the map is not of this room"
        )


def sonar_mismatch_hint(sonars: SonarAssumption, echoes: Iterable[Echo]) -> str:
    """Return a hint if the model was a guess and does not fit the echoes; else ""."""
    if not (sonars.rays and sonars.guessed):
        return ""
    fit = Consistency(sonars.rays)
    fit.add(echoes)
    return "" if fit.is_good or fit.used + fit.refused < MIN_READINGS else fit.line()
