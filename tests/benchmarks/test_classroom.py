"""The benchmark of a class: programs, pages and processor time are measured, and a missed target is an exit code."""

from __future__ import annotations

from typing import Any

import classroom
import pytest


async def test_small_class_is_measured() -> None:
    found = await classroom.measure(1, 1.0, robots=2, pages=2)
    assert 0.0 < found["p50_ms"] <= found["p99_ms"]
    assert found["pictures_hz"] > 1.0
    assert 0.0 < found["daemon_cores"] < 2.0
    assert found["rounds"] == 1


@pytest.mark.parametrize("is_met", [True, False])
def test_missed_target_sets_exit_code(
    is_met: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def measure(*_: object, **__: object) -> dict[str, Any]:
        return {**dict.fromkeys(("p50_ms", "p99_ms", "pictures_hz", "browser_hz", "daemon_cores", "load"), 1.0),
                "is_met": is_met}  # fmt: skip

    monkeypatch.setattr(classroom, "measure", measure)
    assert classroom.main(["--rounds", "1", "--seconds", "1"]) == (0 if is_met else 1)
    assert ("FAILED" in capsys.readouterr().out) is not is_met
