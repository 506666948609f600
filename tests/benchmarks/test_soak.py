"""The endurance run: its verdict, and a short run with a server and every kind of client."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import soak
from soak_clients import KINDS, Endpoints
from soak_verdict import POOL, Finding, Sample, check_activity, check_exit, verdict

GOOD = [
    Sample(real_s=float(hour), simulated_s=3600.0 * hour, steps=36000 * hour, rss_kib=rss, descriptors=9, threads=2,
           tasks=6, answers=hour, shapes=0, obstacles=0)
    for hour, rss in enumerate((50_000, 100_000, 104_900, 104_000))
]  # fmt: skip


def broken(found: list[Finding]) -> list[str]:
    return [finding.what.split(",")[0] for finding in found if not finding.passed]


def test_good_run() -> None:
    assert broken(verdict(GOOD, 3)) == []
    assert verdict(GOOD, 3)[1].value == pytest.approx(4.9)


@pytest.mark.parametrize(("where", "change", "what"), [
    (2, {"rss_kib": 105_100}, "memory"),
    (2, {"steps": 72001}, "clock less steps"),
    (3, {"simulated_s": 10800.0001}, "clock less steps"),
    (2, {"tasks": 7}, "tasks left over"),
    (3, {"descriptors": 10}, "descriptors left over"),
    (3, {"threads": 3 + POOL}, "threads at the end"),
])  # fmt: skip
def test_broken_bounds_are_reported(where: int, change: dict[str, Any], what: str) -> None:
    samples = [*GOOD]
    samples[where] = replace(samples[where], **change)
    assert broken(verdict(samples, 3)) == [what]


def test_incomplete_run() -> None:
    assert broken(verdict(GOOD, 4)) == ["simulated hours"]


def test_run_without_activity_fails() -> None:
    assert broken(check_activity({"a": 3, "b": 1}, 1, ["a", "b"])) == []
    assert broken(check_activity({"a": 3}, 0, ["a", "b"])) == ["sessions", "faults"]


def test_exit_codes() -> None:
    assert broken(check_exit(0, 0)) == []
    assert broken(check_exit(-9, 1)) == ["exit code", "internal errors"]


def test_wrong_number_is_reported_and_sets_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoints = Endpoints(0, 0, "", "", "")
    for is_kept in (True, False):
        found = [Finding("tasks left over", 0 if is_kept else 2, "0", is_kept)]
        monkeypatch.setattr(soak, "run", lambda *_, findings=found: (GOOD, endpoints, findings))
        assert soak.main([]) == (0 if is_kept else 1)
        assert capsys.readouterr().out.startswith("passed tasks" if is_kept else "FAILED tasks left over: 2 (limit: 0)")


def test_short_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is not checked: the first minutes do not show its growth."""
    monkeypatch.setattr(soak, "SETTLE_S", 0.2)
    samples, endpoints, found = soak.run(1 / 60, soak.LoadPlan(clients=2, rest_s=0.0, every_s=30.0), seed=2)
    assert samples[0].steps < samples[-1].steps
    assert set(endpoints.sessions) == set(KINDS)
    assert [what for what in broken(found) if what != "memory"] == []
