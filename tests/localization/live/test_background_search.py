"""Search in a process of its own: same answers, stored tables, progress, catching up, and its end."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Sequence
from contextlib import closing
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from localization.experiments.live_trial import QUIET
from localization.filters import compiled
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, Floats, independent
from localization.filters.global_localization import MAX_BEHIND, GlobalLocalizer
from localization.filters.health import HealthStatus
from localization.filters.pose_search import (
    EchoRecord,
    EchoReplay,
    PendingSearch,
    SearchRequest,
    SearchResult,
    TableSearch,
)
from localization.filters.range_table import DIRECTIONS, build_range_table
from localization.filters.registry import DEFAULT_METHOD, FINDER, finder, table_search, update_for
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import RaySonar, ranges_from, wall_map
from localization.live import background_search
from localization.live.background_search import (
    MAX_CACHED,
    BackgroundSearch,
    cache_folder,
    cached_search,
    filter_on_robot,
    load_or_build,
)
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule
from nclient import connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER
from worlds.geometry import polygon_segments
from worlds.io import load_world
from worlds.robots import N150

CONFIG = LocalizationConfig(load_world("several_walls").walls, N150, QUIET, ConeSonar())
START = (30.0, 60.0, 0.3)


def turn_from_unknown_start(filter_: GlobalLocalizer, seconds: float = 6.0) -> tuple[list[Estimate], float]:
    """Turn on the spot from an unknown pose; return all estimates and the error of the last in inches."""
    heading = math.degrees(START[2])
    address = f"sim:several_walls?setup=measured&seed=3&start={START[0]},{START[1]},{heading},{heading}&step_s=0.05"
    with connect(address) as robot:
        state = robot.configure_sonars(rate=15, order=DEFAULT_SONAR_ORDER)
        assert state.clock_s is not None
        localizer = Localizer(CONFIG, filter_.belief, FiringSchedule(state.clock_s), filter_)
        estimates = []
        # States every 0.1 s: the robot turns on the spot, so that all sonars see all walls.
        for _ in range(round(seconds / 0.1)):
            robot.drive(translation_in_s=0.0, steering_rad_s=0.2)
            estimates.append(localizer.update(robot.refresh()))
        truth = robot.truth()
        return estimates, math.hypot(estimates[-1].pose[0] - truth.x_in, estimates[-1].pose[1] - truth.y_in)


@pytest.mark.long
def test_answers_are_those_of_a_search_in_this_process(tmp_path: Path) -> None:
    alone, _ = turn_from_unknown_start(finder(CONFIG, None))
    reports: list[str] = []
    with closing(BackgroundSearch(CONFIG, waits=True, report=reports.append, folder=tmp_path)) as poses:
        beside, off_in = turn_from_unknown_start(finder(CONFIG, None, poses=poses))
        assert poses.progress == ""
    assert off_in < 2.0
    # To the bit: the process of its own must change nothing.
    np.testing.assert_array_equal(alone[-1].pose, beside[-1].pose)
    assert len(list(tmp_path.glob("*.npz"))) == 1
    assert set(reports) <= {"searching"} | {f"preparing the map, {percent}%" for percent in range(101)}


class Late(TableSearch):
    """Search of the map whose answers are late by a number of questions."""

    def __init__(self, search: TableSearch, questions: int) -> None:
        super().__init__(lambda: search.table, update_for(CONFIG.walls, N150, CONFIG.sonar), QUIET)
        self.questions = questions

    def start(self, request: SearchRequest) -> PendingSearch:
        answer, left = super().start(request), [self.questions if request.searches else 0]

        # The search itself is done at once; only its answer is withheld.
        def pending() -> SearchResult | None:
            left[0] -= 1
            return answer() if left[0] < 0 else None

        return pending


@pytest.mark.long
@pytest.mark.parametrize("questions", [1, 40])
def test_a_late_answer_is_brought_up_to_date(questions: int) -> None:
    """The robot turns on while a search runs: forty echoes are two and a half rings, 0.5 rad."""
    estimates, off_in = turn_from_unknown_start(finder(CONFIG, None, poses=Late(table_search(CONFIG), questions)))
    assert estimates[-1].health.status is HealthStatus.OK
    assert off_in < 2.0


class Counting(EchoReplay):
    """Replay that counts its updates."""

    def __init__(self) -> None:
        super().__init__(update_for(CONFIG.walls, N150, CONFIG.sonar), QUIET)
        self.updates: list[int] = []

    def run(self, belief: Belief, before: Floats, records: Sequence[EchoRecord]) -> tuple[Belief, float]:
        self.updates.append(len(records))
        return super().run(belief, before, records)


@pytest.mark.long
def test_work_of_an_update_is_bounded_after_a_late_answer() -> None:
    """Eighty echoes since the search began: the search filters its hypotheses along them, not the robot's filter."""
    late = finder(CONFIG, None, poses=Late(table_search(CONFIG), 80))
    late._replay = replay = Counting()
    estimates, off_in = turn_from_unknown_start(late, 9.0)
    assert off_in < 2.0
    assert estimates[-1].health.status is HealthStatus.OK
    # One hypothesis, filtered once.
    assert len(replay.updates) == 1
    assert replay.updates[0] <= MAX_BEHIND


