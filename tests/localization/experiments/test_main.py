"""The command: its output streams, and its refusals."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from localization.experiments import __main__, live
from localization.experiments import lost as lost_command
from localization.experiments import plan as plan_command
from localization.experiments.figure_trial import FIGURES, Summary

QUICK = ["--seeds", "2", "--jobs", "1"]


@pytest.mark.long
def test_json_is_alone_on_stdout(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert __main__.main(["5.6", *QUICK, "--json", "--no-pictures", "--out", str(tmp_path)]) == 0
    output, errors = capsys.readouterr()
    summary = json.loads(output)
    assert list(summary) == list(Summary.__annotations__)
    assert (summary["figure"], summary["seeds"], summary["steps_thesis"]) == ("5.6", 2, 150)
    assert json.loads((tmp_path / "figure_5.6.json").read_text(encoding="utf-8")) == summary
    assert "%" not in errors, "progress bars are for terminals"
    assert "figure_5.6.json" in errors


def test_people_get_a_table_and_pictures(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert __main__.main(["5.6", *QUICK, "--out", str(tmp_path)]) == 0
    output = capsys.readouterr().out
    assert "Figure 5.6: Badly chosen limits" in output
    assert "150 in the text" in output
    assert {path.name for path in tmp_path.iterdir()} == {"figure_5.6.json", "figure_5.6.png", "figure_5.7.png"}
    assert all(path.name in output for path in tmp_path.iterdir())


@pytest.mark.long
def test_several_figures_give_an_object_a_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert __main__.main(["5.6", "5.6", *QUICK, "--json", "--no-pictures", "--out", str(tmp_path)]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert json.loads(first) == json.loads(second)


def test_all_is_every_figure_and_then_the_live_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    driven: list[str] = []
    monkeypatch.setattr(__main__, "_drive_figure", lambda figure, _: driven.append(figure.name))
    for name, part in (("live", live), ("lost", lost_command), ("plan", plan_command)):
        monkeypatch.setattr(part, "main", lambda words, name=name: driven.append(f"{name} {' '.join(words)}"))
    assert __main__.main(["all", "--seeds", "3", "--no-pictures"]) == 0
    assert driven == [*FIGURES, "live --seeds 3 --no-pictures", "lost --seeds 3", "plan --seeds 3"]


@pytest.mark.parametrize(("words", "expected"), [
    (["5.5"], "figure 5.5 shows the errors of 5.4 and is drawn with it: use 5.4"),
    (["5.1"], "unknown figure '5.1'; expected one of 5.2, 5.4"),
    (["livee"], "did you mean live?"),
    (["live", "--methods", "efk"], "did you mean ekf?"),
    (["5.4", "live"], "live is a command, not a figure"),
    (["5.4", "--seeds", "few"], "argument --seeds: the number is 1 or more, not few"),
    (["all", "--scenario", "exact"], "no option --scenario"),
])  # fmt: skip
def test_unknown_word_is_reported_with_choices(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        __main__.main(words)
    assert expected in capsys.readouterr().err


def test_help_of_all_lists_runs_and_option_placement(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        __main__.main(["all", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "5.2, 5.4, 5.6, 5.8, 5.9 (with the errors in 5.3, 5.5, 5.7), then `live`, `lost` and `plan`" in text
    assert "live --scenario exact" in text


@pytest.mark.long
def test_without_tqdm_there_is_no_bar_and_the_same_numbers(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tqdm", None)
    assert __main__.main(["5.6", *QUICK, "--json", "--no-pictures", "--out", str(tmp_path)]) == 0
    output, errors = capsys.readouterr()
    assert json.loads(output)["seeds"] == 2
    assert "%" not in errors


def test_missing_matplotlib_is_reported_before_any_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert __main__.main(["5.6", "--out", str(tmp_path / "out")]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert "[plot]" in errors
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [["5.6", "--no-pictures"], ["live", "--no-pictures"], ["lost"], ["plan"]])
def test_uncreatable_folder_is_reported_before_any_run(
    words: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("__main__", "execution", "plan"):
        monkeypatch.setattr(f"localization.experiments.{module}.progress", lambda *_: pytest.fail("it runs"))
    (tmp_path / "file").write_text("a file", encoding="utf-8")
    assert __main__.main([*words, "--out", str(tmp_path / "file")]) == 1
    assert f"{tmp_path / 'file'}: cannot be written: File exists; name a file" in capsys.readouterr().err


def test_interrupt_ends_without_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(__main__, "drive", interrupted)
    assert __main__.main(["5.6", "--no-pictures", "--out", str(tmp_path)]) == 130


@pytest.mark.parametrize("arguments", [["5.5"], [], ["5.4", "--seeds", "0"], ["5.4", "--jobs", "none"]])
def test_invalid_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        __main__.main(arguments)
    assert caught.value.code == 2
    assert capsys.readouterr().err.splitlines()[1:] == ["python -m localization.experiments --help lists all options"]


def test_the_number_of_cores_is_known_without_affinity(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("os.sched_getaffinity", raising=False)
    monkeypatch.setattr("os.cpu_count", lambda: None)
    assert __main__._parser().parse_args(["5.4"]).jobs == 1


@pytest.mark.long
def test_help_names_every_figure() -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "localization.experiments", "--help"], capture_output=True, text=True, check=True
    )
    assert all(name in answer.stdout for name in ("5.2", "5.4", "5.6", "5.8", "5.9", "--seeds", "--no-pictures"))
