"""The matrix: its trials, and the summaries of their results."""

from __future__ import annotations

from dataclasses import replace

from localization.experiments.live_trial import SCENARIOS, Cell, Trial, TrialJob, result_of, run, summaries, trials


def test_every_combination_has_its_seeds() -> None:
    # 2 scenarios x 2 figures x 2 methods x 3 seeds.
    every = trials(["exact", "measured"], ["5.4", "5.9"], ["ekf", "ukf"], 3, 7)
    assert len(set(every)) == len(every) == 24
    assert {trial.cell for trial in every} == {
        Cell(scenario, figure, method)
        for scenario in ("exact", "measured")
        for figure in ("5.4", "5.9")
        for method in ("ekf", "ukf")
    }
    assert {trial.periods for trial in every} == {7}
    assert every[0] == Trial(replace(SCENARIOS["exact"], method="ekf"), "5.4", 0, 7)


def test_job_returns_record_only_if_requested() -> None:
    (trial,) = trials(["exact"], ["5.4"], ["ukf"], 1, 12)
    # The same trial with and without its record.
    done, again = run(TrialJob(trial, whole=True)), run(TrialJob(trial))
    assert done.trial == trial
    assert done.record is not None
    assert again.record is None
    # Results are equal to the last bit, except for the time spent.
    assert done.result.same_numbers(again.result)
    assert result_of(done.record) == done.result
    assert not done.result.same_numbers(replace(again.result, nees=again.result.nees + 1e-12))
    assert done.result.spent_us > 0.0


def test_summary_is_independent_of_trial_order() -> None:
    every = trials(["exact"], ["5.4"], ["ekf"], 3, 12)
    results = {trial: run(TrialJob(trial)).result for trial in every}
    turned = dict(reversed(results.items()))
    assert summaries(turned) == summaries(results)
    assert list(summaries(results)) == [Cell("exact", "5.4", "ekf")]
    assert Cell("exact", "5.4", "ekf").world == "thesis_room"