@pytest.mark.long
def test_search_begins_again_after_an_answer_that_is_too_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("localization.filters.global_localization.MAX_HISTORY", 48)
    searches: list[int] = []

    class Slow(Late):
        def start(self, request: SearchRequest) -> PendingSearch:
            searches.extend([len(request.records)] * request.searches)
            # The first answer comes after 60 echoes, when the history of 48 no longer reaches back to its beginning.
            self.questions = 60 if len(searches) == 1 else 0
            return super().start(request)

    estimates, off_in = turn_from_unknown_start(finder(CONFIG, None, poses=Slow(table_search(CONFIG), 60)), 9.0)
    assert len(searches) >= 2
    assert estimates[-1].health.status is HealthStatus.OK
    assert off_in < 2.0


@pytest.mark.long
def test_late_alternatives_still_find_a_slipped_heading() -> None:
    # The wheels slipped by 0.35 rad, and the belief claims a deviation of 0.02.
    slipped = independent((*START[:2], START[2] + 0.35), (0.2, 0.2, 0.02))
    estimates, off_in = turn_from_unknown_start(finder(CONFIG, slipped, poses=Late(table_search(CONFIG), 6)), 8.0)
    assert off_in < 1.0
    assert estimates[-1].health.status is HealthStatus.OK


def test_stored_table_is_read_again_and_equal(tmp_path: Path) -> None:
    built: list[float] = []
    first = load_or_build(CONFIG, tmp_path / "new", built.append)
    assert built[-1] == pytest.approx(1.0)
    assert built == sorted(built)
    count = len(built)
    second = load_or_build(CONFIG, tmp_path / "new", built.append)
    assert len(built) == count
    assert second.cell_in == first.cell_in
    for name in ("origin_in", "number", "codes", "is_known"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))


@pytest.mark.long
def test_damaged_tables_are_built_again_and_old_ones_removed(tmp_path: Path) -> None:
    load_or_build(CONFIG, tmp_path, lambda _: None)
    (stored,) = tmp_path.glob("*.npz")
    stored.write_bytes(b"no table")
    # A file of a version that cannot be read, or one that was cut off.
    built: list[float] = []
    load_or_build(CONFIG, tmp_path, built.append)
    assert built
    stored.unlink()
    # Files of other maps that are older.
    for number in range(MAX_CACHED + 3):
        (tmp_path / f"{number}.npz").write_bytes(b"")
    load_or_build(CONFIG, tmp_path, built.append)
    assert len(list(tmp_path.glob("*.npz"))) == MAX_CACHED
    assert stored.exists()
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.long
def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert len(load_or_build(CONFIG, tmp_path / "file", lambda _: None).places_in)


def test_cache_is_in_the_users_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder().is_relative_to(tmp_path)
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder().is_relative_to(Path.home())


LONG_FLAT = polygon_segments([(0.0, 0.0), (1400.0, 0.0), (1400.0, 350.0), (0.0, 350.0)])
"""Three flats of 114 m^2: 34,000 places in cells of 3 in, 13,000 in cells of 6 in."""


def test_large_maps_have_larger_cells_and_bounded_tables() -> None:
    table = build_range_table(LONG_FLAT, N150, RaySonar(), 9.0)
    assert table.cell_in == 6.0
    # One column more, for no place.
    assert table.codes.shape == (DIRECTIONS, len(table.places_in) + 1)
    assert table.codes.nbytes < 5e6
    # One of four places is computed at first.
    assert len(table.coarse_places) < 0.27 * len(table.places_in)
    assert table.is_known.sum() == len(table.coarse_places) + 1


def test_what_a_search_adds_to_a_table_is_stored(tmp_path: Path) -> None:
    config = LocalizationConfig(LONG_FLAT, N150, QUIET, RaySonar())
    poses = cached_search(config, tmp_path)
    before = poses.table.is_known.sum()
    directions = N150.sonar_angles_rad
    ranges = ranges_from(np.array((130.0, 120.0, 0.2)), np.array(directions), N150, wall_map(LONG_FLAT)).range_in
    readings = np.minimum(np.round(ranges), 255.0).tolist()
    records = [EchoRecord(np.zeros(3), directions[k], k, 0.0, reading) for k, reading in enumerate(readings)]
    found = poses.start(SearchRequest([*records, *records]))()
    assert found is not None
    # The rectangle looks the same after half a turn: one of two poses, both found.
    means = [each.belief.mean for each in found.hypotheses[:2]]
    assert min(np.hypot(mean[0] - 130.0, mean[1] - 120.0) for mean in means) < 3.0
    known = poses.table.is_known
    assert before < known.sum() < len(known)
    again = load_or_build(config, tmp_path, lambda _: None)
    np.testing.assert_array_equal(again.is_known, known)
    np.testing.assert_array_equal(again.codes, poses.table.codes)


