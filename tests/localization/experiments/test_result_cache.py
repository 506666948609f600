"""Results on disk, by the digest of their inputs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from localization.experiments.execution import ResultCache


@dataclass(frozen=True)
class Numbers:
    x: float
    y: float | None


def cache(folder: Path, code: str) -> ResultCache[int, Numbers]:
    return ResultCache(folder, code, Numbers, lambda item: ("run_1", (item, "a")))


def test_cached_result_needs_same_key_and_code(tmp_path: Path) -> None:
    saved = cache(tmp_path / "new", "code")
    assert saved.get(1) is None
    saved.put(1, Numbers(0.1, None))
    assert cache(tmp_path / "new", "code").get(1) == Numbers(0.1, None)
    assert cache(tmp_path / "new", "other").get(1) is None
    assert saved.get(2) is None
    assert saved.path(1).name.startswith("run_1_")
    assert [file.name for file in (tmp_path / "new").iterdir()] == [saved.path(1).name]
