"""Room for as many connections as the limits let in: raised where permitted, logged where insufficient."""

from __future__ import annotations

import resource
import sys

import pytest

from nserver_emu.server.admission import OTHER_DESCRIPTORS, make_room

Pair = tuple[int, int]


class _System:
    """A system with these limits; `obeys`: True if it permits a change."""

    def __init__(self, soft: int, hard: int, obeys: bool = True) -> None:
        self.now, self.obeys, self.asked = (soft, hard), obeys, 0

    def getrlimit(self, _: int) -> Pair:
        return self.now

    def setrlimit(self, _: int, limits: Pair) -> None:
        self.asked += 1
        if not self.obeys:
            raise OSError("a filter of system calls forbids it")
        self.now = limits


@pytest.mark.parametrize(("soft", "hard", "after", "enough"), [
    (100, 4096, 500 + OTHER_DESCRIPTORS, True),
    (100, resource.RLIM_INFINITY, 500 + OTHER_DESCRIPTORS, True), (100, 300, 300, False),
    (1024, 4096, 1024, True), (resource.RLIM_INFINITY, resource.RLIM_INFINITY, resource.RLIM_INFINITY, True),
])  # fmt: skip
def test_room_is_made_as_far_as_may_be(
    soft: int,
    hard: int,
    after: int,
    enough: bool,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    system = _System(soft, hard)
    monkeypatch.setattr(resource, "getrlimit", system.getrlimit)
    monkeypatch.setattr(resource, "setrlimit", system.setrlimit)
    make_room(500)
    assert system.now == (after, hard)
    assert bool(caplog.text) != enough
    assert ("may have 300 files open" in caplog.text) != enough


def test_a_forbidden_raise_is_logged(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    system = _System(100, 4096, obeys=False)
    monkeypatch.setattr(resource, "getrlimit", system.getrlimit)
    monkeypatch.setattr(resource, "setrlimit", system.setrlimit)
    make_room(500)
    assert system.asked == 1
    assert "may have 100 files open" in caplog.text


def test_a_system_without_such_limits_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    make_room(10**9)
