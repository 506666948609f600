"""Addresses such as `nserver://lab:7019/1?timeout_s=2`: parsed and validated, nothing is opened.

    nserver://lab:7019/1?timeout_s=2      scheme nserver, host lab, port 7019, robot 1
    serial:///dev/ttyUSB0?model=n150      scheme serial, path /dev/ttyUSB0; /dev/ttyUSB0 and COM3 mean the same
    serial+rfc2217://lab:4001             a serial port of another machine, as pyserial's rfc2217://lab:4001
    sim:thesis_room?seed=1                scheme sim: the rest is read by the opener of that scheme

`SCHEMES` and `AddressOptions` are the only lists of what an address may contain; docs/addresses.md shows them to users.
`nclient.connect` turns an `Address` into a connection.
"""

from __future__ import annotations

import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, get_type_hints
from urllib.parse import SplitResult, parse_qsl, unquote, unquote_plus, urlsplit

from nclient.backends.base import DEFAULT_TIMEOUT_S, MIN_TIMEOUT_S
from nclient.backends.wrappers import DEFAULT_RETRIES, MAX_PAUSE_S
from nclient.common.files import parse_toml, read_text
from nclient.errors import AddressError, NomadError, suggest
from nclient.faults.plan import Plan, load_plan
from nclient.protocol.types import MODELS, N150, Model, get_model
from nclient.recording.recorder import HANDSHAKE_FIRST, SERIAL, TCP
from nclient.recording.replayer import ORDERS
from nclient.transports.stream import in_process_schemes

Parser = Callable[[str], Any]

DEFAULT_PORT: Final = 7019
DEFAULT_LINE_PORT: Final = 65001
MAX_MODEL_FILE: Final = 1 << 22
"""Bytes of a model file that a sim: address names."""
MAX_ROBOT_ID: Final = 0x7FFFFFFF
"""connect_robot carries the number as a signed 32-bit word."""
EXAMPLES: Final = "such as nserver://localhost:7019/1 or sim:thesis_room"


# -- values of options ------------------------------------------------------------------------------------------------
# A parser returns the value of an option's text, or raises ValueError with a description of what it accepts.


def number(description: str, is_valid: Callable[[float], bool]) -> Callable[[str], float]:
    """Return a parser of finite numbers; its ValueError has the description of valid ones."""
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and is_valid(value)):
            raise ValueError(description)
        return value

    return parse


def whole_number(description: str, allowed: Container[int]) -> Callable[[str], int]:
    """Return a parser of whole numbers; its ValueError has the description of valid ones."""
    def parse(text: str) -> int:
        # isdecimal() accepts the digits of other scripts, and int() reads them.
        if not (text.isascii() and text.isdecimal()) or int(text) not in allowed:
            raise ValueError(description)
        return int(text)

    return parse


seconds = number("a number of seconds above 0", lambda value: value > 0)
seconds_or_zero = number("a number of seconds, 0 for none", lambda value: value >= 0)
"""A duration, where 0 switches something off."""
speed = number("a number above 0", lambda value: value > 0)
"""A speed limit in inches or degrees per second."""
count = whole_number("a whole number, 0 or more", range(sys.maxsize))
baud = whole_number("a number of bits a second", range(1, sys.maxsize))
robot_number = whole_number("a robot's number, 1 or more", range(1, MAX_ROBOT_ID + 1))
motion_timeout = whole_number("whole seconds, 2 to 255, or 0 for none", {0, *range(MIN_TIMEOUT_S, 256)})
"""Whole seconds as conf_tm takes them. The robot counts whole seconds: one could expire between two keep-alives."""


def flag(text: str) -> bool:
    """Return True for "1" and False for "0"."""
    if text not in ("1", "0"):
        raise ValueError("1 or 0")
    return text == "1"


def one_of(names: Iterable[str]) -> Parser:
    """Return a parser that accepts only these words."""
    allowed = tuple(names)

    def parse(text: str) -> str:
        if text not in allowed:
            raise ValueError(f"one of {', '.join(allowed)}")
        return text

    return parse


def file_name(text: str) -> str:
    """Return the name of a file, which must not be empty."""
    if not text:
        raise ValueError("the name of a file")
    return text


def fault_plan(text: str) -> Plan:
    """Return the fault plan of a file. Raises FaultPlanError if it is not valid."""
    return load_plan(Path(file_name(text)))


# -- tables -----------------------------------------------------------------------------------------------------------


