"""What all tests share: the options, and modules beside the tests that can be imported by name.

    pytest --robot ADDRESS     the tests of tests/hardware alone, on a real robot
    pytest --restarts N        how often a daemon is killed, and its line pulled (tests/integration/test_restarts.py)
    pytest -m "not long"       without what takes its time: programs, browsers, compilers, long sums
    pytest --hypothesis-profile=roaming    other examples each time; without it they are the same each time
"""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

LONG = ("integration", "benchmarks", "packaging", "clib", "docs")
"""Folders whose tests are all marked `long`."""

_UNHURRIED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""How fast a machine is, and what else it does, decides no test."""
settings.register_profile("steady", _UNHURRIED, derandomize=True)
settings.register_profile("roaming", _UNHURRIED, derandomize=False)
settings.load_profile("steady")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a script, for all that is begun
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("nomad")
    group.addoption("--robot", metavar="ADDRESS", help="a real robot that stands free, 50 cm all around it: only the "
                    "tests of tests/hardware are run, and on it; see there what it will do")  # fmt: skip
    group.addoption("--restarts", metavar="N", type=int, default=5,
                    help="how often the tests of restarts restart (default: 5)")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--robot") and config.getoption("numprocesses", None):
        raise pytest.UsageError("--robot: there is one robot, and one program at a time talks to it; leave -n out")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Whole folders are long; with a robot, nothing but what is meant for it."""
    for item in items:
        if item.path.relative_to(Path(__file__).parent).parts[0] in LONG:
            item.add_marker(pytest.mark.long)
    if config.getoption("--robot"):
        others = [item for item in items if "hardware" not in item.path.parts]
        items[:] = [item for item in items if "hardware" in item.path.parts]
        config.hook.pytest_deselected(items=others)
