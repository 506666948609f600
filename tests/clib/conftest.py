"""Fixtures of the C library's tests."""

from __future__ import annotations

import pytest

from tests.clib.clib_build import KINDS, BuildCache, BuildKind, can_build_32_bit

NO_32_BITS = "32-bit builds are not tested: cc -m32 does not work on this machine; install gcc-multilib"


@pytest.fixture(scope="session")
def builds(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> BuildCache:
    """Return the build cache, shared by all workers of the test run."""
    # Under pytest-xdist each worker has a subfolder of its own: the parent folder is common to all.
    base = tmp_path_factory.getbasetemp()
    return BuildCache((base if worker_id == "master" else base.parent) / "clib")


@pytest.fixture(params=KINDS, ids=lambda kind: kind.name)
def kind(request: pytest.FixtureRequest) -> BuildKind:
    """Return each build configuration; skip 32-bit builds if the compiler does not support them."""
    wanted: BuildKind = request.param
    if wanted.bits == 32 and not can_build_32_bit():
        pytest.skip(NO_32_BITS)
    return wanted


@pytest.fixture
def skip_unbuildable(request: pytest.FixtureRequest) -> None:
    """Skip tests whose own parameter `width` is a build that the compiler does not support."""
    width: BuildKind = request.getfixturevalue("width")
    if width.bits == 32 and not can_build_32_bit():
        pytest.skip(NO_32_BITS)


@pytest.fixture(autouse=True)
def no_default_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unset NOMAD_ROBOT."""
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)


@pytest.fixture
def short_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the reply time-out for tests that wait for it."""
    monkeypatch.setenv("REPLAY_TIMEOUT_MS", "400")