class Scheme(NamedTuple):
    """Describe a scheme of this package. Other schemes are entry points of the group `nomad.openers`."""

    form: str
    """Shown in errors."""
    wire: str
    """The protocol on the stream, as recordings name it: tcp, serial or hello."""
    in_process: bool = False
    """True if the peer runs in this process and its time is simulated."""


SCHEMES: Final[dict[str, Scheme]] = {
    "nserver": Scheme(f"nserver://host[:port]/id, {EXAMPLES}", TCP),
    "serial": Scheme("serial:///dev/ttyUSB0?model=n150&baud=38400", SERIAL),
    "serial+rfc2217": Scheme("serial+rfc2217://host:port?model=n150&baud=38400", SERIAL),
    "serial+socket": Scheme("serial+socket://host:port?model=n150", SERIAL),
    "robotd": Scheme("robotd://host[:port]?model=n200", HANDSHAKE_FIRST),
    "replay": Scheme("replay:FILE", TCP, in_process=True),
}

# Groups of schemes in the table of options.
_REPLAY: Final = frozenset({"replay"})
_SERIAL_PORT: Final = frozenset({"serial", "serial+rfc2217"})
_SERIAL_PROTOCOL: Final = _SERIAL_PORT | {"serial+socket", "robotd"}
_REMOTE: Final = _SERIAL_PROTOCOL | {"nserver"}


class Option(NamedTuple):
    """Describe an option of addresses: its type, the schemes that have it, and its default."""

    parse: Parser
    schemes: frozenset[str] | None = None
    """None: every scheme."""
    default: Any = None
    default_for: frozenset[str] = frozenset()
    """The schemes in which the default applies; elsewhere the option is off unless given."""

    def applies_to(self, scheme: str) -> bool:
        """Return True if addresses of this scheme have the option."""
        return self.schemes is None or scheme in self.schemes


@dataclass(frozen=True, slots=True, kw_only=True)
class AddressOptions:
    """Hold the values of the options; None where an option is neither given nor has a default."""

    # The link and the robot at its end.
    timeout_s: Annotated[float | None, Option(seconds, _REMOTE)] = None
    model: Annotated[Model | None, Option(get_model, _REMOTE)] = None
    baud: Annotated[int | None, Option(baud, _SERIAL_PORT)] = None
    checks: Annotated[bool | None, Option(flag, _SERIAL_PROTOCOL)] = None
    # Replay of a recording.
    order: Annotated[str | None, Option(one_of(ORDERS), _REPLAY)] = None
    connection: Annotated[str | None, Option(file_name, _REPLAY)] = None
    # Layers around the stream.
    record: Annotated[str | None, Option(file_name)] = None
    faults: Annotated[Plan | None, Option(fault_plan)] = None
    # Layers around the protocol: recovery and safety.
    reconnect: Annotated[float | None, Option(seconds_or_zero, _REMOTE, MAX_PAUSE_S, _SERIAL_PROTOCOL)] = None
    retries: Annotated[int | None, Option(count, _SERIAL_PROTOCOL, DEFAULT_RETRIES, _SERIAL_PROTOCOL)] = None
    bumper_stop: Annotated[bool | None, Option(flag, None, True, _SERIAL_PROTOCOL)] = None
    # Where time runs by itself, a robot has to stop when its program dies; a simulation waits for its client instead.
    feed: Annotated[bool | None, Option(flag, None, True, _REMOTE)] = None
    tm_s: Annotated[int | None, Option(motion_timeout, None, DEFAULT_TIMEOUT_S, _REMOTE)] = None
    max_turn_deg_s: Annotated[float | None, Option(speed)] = None
    max_speed_in_s: Annotated[float | None, Option(speed)] = None


OPTIONS: Final[dict[str, Option]] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(AddressOptions, include_extras=True).items()
}


# -- parsing ----------------------------------------------------------------------------------------------------------


