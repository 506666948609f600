"""The experiment of random paths: pairs, one drive in each world, results saved, the table."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from math import hypot
from pathlib import Path

import pytest

from localization.experiments import execution
from localization.experiments import plan as plan_command
from localization.experiments.__main__ import main
from localization.experiments.execution import run_cached
from localization.experiments.plan import (
    APART_IN,
    SPACE_IN,
    WORLDS,
    DrivePair,
    DriveResult,
    drive,
    drive_cache,
    ends_of,
)
from worlds.io import load_world
from worlds.robots import N150

DRIVEN = DriveResult("thesis_room", 0, "done", "", False, 2.0, 0.4, 50.0, 50.5, 51.0, 1, 12.0)


OTHERS = [world for world in WORLDS if world != "thesis_room"]


@pytest.mark.long
@pytest.mark.parametrize("world", WORLDS)
def test_pairs_have_room_are_apart_and_differ(world: str) -> None:
    drawn = [ends_of(DrivePair(world, number, "noisy")) for number in range(100)]
    place = load_world(world)
    for ends in drawn:
        assert min(place.clearance(*ends.start), place.clearance(*ends.goal)) >= N150.radius_in + SPACE_IN - 1e-9
        assert hypot(ends.start[0] - ends.goal[0], ends.start[1] - ends.goal[1]) >= APART_IN
        assert -12 < ends.start[0] < 102.17
    assert len(set(drawn)) == 100
    assert ends_of(DrivePair(world, 3, "exact")) == drawn[3]


@pytest.mark.parametrize("world", ["thesis_room", *(pytest.param(world, marks=pytest.mark.long) for world in OTHERS)])
def test_drive_arrives_without_contact_on_short_path(world: str) -> None:
    pair, driven = drive(DrivePair(world, 7, "noisy"))
    assert (pair, driven.ending, driven.contact) == (DrivePair(world, 7, "noisy"), "done", False)
    assert driven.off_in < 1.5
    assert driven.least_in > 0.3
    assert 1.0 - 1.0 / driven.shortest_in <= driven.driven_in / driven.shortest_in <= plan_command.NEAR
    assert driven.planned_in / driven.shortest_in <= plan_command.NEAR
    assert driven.plans >= 1


def test_saved_drives_are_not_repeated(tmp_path: Path) -> None:
    pairs = [DrivePair("thesis_room", number, "noisy") for number in range(3)]
    worked: list[DrivePair] = []

    def work(left: Sequence[DrivePair]) -> Iterator[tuple[DrivePair, DriveResult]]:
        worked.extend(left)
        yield from ((pair, replace(DRIVEN, number=pair.number)) for pair in left)

    output: list[int] = []
    # Two pairs, then three: only the third is driven.
    first = run_cached(pairs[:2], drive_cache(tmp_path, "code"), work, output.append)
    again = run_cached(pairs, drive_cache(tmp_path, "code"), work, output.append)
    assert worked == pairs
    # Progress counts cached drives at once.
    assert output == [0, 1, 2, 2, 3]
    assert {pair: again[pair] for pair in pairs[:2]} == first
    # Results of other code are not used.
    run_cached(pairs[:1], drive_cache(tmp_path, "other"), work, output.append)
    assert worked[-1] == pairs[0]
    # Files are written completely or not at all.
    assert not list(tmp_path.glob("*.part"))


def test_row_and_failures_of_a_world() -> None:
    touched = replace(DRIVEN, number=1, ending="blocked", reason="no way", least_in=-0.1, driven_in=60.0)
    row = plan_command.row("thesis_room", [DRIVEN, touched])
    assert (row["pairs"], row["reached"], row["contacts"], row["driven_near"]) == (2, 1, 1, 1)
    assert (row["driven_worst"], row["planned_worst"]) == pytest.approx((1.2, 1.01))
    lines = plan_command.table([row], [DRIVEN, touched]).splitlines()
    assert lines[1].split()[:4] == ["thesis_room", "2", "1", "1"]
    assert lines[2:] == ["thesis_room 1: blocked, CONTACT: no way"]
    assert replace(DRIVEN, touched=True).contact


def test_the_command_prints_a_table_or_json_and_writes_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        plan_command, "drive", lambda pair: (pair, replace(DRIVEN, world=pair.world, number=pair.number))
    )
    words = ["plan", "--pairs", "2", "--worlds", "thesis_room", "--jobs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:3] == ["thesis_room", "2", "2"]
    written = json.loads((tmp_path / "plan_noisy.json").read_text())
    assert written["drives"][1] == asdict(replace(DRIVEN, number=1))
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["reached"] == 2
    asked: list[str] = []

    def on_cluster(
        _: object, items: Sequence[DrivePair], address: str, **__: object
    ) -> Iterator[tuple[DrivePair, DriveResult]]:
        asked.append(address)
        yield from ((pair, DRIVEN) for pair in items)

    monkeypatch.setattr(execution, "on_cluster", on_cluster)
    out = str(tmp_path / "cluster")
    # With --cluster the jobs go to its address.
    assert main(["plan", "--pairs", "1", "--worlds", "thesis_room", "--cluster", "there:8786", "--out", out]) == 0
    assert asked == ["there:8786"]
