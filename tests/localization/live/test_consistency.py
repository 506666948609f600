"""Consistency of a run's readings."""

from __future__ import annotations

import pytest

from localization.filters.update import Refusal
from localization.live.assumptions import Consistency
from localization.live.estimate import Echo


def echo(refusal: Refusal, nis: float = 0.0) -> Echo:
    return Echo(0, 1.0, 50.0, refusal, 0.0, nis)


def test_nis_and_refused_fraction() -> None:
    fit = Consistency(rays=True)
    assert (fit.nis, fit.refused_fraction, fit.is_good) == (0.0, 0.0, True)
    # The mean of 0.5 and 1.5. Limits and ambiguous walls are no refusals.
    fit.add([echo(Refusal.NONE, 0.5), echo(Refusal.NONE, 1.5), echo(Refusal.LIMIT), echo(Refusal.AMBIGUOUS_WALL)])
    assert (fit.nis, fit.refused_fraction) == (1.0, 0.0)
    assert fit.line() == "readings fit with a NIS of 1.00 (1 is right), 0.0% refused"


@pytest.mark.parametrize("rays", [True, False])
def test_many_refusals_are_not_good_of_rays(rays: bool) -> None:
    fit = Consistency(rays)
    fit.add([*[echo(Refusal.NONE, 1.0)] * 8, *[echo(Refusal.GATE, 20.0)] * 2])
    assert fit.refused_fraction == 0.2
    assert fit.is_good is not rays
    assert ("do not believe this" in fit.line()) is rays
    assert ("--sonars cones" in fit.line()) is rays


def test_nor_is_a_large_nis() -> None:
    fit = Consistency(rays=False)
    fit.add([echo(Refusal.NONE, 1.6)])
    assert not fit.is_good
    assert "--odometry-noise" in fit.line()
