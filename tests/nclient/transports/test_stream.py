"""Deadlines count down on their clock, and never below 0."""

from __future__ import annotations

import pytest

from nclient.transports.stream import Deadline


def test_a_deadline_counts_down_to_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    deadline = Deadline.after(2.5)
    assert deadline.remaining() == 2.5
    now[0] = 102.0
    assert deadline.remaining() == 0.5
    now[0] = 103.0
    assert deadline.remaining() == 0.0


def test_a_deadline_can_use_another_clock() -> None:
    now = [5.0]
    deadline = Deadline.after(1.5, lambda: now[0])
    assert deadline.remaining() == 1.5
    now[0] = 6.0
    assert (deadline.remaining(), Deadline(5.5, lambda: now[0]).remaining()) == (0.5, 0.0)
