"""Where a sonar looks, told by what it hears at all: a wall that is met head-on just inside the cone, or just not.

A range hardly depends on the angle under which a smooth wall is met, so ranges alone say little of how the ring is
mounted. Which wall is heard does: each is heard over as many degrees as the cone is wide, about its own normal. So for
a normal prior N(0, s^2) of the axis, off from where it is thought to look,

    posterior(off) ~ N(off; 0, s^2) p(reading | off)        p: bad readings and all that the cone may hear there

is worked out at some offs, and what is left of it is its mean and its variance (assumed density). Rules: pure; one
reading, one axis; what it means for a state is filters.calibrating's to say.
"""

from __future__ import annotations

from math import exp, pi, radians, sqrt
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import Floats
from localization.sonar.cone import ConeModel, Ear
from localization.sonar.measurement import SonarRing, wall_map
from localization.sonar.reflectors import reflectors
from localization.sonar.single_cone import Listener, Return

EDGE_STD_RAD: Final = radians(0.5)
"""How sharp the rim of a cone is taken to be."""
NODES: Final = np.arange(-3.0, 3.01, 0.5)
"""Where the posterior is worked out, in standard deviations."""
_WEIGHTS: Final = np.exp(-0.5 * NODES * NODES) / np.exp(-0.5 * NODES * NODES).sum()
_VARIANCE: Final = float(_WEIGHTS @ (NODES * NODES))
_SPACING: Final = 0.5
_FROM_THE_ENDS: Final = [6, 0, 12, *(at for at in range(1, 12) if at != 6)]
NARROW_RAD: Final = radians(1.0)
"""With an axis known so well nothing is heard in the middle of both ends only: a cone is wider than that."""
ALIKE: Final = 0.01


class Look(NamedTuple):
    """A reading and what is believed of the sonar before it.

    pose          of the robot                     sonar, offset_rad    its number; the ring against the heading
    std_rad       of the heading and ring, together
    reading_in    less the sonar's own offset; at or above the model's highest: nothing was heard
    spread_in2    variance of ranges by all but the reading's own noise
    """

    pose: tuple[float, float, float]
    sonar: int
    offset_rad: float
    std_rad: float
    reading_in: float
    spread_in2: float


class Aiming:
    """The sonars of a body in a map."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, model: ConeModel) -> None:
        self._listener = Listener(reflectors(wall_map(walls).segments), model)
        self._body, self._model = body, model

    def after(self, look: Look) -> tuple[float, float]:
        """How far off the axis looks after it, radians, and the variance of that as a share of what it was."""
        edge_rad = max(EDGE_STD_RAD, _SPACING * look.std_rad)
        direction_rad = look.offset_rad + self._body.sonar_angles_rad[look.sonar]
        likelihood = np.empty(len(NODES))
        known: dict[int, float] = {}
        for count, at in enumerate(_FROM_THE_ENDS):
            ear = Ear(direction_rad + float(NODES[at]) * look.std_rad, self._body.sonar_ring_radius_in)
            likelihood[at] = _likelihood(self._listener.hear(look.pose, edge_rad, ear), known, self._model, look)
            if count == 2 and look.std_rad < NARROW_RAD and _alike(likelihood[_FROM_THE_ENDS[:3]]):
                return 0.0, 1.0
        posterior = _WEIGHTS * likelihood
        posterior /= posterior.sum()
        mean = float(posterior @ NODES)
        return mean * look.std_rad, float(posterior @ np.square(NODES - mean)) / _VARIANCE


def _alike(likelihood: Floats) -> bool:
    """Whether nothing is told."""
    return float(likelihood.max() - likelihood.min()) <= ALIKE * float(likelihood.max())


def _likelihood(heard: list[Return], known: dict[int, float], model: ConeModel, look: Look) -> float:
    """p(reading | what may be heard); `known`: densities by reflector, which hold for all offs alike."""
    good = 1.0 - model.bad_share
    if look.reading_in >= model.highest_in:
        return 1.0 - good * sum([found.probability for found in heard])
    total, any_of = 0.0, 0.0
    for found in heard:
        density = known.get(found.which)
        if density is None:
            variance, off_in = look.spread_in2 + model.variance_at(found.range_in), look.reading_in - found.range_in
            known[found.which] = density = exp(-0.5 * off_in * off_in / variance) / sqrt(2.0 * pi * variance)
        total += found.probability * density
        any_of += found.probability
    return good * total + model.bad_density * (1.0 - good * any_of)
