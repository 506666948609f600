"""Assumptions about a robot that neither the user nor the robot states: its model and its sonars.

Everything is derived from the address, the setup file it names, and the options --body and --sonars.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from localization.live.localizer import Consistency, Echo
from nclient.common.hints import suggest
from nclient.connector import address_or_default
from nclient.errors import AddressError, WorldFileError
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
    """Assumed sonar model (rays or cones), True if it is a guess, and True for walls of a real building."""

    rays: bool
    guessed: bool
    building: bool = False

    def line(self) -> str:
        """Return the guess as text; "" if the model was given or is that of a real robot."""
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
    return SonarAssumption(has_rays, guessed=False, building=not has_rays and setup_of(address) == BUILDING_SETUP)


def setup_of(address: str) -> str:
    """Return the setup of a sim: address, of a setup file its base; "" if there is none."""
    setup = split_address(address).options.get("setup", "")
    if not setup.endswith(".toml"):
        return setup
    try:
        return str(parse_toml(read_text(Path(setup)), setup).get("base", ""))
    except WorldFileError:
        return ""


def sonar_model_of_address(address: str) -> bool | None:
    """Return True if the setup of a sim: address has exact rays, False for cones, None if unknown."""
    there = split_address(address)
    if there.scheme != SIMULATION:
        return None
    setup = there.options.get("setup", "")
    if not setup.endswith(".toml"):
        return setup not in RING_SETUPS
    try:
        values = parse_toml(read_text(Path(setup)), setup)
    except WorldFileError:
        return None
    sonar = values.get("sonar", {})
    model = sonar.get("model") if isinstance(sonar, dict) else None
    return values.get("base") not in RING_SETUPS if model is None else model != RING_MODEL


def sonar_mismatch_hint(sonars: SonarAssumption, echoes: Iterable[Echo]) -> str:
    """Return a hint if the model was a guess and does not fit the echoes; else ""."""
    if not sonars.line():
        return ""
    fit = Consistency(sonars.rays)
    fit.add(echoes)
    return "" if fit.is_good or fit.used + fit.refused < MIN_READINGS else fit.line()
