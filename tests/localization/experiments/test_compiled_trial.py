"""Steps of a figure robot by robot, as numba compiles them, against the steps in arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.experiments import compiled_trial, execution
from localization.experiments.figure_trial import FIGURES, FigureSetup, Runs, figure_setup, run
from localization.filters import compiled

QUANTITIES = ("truth", "mean", "cov", "bound", "nis", "used", "steps", "reached")


def course(name: str = "5.8") -> FigureSetup:
    """Some steps among several walls, where beams are refused."""
    goals = np.array([[2.0, 1.0], [3.0, 3.0]])
    return replace(figure_setup(FIGURES[name]), goals_in=goals, gains=FIGURES["5.6"].gains)


def largest_difference(one: Runs, other: Runs) -> float:
    pairs = ((getattr(one, name), getattr(other, name)) for name in QUANTITIES)
    return max(float(np.abs(np.subtract(a, b, dtype=float)).max()) for a, b in pairs)


def test_single_steps_are_those_of_the_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = course()
    # In plain Python, whose walls are the filter's own.
    monkeypatch.setattr(compiled_trial, "load_step", lambda: compiled_trial.make_step(0))
    for name in ("WallArrays", "ListedWalls"):
        monkeypatch.setattr(compiled, name, lambda *_: setup.walls)
    with np.errstate(invalid="ignore"):
        one, many = run(setup, range(3), is_compiled=True), run(setup, range(3))
    assert largest_difference(one, many) < 1e-9
    # Some beams were used and others refused.
    assert 0 < many.used.mean() < len(setup.angles_rad)


@pytest.mark.long
def test_compiled_steps_are_those_of_the_arrays() -> None:
    pytest.importorskip("numba")
    setup = course("5.9")
    assert largest_difference(run(setup, range(3), is_compiled=True), run(setup, range(3))) < 1e-9


def test_form_is_chosen_for_all_parts_of_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOMAD_COMPILED", "never")
    assert not execution._is_compiled(range(1000))
    monkeypatch.setenv("NOMAD_COMPILED", "crowd")
    monkeypatch.setattr(execution, "find_spec", lambda _: None)
    assert not execution._is_compiled(range(1000))
    monkeypatch.setattr(execution, "find_spec", lambda name: name)
    assert execution._is_compiled(range(1000))
    assert not execution._is_compiled(range(49))