class RawAddress(NamedTuple):
    """Hold the text of an address, its scheme, and its options as text."""

    text: str
    scheme: str
    options: Mapping[str, str]

    def url_parts(self, form: str) -> SplitResult:
        """Return host, port and path.

        Raises
        ------
        AddressError
            If there are no two slashes after the scheme, or the port is not a number; `form` shows what is expected.
        """
        if not self.text.partition(":")[2].startswith("//"):
            raise AddressError(f"{self.text!r}: such an address is {form}")
        try:
            parts = urlsplit(self.text)
            _ = parts.port  # raises ValueError if it is not a port number
        except ValueError as error:
            raise AddressError(f"{self.text!r}: {error}; an address is {form}") from None
        return parts

    def without(self, names: Iterable[str]) -> str:
        """Return the text without these options and with everything else unchanged."""
        # Pieces stay as they are: decoding and encoding again could change them.
        path, question, query = self.text.partition("?")
        left = [piece for piece in query.split("&") if unquote_plus(piece.partition("=")[0]) not in names]
        return path + question + "&".join(left) if any(left) or not query else path

    def parse_options(self, parsers: Mapping[str, Parser], *, ignore_unknown: bool = False) -> dict[str, Any]:
        """Return the values of the options that are given.

        Raises
        ------
        AddressError
            For an option without parser (unless `ignore_unknown`), with the most similar name, and for a value that
            its parser rejects, with what is accepted.
        """
        values = {}
        for name, text in self.options.items():
            if name in parsers:
                values[name] = self._value(name, text, parsers[name])
            elif not ignore_unknown:
                raise AddressError(f"{self.text!r}: no option {name!r}{suggest(name, parsers)} "
                                   f"There are {', '.join(parsers)}.")
        return values

    def _value(self, name: str, text: str, parse: Parser) -> Any:
        try:
            return parse(text)
        except NomadError:  # FaultPlanError names the file by itself
            raise
        except ValueError as error:
            raise AddressError(f"{self.text!r}: {name} is {error}, not {text!r}") from None


@dataclass(frozen=True, slots=True)
class Address:
    """Hold a validated address. Whether its peer exists shows only when `nclient.connect` opens it."""

    text: str
    scheme: str
    wire: str
    """The protocol on the stream, as recordings name it. A replayed recording decides by itself."""
    in_process: bool
    """True if the peer runs in this process and its time is simulated."""
    options: AddressOptions
    given: frozenset[str]
    """Names of the options in the text, as opposed to defaults."""
    host: str = ""
    port: int = 0
    robot_id: int | None = None
    path: str = ""
    """Device of a serial: address, file of a replay: address."""
    stripped_text: str = field(default="", repr=False)
    """The text without the options that every scheme has: what an in-process peer gets and recordings name."""

    @property
    def model(self) -> Model:
        """Return the robot's model, an N150 unless the address names one."""
        return self.options.model or N150


def split_address(text: str) -> RawAddress:
    """Split a text into scheme and options; the scheme is "" if there is none.

    Raises
    ------
    AddressError
        If an option is given twice.
    """
    text = _with_scheme(text.strip())
    scheme, colon, rest = text.partition(":")
    # urlsplit() knows no query of schemes without slashes, such as sim:WORLD?seed=1.
    query = rest.partition("#")[0].partition("?")[2]
    options = parse_qsl(query, keep_blank_values=True)
    for name, times in Counter(name for name, _ in options).items():
        if times > 1:
            raise AddressError(f"{text!r}: {name} is given {times} times; expected once")
    return RawAddress(text, scheme.lower() if colon else "", dict(options))


_PORT_NAME: Final = re.compile(r"(?P<device>/dev/)|COM\d+(?=$|\?)", re.IGNORECASE)
"""Names of serial ports: /dev/ttyUSB0, /dev/cu.usbserial-1, COM3."""


def is_port_name(text: str) -> bool:
    """Return True for the name of a serial port, with or without options."""
    return _PORT_NAME.match(text) is not None


def _with_scheme(text: str) -> str:
    """Return the address of a serial port for its name alone, any other text unchanged."""
    found = _PORT_NAME.match(text)
    if not found:
        return text
    return f"serial://{text}" if found["device"] else f"serial:///{text}"


def parse_address(text: str) -> Address:
    """Parse and validate an address.

    Parameters
    ----------
    text
        `scheme:place?option=value&option=value`, see docs/addresses.md.

    Raises
    ------
    AddressError
        If the text is not a valid address; the message shows the form, the valid names and the most similar one.
    FaultPlanError
        If the file of `faults=` is not a valid fault plan.
    """
    raw = split_address(text)
    # 1. Scheme: one of this package, or one that an installed entry point opens in this process.
    scheme = SCHEMES.get(raw.scheme)
    if scheme is None:
        if raw.scheme not in in_process_schemes():
            raise _unknown_scheme(raw)
        wire = SERIAL if raw.options.get("line") == "1" else TCP
        scheme = Scheme("scheme:what", wire, in_process=True)
    is_foreign = raw.scheme not in SCHEMES

    # 2. Options: defaults of the scheme, then what is given. An in-process peer checks its own options.
    options = {name: option for name, option in OPTIONS.items() if option.applies_to(raw.scheme)}
    values = {name: option.default for name, option in options.items() if raw.scheme in option.default_for}
    values |= raw.parse_options({name: options[name].parse for name in options}, ignore_unknown=is_foreign)
    if is_foreign:
        values["model"] = _family(raw.options.get("robot", N150.name), raw.options.get("model_file", ""))

    # 3. Place: host and port, device, or file.
    place = {} if is_foreign else _parse_place(raw, scheme)
    stripped = raw.without([name for name, option in OPTIONS.items() if option.schemes is None])
    return Address(raw.text, raw.scheme, scheme.wire, scheme.in_process, AddressOptions(**values),
                   frozenset(raw.options), stripped_text=stripped, **place)


