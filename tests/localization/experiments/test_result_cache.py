"""Results on disk, by the digest of their inputs."""

from __future__ import annotations

from pathlib import Path

from localization.experiments.execution import ResultCache


def test_cached_result_needs_same_key_and_code(tmp_path: Path) -> None:
    saved = ResultCache(tmp_path / "new", "code")
    path = saved.path("run_1", (1, "a"))
    assert saved.get(path) is None
    saved.put(path, {"x": 0.1, "y": None})
    assert ResultCache(tmp_path / "new", "code").get(saved.path("run_1", (1, "a"))) == {"x": 0.1, "y": None}
    assert path.name.startswith("run_1_")
    assert (
        len({path, saved.path("run_1", (2, "a")), ResultCache(tmp_path / "new", "other").path("run_1", (1, "a"))}) == 3
    )
    assert [file.name for file in (tmp_path / "new").iterdir()] == [path.name]
