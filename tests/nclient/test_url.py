"""Addresses are split, validated, and described in docs/addresses.md."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nclient import url
from nclient.errors import AddressError
from nclient.protocol.types import N150, N200, SCOUT
from nclient.url import OPTIONS, SCHEMES, parse_address, split_address


def test_split_address_returns_scheme_and_options() -> None:
    raw = split_address("  Serial:///dev/ttyUSB0?model=n150&baud= ")
    assert raw.text == "Serial:///dev/ttyUSB0?model=n150&baud="
    assert (raw.scheme, dict(raw.options)) == ("serial", {"model": "n150", "baud": ""})
    assert split_address("lab").scheme == ""


def test_url_parts_need_two_slashes_and_a_port_number() -> None:
    parts = split_address("robotd://lab:65001/x?model=n200").url_parts("robotd://host[:port]")
    assert (parts.hostname, parts.port, parts.path) == ("lab", 65001, "/x")
    for wrong in ("robotd:lab", "robotd://lab:port"):
        with pytest.raises(AddressError, match="address is robotd://host"):
            split_address(wrong).url_parts("robotd://host[:port]")


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("sim:w?seed=4&record=a&noisy=1", "sim:w?seed=4&noisy=1"),
        ("sim:w?record=a", "sim:w"),
        ("sim:w", "sim:w"),
        ("sim:w?", "sim:w?"),
        # %64 is "d": an escaped name must be removed, too.
        ("sim:w?seed=4&recor%64=a", "sim:w?seed=4"),
        ("sim:w?start=1,2,0,0", "sim:w?start=1,2,0,0"),
    ],
)
def test_without_removes_options_and_changes_nothing_else(text: str, left: str) -> None:
    assert split_address(text).without(["record"]) == left


def test_unknown_options_are_ignored_only_on_request() -> None:
    raw = split_address("sim:w?seed=4&feed=1")
    assert raw.parse_options({"feed": url.flag}, ignore_unknown=True) == {"feed": True}
    with pytest.raises(AddressError, match=r"'seed'.*mean feed"):
        raw.parse_options({"feed": url.flag})


@pytest.mark.parametrize(
    ("parse", "good", "value", "bad", "expected"),
    [
        (url.seconds, "0.5", 0.5, "0", "seconds above 0"),
        (url.seconds_or_zero, "0", 0.0, "-1", "0 for none"),
        (url.seconds_or_zero, "2", 2.0, "inf", "0 for none"),
        (url.speed, "8", 8.0, "fast", "a number above 0"),
        (url.count, "2", 2, "-2", "a whole number"),
        # A superscript digit is a digit for str.isdigit, and no number for int.
        (url.count, "0", 0, "²", "a whole number"),
        (url.baud, "38400", 38400, "0", "bits a second"),
        (url.motion_timeout, "0", 0, "1", "2 to 255, or 0"),
        (url.motion_timeout, "255", 255, "256", "2 to 255, or 0"),
        (url.one_of(["a", "b"]), "b", "b", "c", "one of a, b"),
        (url.flag, "1", True, "yes", "1 or 0"),
        (url.flag, "0", False, "", "1 or 0"),
        (url.file_name, "a.toml", "a.toml", "", "the name of a file"),
    ],
)
def test_option_parsers(parse: Callable[[str], Any], good: str, value: object, bad: str, expected: str) -> None:
    assert parse(good) == value
    with pytest.raises(AddressError, match=f"x is .*{expected}.*, not {bad!r}"):
        split_address(f"a:?x={bad}").parse_options({"x": parse})


def test_a_repeated_option_is_rejected() -> None:
    with pytest.raises(AddressError, match=r"'serial:///dev/r1.baud=1.*': baud .* 2 times"):
        split_address("serial:///dev/r1?baud=1&model=n150&baud=1")


def test_a_parsed_address_has_its_place_and_model() -> None:
    server = parse_address("nserver://lab:7654/3?model=scout")
    assert (server.host, server.port, server.robot_id, server.model) == ("lab", 7654, 3, SCOUT)
    serial = parse_address("serial:///dev/my%20port?baud=9600")
    assert (serial.path, serial.options.baud, serial.model) == ("/dev/my port", 9600, N150)
    line = parse_address("robotd://lab?model=n200")
    assert (line.host, line.port, line.model) == ("lab", 65001, N200)
    assert parse_address("replay:run.log").path == "run.log"
    assert parse_address("sim:thesis_room?robot=scout").model is SCOUT


@pytest.mark.parametrize(
    ("text", "tm_s", "feed", "reconnect", "retries"),
    [
        ("nserver://lab/1", 5, True, None, None),
        ("serial:///dev/r1", 5, True, 5.0, 2),
        ("robotd://lab", 5, True, 5.0, 2),
        ("sim:thesis_room", None, None, None, None),
        ("replay:run.log", None, None, None, None),
        ("serial:///dev/r1?tm_s=0&feed=0&reconnect=0&retries=0", 0, False, 0.0, 0),
    ],
)
def test_defaults_depend_on_the_scheme(
    text: str, tm_s: int | None, feed: bool | None, reconnect: float | None, retries: int | None
) -> None:
    options = parse_address(text).options
    assert (options.tm_s, options.feed, options.reconnect, options.retries) == (tm_s, feed, reconnect, retries)


def test_the_wire_protocol_of_each_scheme() -> None:
    wires = [parse_address(text).wire for text in ("nserver://lab", "serial:///dev/r1", "robotd://lab", "sim:w")]
    assert wires == ["tcp", "serial", "hello", "tcp"]
    assert parse_address("sim:thesis_room?line=1").wire == "serial"


def test_docs_list_every_scheme_and_option() -> None:
    page = (Path(__file__).parents[2] / "docs" / "addresses.md").read_text()
    rows = [line.split("|") for line in page.splitlines() if line.startswith("| `")]
    names = [row[1].strip(" `") for row in rows]
    schemes = {name.partition(":")[0] for name in names if ":" in name}
    assert schemes == {*SCHEMES, "sim"}
    assert [name for name in names if ":" not in name] == list(OPTIONS)
    for (name, option), row in zip(OPTIONS.items(), rows[len(schemes) :], strict=True):
        documented = set(row[2].replace(",", " ").split())
        assert documented == (set(option.schemes) if option.schemes else {"all"}), name
