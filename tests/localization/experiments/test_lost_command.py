"""The command `lost`: its output and its saved results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from localization.experiments import lost as lost_command
from localization.experiments.__main__ import main
from localization.experiments.lost import Case, Kind, LostResult


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Case]:
    """The cases that were driven."""
    driven: list[Case] = []

    def drive(case: Case) -> LostResult:
        driven.append(case)
        return LostResult(60.0, 0, 0.0, 0.25, 2.0, 1.0, True)

    monkeypatch.setattr(lost_command, "drive", drive)
    return driven


def test_runs_that_are_saved_are_not_made_again(
    made: list[Case], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["lost", "calm", "kidnapped", "--runs", "2", "--minutes", "1", "--jobs", "1", "--out", str(tmp_path)]
    assert main(asked) == 0
    # Two runs of a minute for each kind.
    assert [(case.kind, case.seed, case.seconds) for case in made] == [
        (Kind.TRACKING, 0, 60.0), (Kind.TRACKING, 1, 60.0), (Kind.KIDNAPPED, 0, 60.0), (Kind.KIDNAPPED, 1, 60.0)
    ]
    assert "detected (LOST): 2, 2 of them within 5 s" in capsys.readouterr().out
    # The second time all results come from the cache.
    assert main([*asked, "--json"]) == 0
    assert len(made) == 4
    printed = json.loads(capsys.readouterr().out)
    assert [row["kind"] for row in printed] == ["calm", "kidnapped"]
    assert json.loads((tmp_path / "lost.json").read_text()) == printed


def test_default_number_of_runs_is_that_of_the_kind(made: list[Case], tmp_path: Path) -> None:
    assert main(["lost", "nowhere", "--jobs", "1", "--out", str(tmp_path)]) == 0
    assert len(made) == lost_command.RUNS[Kind.UNKNOWN_START] == 100


def test_a_kind_that_there_is_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["lost", "angry"])
    assert "unknown kind 'angry'; expected one of calm, kidnapped, nowhere, door" in capsys.readouterr().err
