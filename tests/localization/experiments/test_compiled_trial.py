"""Steps of a figure robot by robot, as numba compiles them, against the steps in arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from localization.experiments import execution, figure_trial
from localization.experiments.figure_trial import FIGURES, FigureSetup, Runs, figure_setup, run, run_compiled
from localization.filters import compiled

QUANTITIES = ("truth", "mean", "cov", "bound", "nis", "used")


def course(name: str = "5.8") -> FigureSetup:
    """Some steps among several walls, where beams are refused."""
    goals = np.array([[2.0, 1.0], [3.0, 3.0]])
    return replace(figure_setup(FIGURES[name]), goals_in=goals, gains=FIGURES["5.6"].gains)


def largest_difference(one: Runs, other: Runs) -> float:
    """Return the largest difference of what both have of each robot up to its last step."""
    assert one.steps.tolist() == other.steps.tolist()
    assert one.reached.tolist() == other.reached.tolist()
    found = [0.0]
    for name in QUANTITIES:
        for row, steps in enumerate(one.steps.tolist()):
            a, b = getattr(one, name)[:steps, row], getattr(other, name)[:steps, row]
            found.append(float(np.abs(np.subtract(a, b, dtype=float)).max()))
    return max(found)


def test_single_steps_are_those_of_the_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = course()
    # In plain Python, whose walls are the filter's own.
    monkeypatch.setattr(figure_trial, "load_drive", lambda: figure_trial.make_drive(0))
    for name in ("PackedWalls", "ListedWalls"):
        monkeypatch.setattr(compiled, name, lambda *_: setup.walls)
    with np.errstate(invalid="ignore"):
        one, many = run_compiled(setup, range(3)), run(setup, range(3))
    assert largest_difference(one, many) < 1e-9
    # Some beams were used and others refused.
    assert 0 < many.used.mean() < len(setup.angles_rad)


@pytest.mark.long
def test_compiled_steps_are_those_of_the_arrays() -> None:
    pytest.importorskip("numba")
    setup = course("5.9")
    assert largest_difference(run_compiled(setup, range(3)), run(setup, range(3))) < 1e-9


def test_form_is_chosen_for_all_parts_of_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOMAD_COMPILED", "never")
    figure = FIGURES["5.4"]
    assert not execution._is_compiled(figure, range(1000))
    monkeypatch.setenv("NOMAD_COMPILED", "crowd")
    monkeypatch.setattr(execution, "find_spec", lambda _: None)
    assert not execution._is_compiled(figure, range(1000))
    monkeypatch.setattr(execution, "find_spec", lambda name: name)
    assert execution._is_compiled(figure, range(1000))
    assert not execution._is_compiled(figure, range(49))
    # Odometry alone has no filter to compile.
    assert not execution._is_compiled(FIGURES["5.2"], range(1000))


def test_threads_change_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def pretend(_: FigureSetup, seeds: Sequence[int]) -> Runs:
        count = len(seeds)
        poses, covariances = np.zeros((2, count, 3)), np.tile(np.eye(3), (2, count, 1, 1))
        steps, numbers = np.full(count, 2), np.tile(np.array(seeds, dtype=float), (2, 1))
        return Runs(tuple(seeds), steps, steps > 0, poses, poses, covariances, covariances, numbers, numbers)

    monkeypatch.setenv("NOMAD_COMPILED", "crowd")
    monkeypatch.setattr(execution, "run_compiled", pretend)
    monkeypatch.setattr(execution, "find_spec", lambda name: name)
    reports: list[int] = []
    alone, shared = (execution.drive(FIGURES["5.4"], range(55), jobs, reports.append) for jobs in (1, 3))
    assert alone.results == shared.results
    assert [result.nis for result in shared.results] == [2.0 * seed for seed in range(55)]
    assert reports[-1] == 110


def test_error_in_a_thread_ends_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: FigureSetup, seeds: Sequence[int]) -> Runs:
        raise ValueError(f"seed {seeds[0]}")

    monkeypatch.setenv("NOMAD_COMPILED", "crowd")
    monkeypatch.setattr(execution, "run_compiled", fail)
    monkeypatch.setattr(execution, "find_spec", lambda name: name)
    with pytest.raises(ValueError, match="seed"):
        execution.drive(FIGURES["5.4"], range(55), 2)
