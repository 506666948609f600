"""Distribution of jobs: each runs once, and failures are reported. Clusters are in tests/integration."""

from __future__ import annotations

import math
import sys
from importlib import import_module

import pytest

from localization.experiments import execution
from localization.experiments.execution import (
    ClusterError,
    ClusterExtraMissing,
    _check_workers,
    on_cluster,
    run_locally,
)


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_is_worked_on_once(jobs: int) -> None:
    assert sorted(run_locally(math.factorial, range(6), jobs)) == [1, 1, 2, 6, 24, 120]


@pytest.mark.parametrize("jobs", [1, 2])
def test_error_of_a_job_is_raised(jobs: int) -> None:
    with pytest.raises(ValueError, match="negative"):
        list(run_locally(math.factorial, [1, -1], jobs))


@pytest.mark.long
def test_workers_begin_with_all_modules() -> None:
    modules = ["localization.experiments.live_trial", "nserver_emu.server.inprocess", "numpy.random"]
    assert list(run_locally(_is_imported, modules, 2)) == [True] * len(modules)


@pytest.mark.long
def test_workers_can_import_scipy() -> None:
    pytest.importorskip("scipy")
    assert set(run_locally(_imported_name, ["scipy", "scipy.ndimage"], 2)) == {"scipy", "scipy.ndimage"}


def _is_imported(module: str) -> bool:
    return module in sys.modules


def _imported_name(module: str) -> str:
    return import_module(module).__name__


def test_nothing_to_do_is_nothing_done() -> None:
    assert list(run_locally(math.factorial, [], 2)) == []


def test_without_distributed_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterExtraMissing, match=r"\[cluster\]"):
        next(on_cluster(math.factorial, [1], "somewhere:1", str))


def test_cluster_without_workers_or_with_other_code_fails() -> None:
    with pytest.raises(ClusterError, match=r"no workers.*there:1"):
        # Worker "a" has the same code; "b" and "c" are listed in order.
        _check_workers({}, "there:1", "mine")
    with pytest.raises(ClusterError, match=r"different code.* b, c"):
        _check_workers({"a": "mine", "c": "old", "b": "new"}, "there:1", "mine")
    _check_workers({"a": "mine"}, "there:1", "mine")


def test_workers_of_compiled_steps_need_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    # Equal sources, with and without numba: their numbers differ in the last bits.
    monkeypatch.setattr(execution, "code_hash", lambda: "same")
    codes = []
    for spec in (None, "numba"):
        monkeypatch.setattr(execution, "find_spec", lambda _, spec=spec: spec)
        codes.append(execution._compiled_code())
    with pytest.raises(ClusterError, match="numba"):
        _check_workers({"a": codes[0]}, "there:1", codes[1])