def _family(robot: str, model_file: str) -> Model:
    """Return the model whose protocol a simulated robot has: that at the end of `like` in its model file.

    Raises AddressError for an unknown robot without such a file; with one, the simulation reports what is wrong.
    """
    if not model_file:
        return get_model(robot)
    try:
        rows = parse_toml(read_text(Path(model_file), MAX_MODEL_FILE, AddressError), model_file, AddressError)["model"]
        bases = {str(row["name"]).lower(): str(row.get("like", row["name"])).lower() for row in rows}
    except (AddressError, LookupError, TypeError, AttributeError):
        return MODELS.get(robot.lower(), N150)
    name = robot.lower()
    while name not in MODELS and name in bases:
        name = bases.pop(name)
    return MODELS.get(name, N150)


def available_schemes() -> tuple[str, ...]:
    """Return all address schemes, sorted."""
    return tuple(sorted({*SCHEMES, *in_process_schemes()}))


_HOST_AND_PORT: Final = re.compile(r"[\w.-]+:\d+(?:/\d*)?(?:\?|$)")


def _unknown_scheme(raw: RawAddress) -> AddressError:
    schemes = available_schemes()
    if _HOST_AND_PORT.match(raw.text):
        # A host and a port: the port shows the likely scheme.
        scheme = "robotd" if f":{DEFAULT_LINE_PORT}" in raw.text else "nserver"
        hint = f"did you mean {scheme}://{raw.text}? "
    else:
        # Without a colon the first word may be a mistyped scheme.
        name = raw.scheme or raw.text.partition("/")[0].lower()
        hint = suggest(name, schemes, before="", after=":? ")
    return AddressError(
        f"{raw.text!r} is no address: {hint}There are {', '.join(f'{each}:' for each in schemes)} {EXAMPLES}"
    )


def _parse_place(raw: RawAddress, scheme: Scheme) -> dict[str, Any]:
    """Return the fields of `Address` that lie between the scheme and the options."""
    if raw.scheme == "replay":
        path = unquote(raw.text.partition(":")[2].partition("?")[0])
        if not path:
            raise AddressError(f"{raw.text!r}: the name of a recording follows: {scheme.form}")
        return {"path": path}

    parts = raw.url_parts(scheme.form)
    path = parts.path.strip("/")
    match raw.scheme:
        case "nserver":
            return {"robot_id": _robot_id(raw, parts), **_host_and_port(parts, "localhost", DEFAULT_PORT)}
        case "serial" if path and not (parts.netloc or parts.fragment):
            is_windows_port = _PORT_NAME.fullmatch(path) is not None
            return {"path": path if is_windows_port else unquote(parts.path)}
        case "serial+rfc2217" | "serial+socket":
            if not (parts.hostname and parts.port) or path or parts.fragment:
                raise AddressError(f"{raw.text!r}: a host and its port follow: {scheme.form}")
            return {"path": f"{raw.scheme.partition('+')[2]}://{parts.netloc}"}
        case "serial":
            raise AddressError(f"{raw.text!r}: three slashes and a port follow: {scheme.form}")
        case _ if parts.hostname and not (path or parts.fragment):
            return _host_and_port(parts, parts.hostname, DEFAULT_LINE_PORT)
        case _:
            raise AddressError(f"{raw.text!r}: a host and its port follow: {scheme.form}")


def _robot_id(raw: RawAddress, parts: SplitResult) -> int | None:
    """Return the number of the robot, which is the path; None without one: then it is the caller's, or 1."""
    number = parts.path.strip("/")
    try:
        if parts.fragment:
            raise ValueError(parts.fragment)
        return robot_number(number) if number else None
    except ValueError as error:
        raise AddressError(
            f"{raw.text!r}: what follows the host is the robot's number, 1 or more, not {parts.path!r}"
        ) from error


def _host_and_port(parts: SplitResult, host: str, port: int) -> dict[str, Any]:
    return {"host": parts.hostname or host, "port": port if parts.port is None else parts.port}
