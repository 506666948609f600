"""The isolation benchmark: every kind runs, attempts are counted, and a missed target is an exit code."""

from __future__ import annotations

import math
from typing import Any

import isolation
import pytest


@pytest.mark.parametrize("kind", list(isolation.ARGUMENTS))
def test_every_kind_is_measured(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolation, "OBSTACLES", 20)
    found = isolation.measure(kind, rounds=1, seconds=0.25)
    assert found["hostile"] == kind
    # Attempts are counted over the time in which they are made, which begins before the measurement.
    # Churn is paced; other kinds make as many attempts as they can.
    assert 0.0 < found["attempts_per_s"] <= (1.1 * isolation.CHURN_HZ if kind == "churn" else math.inf)
    assert found["turn_ms"] > 0.0
    assert found["p99_ms"] > 0.0
    assert found["served_ms"] > 0.0
    is_met = (
        found["turn_ms"] <= isolation.TURN_BOUND_MS
        and found["p99_ms"] <= found["p99_bound_ms"]
        and found["served_ms"] <= isolation.SERVED_BOUND_MS
    )
    assert found["is_met"] is is_met


@pytest.mark.parametrize("is_met", [True, False])
def test_missed_target_sets_exit_code(
    is_met: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found: dict[str, Any] = dict.fromkeys(
        ("attempts_per_s", "turn_ms", "longest_turn_ms", "alone_p99_ms", "p99_ms", "p95_ms", "p99_bound_ms",
         "served_ms"), 1.0)  # fmt: skip
    monkeypatch.setattr(isolation, "measure", lambda *_: {**found, "is_met": is_met})
    assert isolation.main(["--hostile", "churn"]) == (0 if is_met else 1)
    assert ("FAILED" in capsys.readouterr().out) is not is_met


def test_blocks_do_not_overlap() -> None:
    for place in (isolation.block, isolation.near_block):
        assert len({place(number)[1:3] for number in range(isolation.OBSTACLES)}) == isolation.OBSTACLES
