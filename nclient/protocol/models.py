"""What the wire knows of a robot's model: its number, its fixed mask, its bumper bytes. Geometry is worlds.bodies'.

    N150 and Scout never send a mask: their packets always hold the sonars, bumpers, pose, velocities and compass.
"""

from __future__ import annotations

from dataclasses import dataclass

from nclient.errors import AddressError


@dataclass(frozen=True, slots=True)
class Model:
    """A row of the model table as the wire sees it."""

    name: str
    number: int
    """The number the C libraries use."""
    sends_mask: bool
    """Whether the robot's own line has a mask (ct), position data, infrared, compass question and laser."""
    bumpers_low_first: bool
    """Order of the three bumper bytes: Scout b0 + 256 b1 + 65536 b2, the others b2 + 256 b1 + 65536 b0."""
    bumper_rest: int
    """What State[33] reads over the robot's own line when nothing touches."""
    has_infrared: bool
    has_laser: bool
    has_turret: bool


N200 = Model("n200", 0, True, False, 0xF00000, has_infrared=True, has_laser=True, has_turret=True)
N150 = Model("n150", 1, False, False, 0xF00000, has_infrared=False, has_laser=False, has_turret=True)
SCOUT = Model("scout", 2, False, True, 0, has_infrared=False, has_laser=False, has_turret=False)

MODELS = {model.name: model for model in (N150, N200, SCOUT)}
"""Every model by its lower-case name."""


def model_named(name: str) -> Model:
    """The model of that name. Raises AddressError, naming the models there are."""
    try:
        return MODELS[name.lower()]
    except KeyError:
        raise AddressError(f"no robot model {name!r}; there are {', '.join(MODELS)}") from None


DEFAULT_SONAR_ORDER = (0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8)
"""The ring's firing order before any conf_sn (PROTOCOL.md, section 3)."""
DEFAULT_SONAR_RATE = 15
"""Its rate: 60 ms from one sonar to the next."""
SONAR_RATE_STEP_S = 0.004
"""The unit of conf_sn's rate."""
