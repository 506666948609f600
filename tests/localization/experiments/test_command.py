"""The command `live`: its output, its files, cached trials, and results independent of the executor."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from localization.experiments import __main__ as experiments
from localization.experiments import live_trial
from localization.experiments.live import collect, trial_cache
from localization.experiments.live_trial import FinishedTrial, TrialJob, trials

SHORT = ["--scenario", "exact", "--figures", "5.4", "--methods", "ekf", "ukf", "--seeds", "2", "--periods", "8"]
WANTED = trials(["exact"], ["5.4"], ["ekf"], 3, 8)


class Executor:
    """Works here, and remembers how much."""

    def __init__(self) -> None:
        self.jobs: list[TrialJob] = []

    def __call__(self, jobs: Sequence[TrialJob]) -> Iterator[FinishedTrial]:
        for job in jobs:
            self.jobs.append(job)
            yield live_trial.run(job)


def test_people_get_a_table_and_files(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert experiments.main(["live", *SHORT, "--jobs", "1", "--out", str(tmp_path)]) == 0
    printed, output = capsys.readouterr()
    assert [line.split()[2] for line in printed.splitlines()[1:3]] == ["ekf", "ukf"]
    assert "live: 100%" in output
    assert {path.name for path in tmp_path.iterdir()} == {"live.csv", "live.json", "live.png", "trials"}
    assert len(list((tmp_path / "trials").iterdir())) == 4
    assert "live.png" in printed


@pytest.mark.long
def test_json_is_alone_on_stdout(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert experiments.main(["live", *SHORT, "--jobs", "1", "--json", "--no-pictures", "--out", str(tmp_path)]) == 0
    printed, output = capsys.readouterr()
    assert [row["method"] for row in json.loads(printed)] == ["ekf", "ukf"]
    assert "live.csv" in output
    assert not (tmp_path / "live.png").exists()


@pytest.mark.long
def test_two_processes_make_the_same_numbers(tmp_path: Path) -> None:
    rows = []
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        assert experiments.main(["live", *SHORT, "--jobs", jobs, "--no-pictures", "--out", str(out)]) == 0
        rows.append(json.loads((out / "live.json").read_text(encoding="utf-8")))
    assert [{**row, "step_us": 0} for row in rows[0]] == [{**row, "step_us": 0} for row in rows[1]]


@pytest.mark.long
def test_cached_trials_are_not_repeated(tmp_path: Path) -> None:
    store, crew, tallies = trial_cache(tmp_path, "code"), Executor(), list[int]()
    collect(WANTED[:2], store, None, crew, tallies.append)
    whole = collect(WANTED, store, None, crew, tallies.append)
    assert [job.trial.seed for job in crew.jobs] == [0, 1, 2]
    assert tallies == [0, 1, 2, 2, 3]
    assert list(whole) == WANTED
    assert collect(WANTED, store, None, crew, tallies.append) == whole
    assert len(crew.jobs) == 3


@pytest.mark.long
def test_interrupted_run_keeps_finished_trials(tmp_path: Path) -> None:
    def interrupted(jobs: Sequence[TrialJob]) -> Iterator[FinishedTrial]:
        yield live_trial.run(jobs[0])
        raise KeyboardInterrupt

    store = trial_cache(tmp_path, "code")
    with pytest.raises(KeyboardInterrupt):
        collect(WANTED, store, None, interrupted, lambda _: None)
    assert [store.get(trial) is not None for trial in WANTED] == [True, False, False]


def test_paths_that_are_missing_or_older_are_driven_for(tmp_path: Path) -> None:
    store, crew = trial_cache(tmp_path / "trials", "code"), Executor()
    # Without a folder for paths only results are saved.
    collect(WANTED[:1], store, None, crew, lambda _: None)
    # Paths are wanted: the same trial is driven again, as a whole.
    collect(WANTED[:1], store, tmp_path / "tum", crew, lambda _: None)
    assert [job.whole for job in crew.jobs] == [False, True]
    # Truth, estimate and encoders of the trial.
    assert len(list((tmp_path / "tum").iterdir())) == 3
    # Now both exist.
    collect(WANTED[:1], store, tmp_path / "tum", crew, lambda _: None)
    assert len(crew.jobs) == 2
    # A result that is newer than its path: driven again.
    store.put(WANTED[0], live_trial.run(TrialJob(WANTED[0])).result)
    collect(WANTED[:1], store, tmp_path / "tum", crew, lambda _: None)
    assert len(crew.jobs) == 3


@pytest.mark.parametrize("arguments", [["--scenario", "quiet"], ["--methods", "kalman"], ["--figures", "5.2"],
                                       ["--periods", "0"], ["--jobs", "3", "--cluster", "here:1"]])
def test_invalid_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        experiments.main(["live", *arguments])
    assert caught.value.code == 2
    assert capsys.readouterr().err.endswith("python -m localization.experiments live --help lists all options\n")


def test_a_cluster_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    address = "nowhere://127.0.0.1:1"
    assert experiments.main(["live", *SHORT, "--no-pictures", "--out", str(tmp_path), "--cluster", address]) == 1
    assert f"no Dask scheduler answers at {address}" in capsys.readouterr().err
