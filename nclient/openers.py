"""Who is at the other end: for each scheme how its stream is opened, and what is spoken over it.

Rules: functions for the rows of nclient.schemes. What an address says wrong is told before anything is opened.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote

from nclient.backends.base import Backend, LinkStatistics
from nclient.backends.direct import DirectBackend
from nclient.backends.nserver import DEFAULT_TIMEOUT_S, NserverBackend
from nclient.backends.wrappers import Beside
from nclient.errors import AddressError
from nclient.opening import Opening, Wanted
from nclient.protocol.types import N150, Model
from nclient.recording.format import read_recording
from nclient.recording.recorder import HELLO_FIRST, TCP
from nclient.recording.replayer import STRICT, PlayedPeer, Player, script_of
from nclient.transports import memory
from nclient.transports.memory import MemoryStream
from nclient.transports.serial import DEFAULT_BAUD, SerialStream
from nclient.transports.stream import ByteStream
from nclient.transports.tcp import CONNECT_TIMEOUT_S, ROBOT_LINE, TcpStream

DEFAULT_PORT = 7019
DEFAULT_LINE_PORT = 65001
_MAX_ID = 0x7FFFFFFF


def open_nserver(
    stream: ByteStream, wanted: Wanted, model: Model = N150, link: LinkStatistics | None = None
) -> NserverBackend:
    """The conversation with an Nserver at the other end of a stream."""
    robot_id = 1 if wanted.robot_id is None else wanted.robot_id
    timeout_s = DEFAULT_TIMEOUT_S if wanted.timeout_s is None else wanted.timeout_s
    return NserverBackend(
        stream, robot_id=robot_id, model=model, timeout_s=timeout_s, create=wanted.create, link=link
    )


def open_tcp(host: str, port: int, timeout_s: float | None) -> TcpStream:
    """A TCP connection, with the time-out of answers where that is longer than one's patience."""
    return TcpStream(host, port, _patience_s(timeout_s))


def _patience_s(timeout_s: float | None) -> float:
    return max(timeout_s or 0.0, CONNECT_TIMEOUT_S)


def nserver_stream(opening: Opening) -> ByteStream:
    """nserver://host[:port]/id: the id is looked at before anything is opened."""
    parts = opening.address.parts(opening.scheme.form)
    _robot_id(opening)
    port = DEFAULT_PORT if parts.port is None else parts.port
    return open_tcp(parts.hostname or "localhost", port, opening.timeout_s)


def nserver_talk(stream: ByteStream, opening: Opening) -> Backend:
    """Counted only where it may be opened anew, which is to be counted."""
    wanted = Wanted(opening.timeout_s, _robot_id(opening), opening.wanted.create)
    return open_nserver(stream, wanted, opening.model, opening.link if opening.values.get("reconnect") else None)


def _robot_id(opening: Opening) -> int:
    """The program's number or the address's. Raises AddressError where there are both and they differ: neither wins,
    or a robot would move that nobody meant."""
    asked, named = opening.wanted.robot_id, _named_id(opening)
    if asked is not None and named is not None and asked != named:
        raise AddressError(
            f"{opening.address.text!r} names robot {named}, the program asks for robot {asked}: let both say the same, "
            "or leave the number out of the address"
        )
    return asked if asked is not None else named or 1


def _named_id(opening: Opening) -> int | None:
    parts = opening.address.parts(opening.scheme.form)
    number = parts.path.strip("/")
    if not number and not parts.fragment:
        return None
    if not (number.isascii() and number.isdecimal()) or not 1 <= int(number) <= _MAX_ID or parts.fragment:
        raise AddressError(
            f"{opening.address.text!r}: what follows the host is the robot's number, 1 or more, not {parts.path!r}"
        )
    return int(number)


def serial_stream(opening: Opening) -> ByteStream:
    """serial:///dev/ttyUSB0"""
    parts = opening.address.parts(opening.scheme.form)
    if parts.netloc or not parts.path.strip("/") or parts.fragment:
        raise AddressError(f"{opening.address.text!r}: three slashes and a port follow: {opening.scheme.form}")
    return SerialStream(unquote(parts.path), opening.values.get("baud", DEFAULT_BAUD))


def robotd_stream(opening: Opening) -> ByteStream:
    """robotd://host[:port]"""
    parts = opening.address.parts(opening.scheme.form)
    if parts.path.strip("/") or not parts.hostname or parts.fragment:
        raise AddressError(f"{opening.address.text!r}: a host and its port follow: {opening.scheme.form}")
    port = DEFAULT_LINE_PORT if parts.port is None else parts.port
    return TcpStream(parts.hostname, port, _patience_s(opening.timeout_s), served_by=ROBOT_LINE)


def line_talk(stream: ByteStream, opening: Opening) -> Backend:
    """A robot on its own line."""
    return _direct(stream, opening, hello=opening.scheme.line == HELLO_FIRST)


def line_talk_without_hello(stream: ByteStream, opening: Opening) -> Backend:
    """The same where something was said already: the hello is over, and ct says the mask."""
    return _direct(stream, opening, hello=False)


def _direct(stream: ByteStream, opening: Opening, *, hello: bool) -> Backend:
    return DirectBackend(
        stream,
        opening.model,
        hello=hello and opening.model.sends_mask,
        timeout_s=opening.timeout_s,
        checks=opening.values.get("checks", True),
        link=opening.link,
    )


def memory_stream(opening: Opening) -> ByteStream:
    """scheme:anything; the opener reads it, without the options that are the client's."""
    opened = opening.kept["memory"] = memory.open_in_process(opening.address.scheme, opening.foreign_text)
    return opened


def memory_line_talk(stream: ByteStream, opening: Opening) -> Backend:
    """scheme:anything?line=1: a robot on its own line, and beside it the simulation, for what no robot knows."""
    simulation = open_nserver(opening.kept["memory"].beside(), opening.wanted, opening.model)
    return Beside(_direct(stream, opening, hello=False), simulation)


def memory_talk(stream: ByteStream, opening: Opening) -> Backend:
    return open_nserver(stream, opening.wanted, opening.model)


def replay_stream(opening: Opening) -> ByteStream:
    """replay:FILE: the connection asked for, else the first, then the next each time that it is opened anew."""
    path = unquote(opening.address.text.partition(":")[2].partition("?")[0])
    if not path:
        raise AddressError(f"{opening.address.text!r}: the name of a recording follows: {opening.scheme.form}")
    recording = opening.kept.setdefault("recording", None) or read_recording(Path(path))
    names, opened = recording.connections(), opening.kept.get("opened", 0)
    name = opening.values.get("connection") or (names[min(opened, len(names) - 1)] if names else "")
    script = script_of(recording, name)
    opening.kept |= {"recording": recording, "opened": opened + 1, "script": script}
    opening.values = {"model": script.model, **opening.values}
    return MemoryStream(PlayedPeer(Player(script, opening.values.get("order", STRICT))))


def replay_talk(stream: ByteStream, opening: Opening) -> Backend:
    """In the language that was recorded."""
    script = opening.kept["script"]
    if script.line != TCP:
        return _direct(stream, opening, hello=script.line == HELLO_FIRST)
    return open_nserver(stream, Wanted(opening.timeout_s, script.robot_id), script.model)
