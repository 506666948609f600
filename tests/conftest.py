"""Options, markers and Hypothesis profiles of all tests.

    pytest --robot ADDRESS     the tests of tests/hardware alone, on a real robot
    pytest --restarts N        number of server kills and line disconnections (tests/integration/test_restarts.py)
    pytest -m "not long"       without slow tests: programs, browsers, compilers, long calculations
    pytest --hypothesis-profile=roaming    random examples; the default profile always uses the same
"""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

LONG = ("integration", "benchmarks", "packaging", "clib", "docs")
"""Folders whose tests are all marked `long`."""

SLOWEST = (
    "packaging", "integration/test_readme.py", "docs/test_pages.py", "docs/test_site.py", "fuzz/test_documentation.py",
)  # fmt: skip
"""Files and folders that come first, so that no worker begins one of them when the others are done."""

_UNHURRIED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""No deadlines: the speed and the load of a machine decide no test."""
settings.register_profile("steady", _UNHURRIED, derandomize=True)
settings.register_profile("roaming", _UNHURRIED, derandomize=False)
settings.load_profile("steady")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a script's background job; child processes inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("nomad")
    group.addoption("--robot", metavar="ADDRESS", help="run only tests/hardware, on this real robot, which needs "
                    "50 cm of free space around it; tests/hardware/test_robot.py lists its motions")  # fmt: skip
    group.addoption("--restarts", metavar="N", type=int, default=5,
                    help="number of restarts in the tests of restarts (default: 5)")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--robot") and config.getoption("numprocesses", None):
        raise pytest.UsageError("--robot: only one program can use a robot at a time; omit -n")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the folders of LONG, and put SLOWEST first; with --robot, select only the hardware tests."""
    folder = Path(__file__).parent
    items.sort(key=lambda item: not item.path.relative_to(folder).as_posix().startswith(SLOWEST))
    for item in items:
        if item.path.relative_to(folder).parts[0] in LONG:
            item.add_marker(pytest.mark.long)
    if config.getoption("--robot"):
        others = [item for item in items if "hardware" not in item.path.parts]
        items[:] = [item for item in items if "hardware" in item.path.parts]
        config.hook.pytest_deselected(items=others)
