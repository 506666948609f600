"""Addresses as text: taken apart, given on without what is ours, and read with hints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nclient import address as text
from nclient.errors import AddressError
from nclient.schemes import OPTIONS, SCHEMES


def test_scheme_and_options() -> None:
    address = text.parsed("  Serial:///dev/ttyUSB0?model=n150&baud= ")
    assert address.text == "Serial:///dev/ttyUSB0?model=n150&baud="
    assert (address.scheme, dict(address.options)) == ("serial", {"model": "n150", "baud": ""})
    assert text.parsed("lab").scheme == ""


def test_host_port_and_path() -> None:
    parts = text.parsed("robotd://lab:65001/x?model=n200").parts("robotd://host[:port]")
    assert (parts.hostname, parts.port, parts.path) == ("lab", 65001, "/x")
    for wrong in ("robotd:lab", "robotd://lab:port"):
        with pytest.raises(AddressError, match=r"such an address is robotd://host|an address is robotd://host"):
            text.parsed(wrong).parts("robotd://host[:port]")


@pytest.mark.parametrize(
    ("given", "left"),
    [
        ("sim:w?seed=4&record=a&noisy=1", "sim:w?seed=4&noisy=1"),
        ("sim:w?record=a", "sim:w"),
        ("sim:w", "sim:w"),
        ("sim:w?", "sim:w?"),
        ("sim:w?seed=4&recor%64=a", "sim:w?seed=4"),
        ("sim:w?start=1,2,0,0", "sim:w?start=1,2,0,0"),
    ],
)
def test_what_is_ours_is_taken_out_and_the_rest_stays_as_it_was(given: str, left: str) -> None:
    assert text.parsed(given).without(["record"]) == left


def test_the_others_options_are_left_alone_where_asked() -> None:
    address = text.parsed("sim:w?seed=4&feed=1")
    assert address.read({"feed": text.flag}, others=True) == {"feed": True}
    with pytest.raises(AddressError, match=r"no option 'seed'; did you mean feed\? There are feed"):
        address.read({"feed": text.flag})


@pytest.mark.parametrize(
    ("reader", "good", "value", "bad", "wanted"),
    [
        (text.seconds, "0.5", 0.5, "0", "seconds above 0"),
        (text.seconds_or_none, "0", 0.0, "-1", "0 for none"),
        (text.seconds_or_none, "2", 2.0, "inf", "0 for none"),
        (text.speed, "8", 8.0, "fast", "a number above 0"),
        (text.count, "2", 2, "-2", "a whole number"),
        (text.count, "0", 0, "²", "a whole number"),
        (text.baud, "38400", 38400, "0", "bits a second"),
        (text.motion_timeout, "0", 0, "1", "2 to 255, or 0"),
        (text.motion_timeout, "255", 255, "256", "2 to 255, or 0"),
        (text.one_of(["a", "b"]), "b", "b", "c", "one of a, b"),
        (text.flag, "1", True, "yes", "1 or 0"),
        (text.flag, "0", False, "", "1 or 0"),
        (text.path, "a.toml", "a.toml", "", "the name of a file"),
    ],
)
def test_readers(reader: Callable[[str], Any], good: str, value: object, bad: str, wanted: str) -> None:
    assert reader(good) == value
    with pytest.raises(AddressError, match=f"x is .*{wanted}.*, not {bad!r}"):
        text.parsed(f"a:?x={bad}").read({"x": reader})


def test_the_page_of_addresses_has_every_scheme_and_option_and_no_other() -> None:
    page = (Path(__file__).parents[2] / "docs" / "addresses.md").read_text()
    rows = [line.split("|") for line in page.splitlines() if line.startswith("| `")]
    named = [row[1].strip(" `") for row in rows]
    schemes = {name.partition(":")[0] for name in named if ":" in name}
    assert schemes == {*SCHEMES, "sim"}
    assert [name for name in named if ":" not in name] == [option.name for option in OPTIONS]
    for option, row in zip(OPTIONS, rows[len(schemes) :], strict=True):
        told = set(row[2].replace(",", " ").split())
        assert told == (set(option.schemes) if option.schemes else {"all"}), option.name


def test_an_option_given_twice_is_refused() -> None:
    with pytest.raises(AddressError, match=r"'serial:///dev/r1.baud=1.*': baud is given 2 times; expected once"):
        text.parsed("serial:///dev/r1?baud=1&model=n150&baud=1")
