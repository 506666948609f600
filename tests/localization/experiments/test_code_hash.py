"""The digest of code and libraries that a run depends on."""

from __future__ import annotations

import numpy as np
import pytest

from localization.experiments import execution as room
from localization.experiments.execution import code_hash


def test_hash_changes_with_code_or_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_hash()
    assert code_hash() == before
    sources = room._sources()
    changed = {**sources, "localization/filters/ekf.py": sources["localization/filters/ekf.py"] + b"#"}
    monkeypatch.setattr(room, "_sources", lambda: changed)
    other_code = code_hash()
    monkeypatch.setattr(np, "__version__", "0.0")
    assert len({before, other_code, code_hash()}) == 3


def test_hash_covers_code_and_worlds_of_all_packages() -> None:
    sources = room._sources()
    for name in ("nserver_emu/simulation/robot.py", "worlds/thesis_room.toml", "nclient/robot.py"):
        assert name in sources
