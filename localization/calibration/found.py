"""What a calibrating filter has found, as a calibration and as a table. Rules: values and words."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees

import numpy as np

from localization.calibration.precision import numbers
from localization.filters.belief import Belief
from localization.filters.calibration import OFFSET, OWN, RING_TURN, SIZE
from localization.filters.odometry import OdometryParameter
from worlds.calibration import Calibration, Spread


def calibration_in(belief: Belief) -> Calibration:
    """The constants of a belief over states (24,), with their standard deviations."""
    mean, std, cov = belief.mean, belief.std, belief.cov
    offsets = mean[OFFSET] + mean[OWN:SIZE]
    spread = np.sqrt(cov[OFFSET, OFFSET] + np.diagonal(cov)[OWN:SIZE] + 2.0 * cov[OFFSET, OWN:SIZE])
    return Calibration(
        1.0 + float(mean[OdometryParameter.DISTANCE_SCALE]),
        1.0 + float(mean[OdometryParameter.TURN_SCALE]),
        float(mean[OdometryParameter.DRIFT]),
        tuple(offsets.tolist()),
        float(mean[RING_TURN]),
        Spread(
            float(std[OdometryParameter.DISTANCE_SCALE]),
            float(std[OdometryParameter.TURN_SCALE]),
            float(std[OdometryParameter.DRIFT]),
            tuple(spread.tolist()),
            float(std[RING_TURN]),
        ),
    )


def table(found: Calibration) -> str:
    """For people: each number with its standard deviation, and how well that is known of what it is."""
    return "\n".join(_rows(found))


def _rows(found: Calibration) -> Iterator[str]:
    way, turn, drift, ring, *sonars = numbers(found)
    yield f"{'':24}{'found':>12}{'± std':>12}"
    yield _row("way, true / counted", 1.0 + way.off, way.std, 4, way.words)
    yield _row("turn, true / counted", 1.0 + turn.off, turn.std, 4, turn.words)
    yield _row("drift, rad/in", drift.off, drift.std, 5, drift.words)
    yield _row("ring turned, deg", degrees(ring.off), degrees(ring.std), 2, ring.words)
    for sonar in sonars:
        yield _row(f"sonar {sonar.name.removeprefix('sonar '):>2} reads more, in", sonar.off, sonar.std, 2, sonar.words)


def _row(name: str, value: float, std: float, places: int, words: str) -> str:
    return f"{name:24}{value:12.{places}f}{std:12.{places}f}   {words}"
