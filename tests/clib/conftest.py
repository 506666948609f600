"""The C library's tests share one workshop a run, whatever the number of workers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "nclient"))

from building import KINDS, Kind, Workshop, makes_32_bits

NO_32_BITS = "32 BITS ARE NOT TESTED: cc -m32 makes no program on this machine; install gcc-multilib"


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Workshop:
    """Where libraries and programs are made."""
    base = tmp_path_factory.getbasetemp()
    return Workshop((base if worker_id == "master" else base.parent) / "clib")


@pytest.fixture(params=KINDS, ids=lambda kind: kind.name)
def kind(request: pytest.FixtureRequest) -> Kind:
    """Each way to build; 32 bits are left out, aloud, where they cannot be made."""
    wanted: Kind = request.param
    if wanted.bits == 32 and not makes_32_bits():
        pytest.skip(NO_32_BITS)
    return wanted


@pytest.fixture
def can_build(request: pytest.FixtureRequest) -> None:
    """For tests with a `width` of their own: 32 bits only where they can be made."""
    width: Kind = request.getfixturevalue("width")
    if width.bits == 32 and not makes_32_bits():
        pytest.skip(NO_32_BITS)


@pytest.fixture(autouse=True)
def nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """No robot of the tester's own."""
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """For silence that is waited out."""
    monkeypatch.setenv("REPLAY_TIMEOUT_MS", "400")
