"""What an address can say: a table of schemes and a table of options. Every backend is named in these rows.

    SCHEMES   nserver:, sim:, replay:    who is at the other end: how the stream is opened, what is spoken over it
    OPTIONS   ?timeout_s=2&model=scout   what one says of it: how the text is read, which wrapper it puts on

    Robot ─> outermost backend wrapper ─> ... ─> backend ─> outermost stream wrapper ─> ... ─> stream

Rules: a new option is a new row, a new scheme a new row. Rows of wrappers stand inside out: what comes later in the
table is put around what came before. A wrapper is put on only where its option is given (or a scheme's default) and
is not 0. All that is wrong with an address is said before anything is opened.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import nclient.address as text
import nclient.openers as openers
import nclient.wrappers as wrappers
from nclient.address import Address
from nclient.backends import (
    keep_alive,
)
from nclient.backends import (
    wrappers as reconnecting,
)
from nclient.backends import (
    wrappers as retrying,
)
from nclient.common.hints import did_you_mean
from nclient.errors import AddressError
from nclient.faults.plan import load_plan
from nclient.openers import open_nserver, open_tcp
from nclient.opening import Opening, Option, Scheme, Wanted
from nclient.protocol.types import N150, model_named
from nclient.recording.recorder import HELLO_FIRST, SERIAL
from nclient.recording.replayer import ORDERS
from nclient.transports import memory

__all__ = ["OPTIONS", "SCHEMES", "Opening", "Wanted", "known_schemes", "open_nserver", "open_tcp", "opening_of"]

EXAMPLES = "such as nserver://localhost:7019/1 or sim:thesis_room"
_SAFE = {"tm_s": keep_alive.DEFAULT_TIMEOUT_S, "feed": True}
"""Where time runs by itself: a program that is gone leaves a robot that stops."""
_LINE = _SAFE | {"retries": retrying.DEFAULT_RETRIES, "reconnect": reconnecting.LONGEST_PAUSE_S}

SCHEMES: dict[str, Scheme] = {
    "nserver": Scheme("nserver://host[:port]/id, " + EXAMPLES, openers.nserver_stream, openers.nserver_talk, _SAFE),
    "serial": Scheme("serial:///dev/ttyUSB0?model=n150&baud=38400", openers.serial_stream, openers.line_talk, _LINE,
                     line=SERIAL),
    "robotd": Scheme("robotd://host[:port]?model=n200", openers.robotd_stream, openers.line_talk, _LINE,
                     line=HELLO_FIRST),
    "replay": Scheme("replay:FILE", openers.replay_stream, openers.replay_talk, in_process=True),
}
"""Schemes that this package serves by itself; others are entry points of what answers in this process."""
_IN_PROCESS = Scheme("scheme:what", openers.memory_stream, openers.memory_talk, in_process=True, reads_the_rest=True)
_IN_PROCESS_LINE = replace(_IN_PROCESS, talks=openers.memory_line_talk, line=SERIAL)

_REPLAY = frozenset({"replay"})
_SERIAL = frozenset({"serial"})
_LINES = frozenset({"serial", "robotd"})
_REMOTE = _LINES | {"nserver"}

OPTIONS: tuple[Option, ...] = (
    Option("timeout_s", text.seconds, schemes=_REMOTE),
    Option("model", model_named, schemes=_REMOTE),
    Option("baud", text.baud, schemes=_SERIAL),
    Option("checks", text.flag, schemes=_LINES),
    Option("order", text.one_of(ORDERS), schemes=_REPLAY),
    Option("connection", text.path, schemes=_REPLAY),
    # around the stream, inside out
    Option("record", text.path, stream=wrappers.recorded),
    Option("faults", lambda path: load_plan(Path(text.path(path))), stream=wrappers.faulty),
    # around the backend, inside out
    Option("reconnect", text.seconds_or_none, backend=wrappers.reconnecting, schemes=_REMOTE),
    Option("retries", text.count, backend=wrappers.retrying, schemes=_LINES),
    Option("bumper_stop", text.flag, backend=wrappers.stopped_by_bumpers),
    Option("feed", text.flag),
    Option("tm_s", text.motion_timeout, backend=wrappers.fed),
    Option("max_turn_deg_s", text.speed, backend=wrappers.capped_turn),
    Option("max_speed_in_s", text.speed, backend=wrappers.capped_speed),
)


def opening_of(given: str, wanted: Wanted) -> Opening:
    """An address, understood and not opened. Raises AddressError with the nearest that would be right."""
    address = text.parsed(given)
    scheme = _scheme_named(address)
    readers = {option.name: option.read for option in OPTIONS if option.belongs_to(address.scheme)}
    values = {**scheme.defaults, **address.read(readers, others=scheme.reads_the_rest)}
    if scheme.reads_the_rest:
        values = {"model": model_named(address.options.get("robot", N150.name)), **values}
    return Opening(address, scheme, wanted, OPTIONS, values)


def known_schemes() -> tuple[str, ...]:
    """The address schemes there are."""
    return tuple(sorted({*SCHEMES, *memory.schemes()}))


def _scheme_named(address: Address) -> Scheme:
    if address.scheme in SCHEMES:
        return SCHEMES[address.scheme]
    if address.scheme in memory.schemes():
        return _IN_PROCESS_LINE if address.options.get("line") == "1" else _IN_PROCESS
    known = known_schemes()
    named = address.scheme or address.text.partition("/")[0].lower()
    hint = did_you_mean(named, known, before="", after=":? ")
    names = ", ".join(f"{name}:" for name in known)
    raise AddressError(f"{address.text!r} is no address: {hint}There are {names} {EXAMPLES}")
