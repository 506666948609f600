"""The endurance run: its verdict, and a short run with a server and every kind of client."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import soak
from soak_clients import KINDS, Target
from soak_verdict import POOL, Finding, Sample, check_activity, check_end, check_samples

GOOD = [
    # Samples at 0 to 3 simulated hours: the memory grows to 100 MB in the first one, and then by less than 5 percent.
    Sample(real_s=float(hour), simulated_s=3600.0 * hour, steps=36000 * hour, rss_kib=rss, descriptors=9, threads=2,
           tasks=6, answers=hour, shapes=0, obstacles=0)
    for hour, rss in enumerate((50_000, 100_000, 104_900, 104_000))
]  # fmt: skip


def broken(found: list[Finding]) -> list[str]:
    return [finding.what.split(",")[0] for finding in found if not finding.is_met]


def test_good_run() -> None:
    assert broken(check_samples(GOOD, 3)) == []
    # 104,900 KiB are 4.9 percent more than the 100,000 after the first hour.
    assert check_samples(GOOD, 3)[1].value == pytest.approx(4.9)


@pytest.mark.parametrize(("where", "change", "what"), [
    (2, {"rss_kib": 105_100}, "memory"),
    (2, {"steps": 72001}, "clock less steps"),
    (3, {"simulated_s": 10800.0001}, "clock less steps"),
    (2, {"tasks": 7}, "tasks left over"),
    (3, {"descriptors": 10}, "descriptors left over"),
    # A pool of threads may remain at the end.
    (3, {"threads": 3 + POOL}, "threads at the end"),
])  # fmt: skip
def test_broken_bounds_are_reported(where: int, change: dict[str, Any], what: str) -> None:
    samples = [*GOOD]
    samples[where] = replace(samples[where], **change)
    assert broken(check_samples(samples, 3)) == [what]


def test_incomplete_run() -> None:
    assert broken(check_samples(GOOD, 4)) == ["simulated hours"]


def test_run_without_activity_fails() -> None:
    assert broken(check_activity({"a": 3, "b": 1}, 1, ["a", "b"])) == []
    assert broken(check_activity({"a": 3}, 0, ["a", "b"])) == ["sessions", "injected faults"]


def test_exit_codes() -> None:
    assert broken(check_end(0, 0)) == []
    assert broken(check_end(-9, 1)) == ["exit code", "internal errors"]


def test_wrong_number_is_reported_and_sets_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target = Target(0, 0, "", "", "")
    for is_met in (True, False):
        found = [Finding("tasks left over", 0 if is_met else 2, "0", is_met)]
        monkeypatch.setattr(soak, "run", lambda *_, findings=found: (GOOD, target, findings))
        assert soak.main([]) == (0 if is_met else 1)
        assert capsys.readouterr().out.startswith("ok     tasks" if is_met else "BROKEN tasks left over: 2 (bound: 0)")


def test_short_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is not checked: the first minutes do not show its growth."""
    monkeypatch.setattr(soak, "SETTLE_S", 0.2)
    samples, target, found = soak.run(1 / 60, soak.Load(clients=2, rest_s=0.0, every_s=30.0), seed=2)
    assert samples[0].steps < samples[-1].steps
    assert set(target.sessions) == set(KINDS)
    assert [what for what in broken(found) if what != "memory"] == []
