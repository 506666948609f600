"""Signals that end a command: SystemExit with the code that a shell gives, and the old handlers back afterwards."""

from __future__ import annotations

import os
import pty
import signal
import sys
import threading

import pytest

from nclient.cli import main
from nclient.common.process import TerminatedBySignal, handle_termination_signals


# 128 and the number of the signal.
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_leaves_in_order(number: signal.Signals, code: int) -> None:
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as left, handle_termination_signals():
        signal.raise_signal(number)
    assert left.value.code == code
    assert signal.getsignal(number) == before


def test_a_system_without_hanging_up_has_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(signal, "SIGHUP")
    with pytest.raises(SystemExit, match="143"), handle_termination_signals():
        signal.raise_signal(signal.SIGTERM)


def test_a_second_signal_does_not_disturb_the_leaving() -> None:
    left = []

    @handle_termination_signals()
    def driving() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            # Signals during the clean-up must not interrupt it.
            signal.raise_signal(signal.SIGHUP)
            signal.raise_signal(signal.SIGTERM)
            left.append("in order")

    with pytest.raises(TerminatedBySignal) as first:
        driving()
    assert (first.value.signal_name, left) == ("SIGTERM", ["in order"])


class SignalledWhenDeleted:
    """An object during whose finalizer a signal arrives."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


def test_a_signal_in_a_finalizer_is_not_lost() -> None:
    before = sys.unraisablehook
    left = []

    @handle_termination_signals()
    def driving() -> None:
        try:
            SignalledWhenDeleted()
            # Python ignores exceptions of finalizers.
            left.append("after it")
            threading.Event().wait(20.0)
        finally:
            # From the second one on signals are ignored, as always.
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(TerminatedBySignal):
        driving()
    assert left == ["after it"]
    assert sys.unraisablehook is before


def test_a_block_that_has_ended_is_not_signalled_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "kill", lambda *arguments: sent.append(arguments))
    monkeypatch.setattr("nclient.common.process.RESEND_S", 0.2)
    with handle_termination_signals():
        SignalledWhenDeleted()
        (timer,) = (thread for thread in threading.enumerate() if isinstance(thread, threading.Timer))
    timer.join(20.0)
    assert not timer.is_alive()
    assert not sent


def test_other_errors_in_finalizers_are_reported_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[BaseException | None] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: found.append(unraisable.exc_value))

    class Broken:
        def __del__(self) -> None:
            raise ValueError("broken")

    with handle_termination_signals():
        Broken()
    assert [str(error) for error in found] == ["broken"]


def test_what_nohup_ignores_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        # As under nohup: the handler of SIGHUP must not be replaced.
        with handle_termination_signals():
            signal.raise_signal(signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_on_another_thread_nothing_is_changed() -> None:
    found = []

    def run() -> None:
        before = signal.getsignal(signal.SIGTERM)
        with handle_termination_signals():
            found.append(signal.getsignal(signal.SIGTERM) == before)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [True]


def test_to_a_terminal_that_was_closed_nothing_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setattr("nclient.common.process._OUTPUTS", (theirs,))

    @handle_termination_signals()
    def hung_up() -> None:
        # The terminal is gone: writing to it fails, and would raise in every later message.
        os.close(ours)
        with pytest.raises(OSError, match="Input/output"):
            os.write(theirs, b"lost")
        signal.raise_signal(signal.SIGHUP)

    with pytest.raises(TerminatedBySignal):
        hung_up()
    # After the signal the descriptor leads to /dev/null: all 7 bytes are accepted.
    assert os.write(theirs, b"nowhere") == 7
    os.close(theirs)


def test_a_terminal_that_is_still_there_is_written_to(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setattr("nclient.common.process._OUTPUTS", (theirs,))
    try:
        with pytest.raises(TerminatedBySignal), handle_termination_signals():
            signal.raise_signal(signal.SIGHUP)
        os.write(theirs, b"here")
        assert os.read(ours, 4) == b"here"
    finally:
        os.close(theirs)
        os.close(ours)


def test_every_command_is_left_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "_dispatch", lambda _: signal.raise_signal(signal.SIGHUP))
    assert main.main(["go"]) == 129
