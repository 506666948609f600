"""Options, markers and Hypothesis profiles of all tests.

    pytest --robot ADDRESS     the tests of tests/hardware alone, on a real robot
    pytest --restarts N        number of server kills and line disconnections (tests/integration/test_restarts.py)
    pytest -m "not long"       without slow tests: programs, browsers, compilers, calculations of half a second or more
    pytest --hypothesis-profile=roaming    random examples; the default profile always uses the same
"""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator, Iterator
from inspect import isfunction
from itertools import chain, islice
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.programs import ports

TESTS = Path(__file__).parent

LONG = ("integration", "benchmarks", "packaging", "clib", "docs")
"""Folders whose tests are all marked `long`."""

SHORT_HALF, LONG_HALF = "not long and not hypothesis", "long or hypothesis"
"""The `-m` of the two halves of scripts/test."""
SLOWEST = (
    "docs/test_site.py", "docs/test_calibration_and_maps_pages.py",
    "localization/filters/test_compiled.py localization/filters/test_mounts.py "
    "localization/experiments/test_compiled_trial.py",
    "integration/test_readme.py", "docs/test_pages.py", "packaging/test_wheel.py", "localization/cli/test_calibrate.py",
    "nserver_emu/simulation/test_batch.py", "nserver_emu/simulation/test_compiled_echoes.py",
    "localization/cli/test_localize.py", "localization/experiments/test_trial.py", "benchmarks/test_isolation.py",
    "docs/test_missions_page.py", "benchmarks/test_line_localizer.py", "localization/navigation/test_mission.py",
    "nserver_emu/server/test_determinism.py", "integration/viewer/test_localization.py",
    "localization/live/test_background_search.py", "integration/test_missions.py", "integration/test_safety.py",
    "integration/test_cluster.py",
)  # fmt: skip
"""Files that a worker begins with, the slowest first: begun last, they would run when all others are done. Files of one
entry run on the same worker, as they compile the same functions: two workers would compile them twice."""

_UNHURRIED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""No deadlines: the speed and the load of a machine decide no test."""
settings.register_profile("steady", _UNHURRIED, derandomize=True)
settings.register_profile("roaming", _UNHURRIED, derandomize=False)
settings.load_profile("steady")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a script's background job; child processes inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


# The modules and tests of a half are a million objects: searching them for garbage as often as Python does by default
# takes a twelfth of the time of all tests.
gc.set_threshold(100_000)


def pytest_collection_finish() -> None:
    """Exempt them from every later search."""
    gc.freeze()


os.environ.setdefault("NOMAD_COMPILED", "never")  # the same numbers; importing numba takes every process a second


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("nomad")
    group.addoption("--robot", metavar="ADDRESS", help="run only tests/hardware, on this real robot, which needs "
                    "50 cm of free space around it; tests/hardware/test_robot.py lists its motions")  # fmt: skip
    group.addoption("--restarts", metavar="N", type=int, default=5,
                    help="number of restarts in the tests of restarts (default: 5)")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--robot") and config.getoption("numprocesses", None):
        raise pytest.UsageError("--robot: only one program can use a robot at a time; omit -n")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With the `-m` of a half, do not import files without its tests: it would take each worker several seconds."""
    half = config.option.markexpr
    if half not in (SHORT_HALF, LONG_HALF) or not collection_path.name.startswith("test_"):
        return None
    if collection_path.relative_to(TESTS).parts[0] in LONG:
        return None if half == LONG_HALF else True
    if half == SHORT_HALF or collection_path.is_dir():
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if "mark.long" in text or "hypothesis" in text else True


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(collector: pytest.Module | pytest.Class, obj: object) -> list[pytest.Item] | None:
    """With the `-m` of a half, make no tests of a function of the other, which takes each worker a second."""
    half = collector.config.option.markexpr
    is_elsewhere = half not in (SHORT_HALF, LONG_HALF) or collector.path.relative_to(TESTS).parts[0] in LONG
    if is_elsewhere or not isfunction(obj):
        return None
    marks: list[pytest.Mark] = getattr(obj, "pytestmark", [])
    # Single parameters may be marked: pytest decides.
    rows = [mark.args[1] if len(mark.args) > 1 else () for mark in marks if mark.name == "parametrize"]
    if any(getattr(row, "marks", ()) for values in rows if isinstance(values, list | tuple) for row in values):
        return None
    is_long = collector.get_closest_marker("long") is not None or any(mark.name == "long" for mark in marks)
    is_in_long_half = is_long or getattr(obj, "is_hypothesis_test", False)
    return None if is_in_long_half == (half == LONG_HALF) else []


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Generator[None]:
    """Mark the folders of LONG, and distribute SLOWEST; with --robot, select only the hardware tests."""
    for item in items:
        if item.path.relative_to(TESTS).parts[0] in LONG:
            item.add_marker(pytest.mark.long)
    if config.getoption("--robot"):
        others = [item for item in items if "hardware" not in item.path.parts]
        items[:] = [item for item in items if "hardware" in item.path.parts]
        config.hook.pytest_deselected(items=others)
    # -m and -k deselect others here.
    yield
    items[:] = _spread_slowest(items, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


def _spread_slowest(items: list[pytest.Item], workers: int) -> list[pytest.Item]:
    """Order tests so that the shares of all workers, which xdist cuts in this order, begin with files of SLOWEST."""
    slowest: list[list[pytest.Item]] = [[] for _ in SLOWEST]
    files = {name: group for names, group in zip(SLOWEST, slowest, strict=True) for name in names.split()}
    assert all((TESTS / name).is_file() for name in files)
    rest: list[pytest.Item] = []
    for item in items:
        files.get(item.path.relative_to(TESTS).as_posix(), rest).append(item)
    others, ordered = iter(rest), list[pytest.Item]()
    for number in range(workers):
        begin, share = len(ordered), (len(items) - len(ordered)) // (workers - number)
        ordered += chain.from_iterable(slowest[number::workers])
        ordered += islice(others, max(0, share - (len(ordered) - begin)))
    return [*ordered, *others]


@pytest.fixture(params=["poll", "portable"])
def serial_ports(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Open serial ports by each of both transports: in this process, and in programs that call `select_ports`."""
    if request.param == "portable":
        monkeypatch.setenv(ports.VARIABLE, "1")
        monkeypatch.setattr("nclient.transports.serial.needs_portable", lambda _: True)


@pytest.fixture
def plain_batch(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run the loops of the batch simulation in Python: numba's compilation takes some ten seconds."""
    import numpy as np

    from nserver_emu.simulation import batch

    batch_kernel = pytest.importorskip("nserver_emu.simulation.batch_kernel", exc_type=ImportError)
    monkeypatch.setattr(batch_kernel, "load_loops", lambda: batch_kernel.make_loops(0))
    # One thread: numpy's error state does not pass to others.
    monkeypatch.setattr(batch, "_cores", lambda: 1)
    # 64-bit words of random streams overflow on purpose.
    with np.errstate(over="ignore"):
        yield