@pytest.mark.long
def test_readings_have_a_density_before_any_search() -> None:
    with closing(BackgroundSearch(CONFIG, waits=False)) as poses:
        sampled = np.array([poses.density(reading) for reading in range(256)])
    exact = np.array([table_search(CONFIG).density(reading) for reading in range(256)])
    assert sampled.min() > 0.0
    # The mean log ratio over readings as they come: the evidence per echo that sampling adds or takes.
    assert abs(float((exact * np.log(sampled / exact)).sum())) < 0.1


@pytest.mark.long
def test_worker_ends_with_its_user_in_the_middle_of_its_work(tmp_path: Path) -> None:
    flat = LocalizationConfig(load_world("flat").walls, N150, QUIET, ConeSonar())
    poses = BackgroundSearch(flat, waits=False, folder=tmp_path)
    poses.prepare()
    assert poses._pool is not None
    processes = list(poses._pool._processes.values())
    pending = poses.start(SearchRequest([EchoRecord(np.zeros(3), 0.0, 0, 0.0, 30.0)]))
    assert pending() is None
    poses.close()
    assert not any(process.is_alive() for process in processes)


def can_import(name: str) -> bool:
    try:
        import_module(name)
    except ImportError:
        return False
    return True


@pytest.mark.long
def test_worker_has_no_scipy_which_numba_would_load(tmp_path: Path) -> None:
    pytest.importorskip("scipy.linalg")
    with closing(BackgroundSearch(CONFIG, waits=True, folder=tmp_path)) as poses:
        poses.prepare()
        assert poses._pool is not None
        # numpy is imported in the worker: the check itself works.
        assert poses._pool.submit(can_import, "numpy.linalg").result()
        assert not poses._pool.submit(can_import, "scipy.linalg").result()


@pytest.mark.parametrize(("on_disk", "expected"), [(True, []), (False, ["start", "join"])])
def test_only_code_not_on_disk_is_compiled_apart(
    on_disk: bool, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []

    class Compiler:
        def __init__(self, target: object, args: tuple[LocalizationConfig]) -> None:
            assert (target, args) == (background_search._compile, (CONFIG,))

        def start(self) -> None:
            calls.append("start")

        def join(self) -> None:
            calls.append("join")

    monkeypatch.setattr(compiled, "is_wanted", lambda _: True)
    monkeypatch.setattr(compiled, "is_on_disk", lambda _: on_disk)
    monkeypatch.setattr(multiprocessing, "get_context", lambda _: SimpleNamespace(Process=Compiler))
    background_search._compile_apart(CONFIG)
    assert calls == expected


def wait_beside_parent(_: Connection) -> None:
    background_search._end_with_parent()


def start_and_wait(writer: Connection) -> None:
    process = multiprocessing.get_context("spawn").Process(target=wait_beside_parent, args=(writer,))
    process.start()
    writer.send(None)
    process.join()


@pytest.mark.long
def test_a_compiling_process_ends_with_its_worker() -> None:
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    worker = context.Process(target=start_and_wait, args=(writer,))
    # This process's own end would leave the pipe open.
    worker.start()
    writer.close()
    reader.recv()
    worker.kill()
    worker.join()
    # The pipe ends once the last process that could write to it has ended.
    assert reader.poll(30.0)
    with pytest.raises(EOFError):
        reader.recv()


def test_only_the_finder_has_a_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    belief = independent(START, (0.2, 0.2, 0.01))
    with filter_on_robot(DEFAULT_METHOD, CONFIG, belief, waits=True) as method:
        assert method == DEFAULT_METHOD
    with filter_on_robot(FINDER, CONFIG, belief, waits=True) as method:
        assert isinstance(method, GlobalLocalizer)
        assert method.health.status is HealthStatus.OK


def test_a_process_without_children_searches_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    # A daemonic process may not have children.
    monkeypatch.setattr("multiprocessing.process._current_process._config", {"daemon": True, "authkey": b""})
    with filter_on_robot(FINDER, CONFIG, None, waits=True) as method:
        assert isinstance(method, GlobalLocalizer)
        assert isinstance(method._poses, TableSearch)


def test_health_says_what_is_waited_for() -> None:
    class Preparing(Late):
        progress = "preparing the map, 40 %"

    lost = finder(CONFIG, None, poses=Preparing(table_search(CONFIG), 1))
    assert lost.health.reason == "searching: the start is unknown; preparing the map, 40 %"


