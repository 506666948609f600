"""Signals that end a command: SystemExit with the code that a shell gives, and the old handlers back afterwards."""

from __future__ import annotations

import signal

import pytest

from nclient.commands.leaving import left_in_order


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_leaves_in_order(number: signal.Signals, code: int) -> None:
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as left, left_in_order():
        signal.raise_signal(number)
    assert left.value.code == code
    assert signal.getsignal(number) == before


def test_a_system_without_hanging_up_has_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(signal, "SIGHUP")
    with pytest.raises(SystemExit, match="143"), left_in_order():
        signal.raise_signal(signal.SIGTERM)
