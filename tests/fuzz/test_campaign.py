"""One reader's run without atheris: what is counted, what is a finding, when it is over. And the command's words."""

from __future__ import annotations

import faulthandler
import itertools
import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from fuzz import __main__, campaign, place
from fuzz.campaign import Campaign, Progress
from fuzz.reader import Reader
from nclient.errors import WireError


class Ended(BaseException):
    """In place of the end of the process."""


@pytest.fixture(autouse=True)
def _no_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def end(code: int) -> None:
        raise Ended(code)

    monkeypatch.setattr(os, "_exit", end)
    monkeypatch.setattr(campaign, "FOUND", tmp_path / "fuzz" / "found")
    campaign.FOUND.parent.mkdir()


def read(data: bytes) -> None:
    if data == b"no":
        raise WireError("no")
    if data.startswith(b"bad"):
        raise KeyError("bad")
    if data == b"slow":
        until_s = time.process_time() + 0.02
        while time.process_time() < until_s:
            pass


READER = Reader("toy", "a toy", read, (WireError,), lambda: [b"yes"], lambda data, _: data + b"!")


def run(tmp_path: Path, *inputs: bytes, runs: int | None = 1000, seconds: float | None = None) -> Progress:
    toy = Campaign(READER, tmp_path, runs, seconds)

    def until_it_ends() -> None:
        for data in itertools.cycle(inputs):
            toy._one(data)

    with pytest.raises(Ended):
        until_it_ends()
    return Progress.read(tmp_path, "toy")


def test_runs_are_counted_and_go_on_where_they_were(tmp_path: Path) -> None:
    first = run(tmp_path, b"yes", b"no")
    assert (first.executions, first.taken, first.found) == (1000, 500, [])
    assert first.rss_kb[0] > 0
    assert list(first.blocks) == [0, 0]
    assert run(tmp_path, b"yes", runs=1500).executions == 1500


def test_a_finding_is_kept_shortest_and_ends_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = run(tmp_path, b"bad, long", b"bad", b"bad, longer", b"yes")
    assert told.executions == 1000
    assert [Path(path).read_bytes() for path in told.found] == [b"bad"]
    assert "KeyError" in capsys.readouterr().err


def test_an_input_that_takes_long_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(campaign, "SLOW_S", 0.01)
    told = run(tmp_path, b"slow", runs=3)
    assert [Path(path).read_bytes() for path in told.found] == [b"slow"]
    assert "for one input" in capsys.readouterr().err


def test_told_to_end_it_ends(tmp_path: Path) -> None:
    toy = Campaign(READER, tmp_path, None, 3600.0)
    toy._one(b"yes")
    toy._end(15, None)
    with pytest.raises(Ended):
        toy._one(b"yes")


def test_half_of_the_changes_are_ours(tmp_path: Path) -> None:
    mutated = Campaign(READER, tmp_path, 1, None)._mutator(SimpleNamespace(Mutate=lambda _data, _longest: b"theirs"))
    changed = [mutated(b"ours", 5, seed) for seed in range(200)]
    assert set(changed) == {b"ours!", b"theirs"}
    assert 60 < changed.count(b"theirs") < 140


def test_growth_and_crashes_are_told(tmp_path: Path) -> None:
    (tmp_path / "toy.log").write_text("libFuzzer: timeout")
    campaign.FOUND.mkdir()
    (campaign.FOUND / "toy-1").write_bytes(b"bad\0")
    grown = Progress("toy", 10, 1.0, rss_kb=(0, 200_000), blocks=(0, 30_000), found=[str(campaign.FOUND / "toy-1")])
    told = "\n".join(__main__._wrong(grown, 70 << 8, tmp_path))
    for words in ("--again fuzz/found/toy-1", r"which is b'bad\x00'", "ended with 70", "libFuzzer: timeout",
                  "200000 KB", "30000 objects"):  # fmt: skip
        assert words in told
    (campaign.FOUND / "toy-1").unlink()
    assert "which is" not in "\n".join(__main__._wrong(grown, 0, tmp_path))
    assert not list(__main__._wrong(Progress("toy"), 0, tmp_path))
    assert "10" in __main__._row(grown)


def test_files_of_inputs_are_gone_with_their_folder() -> None:
    place.folder.cache_clear()
    made = place.file_of(b"x", ".toml")
    assert made.read_bytes() == b"x"
    __main__._files_gone()
    assert not made.parent.exists()
    place.folder.cache_clear()


def test_the_command_lists_and_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert __main__.main(["--list"]) == 0
    assert "worlds            world files" in capsys.readouterr().out
    for wrong in (["--runs", "0"], ["--seconds", "nan"], ["--list", "wordls"]):
        with pytest.raises(SystemExit, match="2"):
            __main__.main(wrong)
    assert "no reader 'wordls'; there are tcp_requests" in capsys.readouterr().err


def test_an_input_is_read_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, data, said in (("hello-1", bytes(11), "taken"), ("hello-2", b"", "refused as documented: WireError")):
        (tmp_path / name).write_bytes(data)
        assert __main__.main(["--again", str(tmp_path / name)]) == 0
        assert capsys.readouterr().out.strip() == said
    (tmp_path / "other").write_bytes(b"")
    assert __main__.main(["--again", str(tmp_path / "other")]) == 2


def test_objects_are_counted_where_nothing_is_instrumented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blind = Campaign(READER, tmp_path, 600, None)
    monkeypatch.setattr(blind, "_settle", lambda: None)
    with pytest.raises(Ended):
        blind.run_blind()
    faulthandler.cancel_dump_traceback_later()
    told = Progress.read(tmp_path, "toy")
    assert told.executions == 600
    assert 0 < told.blocks[0] < told.blocks[1] + 10_000


def test_a_long_run_has_spells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "SPELL", 300)
    assert [run(tmp_path, b"yes").executions for _ in range(4)] == [300, 600, 900, 1000]


def test_a_run_by_time_has_spells_too_and_no_more_time_than_it_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign, "SPELL", 300)
    told = run(tmp_path, b"yes", runs=None, seconds=3600.0)
    assert told.executions == 300
    goals = __main__.Goals(tmp_path, None, 60.0, False)
    assert goals.after(20.0).seconds == 40.0
    assert goals.after(20.0).more(told)
    assert not goals.after(60.0).more(told)


def test_a_run_by_inputs_goes_on_until_it_has_them_whatever_the_time(tmp_path: Path) -> None:
    goals = __main__.Goals(tmp_path, 1000, None, False)
    assert goals.after(1e6) == goals
    assert goals.more(Progress("toy", 999))
    assert not goals.more(Progress("toy", 1000))
