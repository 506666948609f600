"""Workers of experiments are forked from a process of their own, not from that of `tests.programs.forked`."""

from __future__ import annotations

from collections.abc import Iterator
from multiprocessing import forkserver

import pytest


@pytest.fixture(autouse=True)
def own_fork_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # multiprocessing has one for all contexts, which imports once what it was given first.
    server = forkserver.ForkServer()
    for name in ("ensure_running", "connect_to_new_process", "set_forkserver_preload"):
        monkeypatch.setattr(forkserver, name, getattr(server, name))
    yield
    server._stop()  # type: ignore[attr-defined]
