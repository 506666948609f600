"""What a calibrating filter has found, as a calibration and as a table. Rules: values and words."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees

import numpy as np

from localization.belief import Belief
from localization.calibration.estimator import OFFSET, OWN, RING_TURN, SIZE
from localization.systematic import Constant
from worlds.calibration import Calibration, Spread


def calibration_in(belief: Belief) -> Calibration:
    """The constants of a belief over states (24,), with their standard deviations."""
    mean, std, cov = belief.mean, belief.std, belief.cov
    offsets = mean[OFFSET] + mean[OWN:SIZE]
    spread = np.sqrt(cov[OFFSET, OFFSET] + np.diagonal(cov)[OWN:SIZE] + 2.0 * cov[OFFSET, OWN:SIZE])
    return Calibration(
        1.0 + float(mean[Constant.WAY_SCALE]),
        1.0 + float(mean[Constant.TURN_SCALE]),
        float(mean[Constant.DRIFT]),
        tuple(offsets.tolist()),
        float(mean[RING_TURN]),
        Spread(
            float(std[Constant.WAY_SCALE]),
            float(std[Constant.TURN_SCALE]),
            float(std[Constant.DRIFT]),
            tuple(spread.tolist()),
            float(std[RING_TURN]),
        ),
    )


def table(found: Calibration) -> str:
    """For people: each number with its standard deviation."""
    return "\n".join(_rows(found))


def _rows(found: Calibration) -> Iterator[str]:
    spread = found.spread
    yield f"{'':24}{'found':>12}{'± std':>12}"
    yield f"{'way, true / counted':24}{found.way_scale:12.4f}{spread.way_scale:12.4f}"
    yield f"{'turn, true / counted':24}{found.turn_scale:12.4f}{spread.turn_scale:12.4f}"
    yield f"{'drift, rad/in':24}{found.drift_rad_in:12.5f}{spread.drift_rad_in:12.5f}"
    yield f"{'ring turned, deg':24}{degrees(found.turned_rad):12.2f}{degrees(spread.turned_rad):12.2f}"
    for sonar, (offset, std) in enumerate(zip(found.offsets_in, spread.offsets_in, strict=True)):
        yield f"{f'sonar {sonar:2d} reads more, in':24}{offset:12.2f}{std:12.2f}"


