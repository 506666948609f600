"""Readers of text typed by users: lines of `nomad shell`, addresses, allowed networks, start poses.

The text is UTF-8. Addresses are parsed, and only simulations are opened.
"""

from __future__ import annotations

import argparse
import functools

from fuzz.mutation import any_of, mutate_bytes, word_mutator
from fuzz.reader import Reader
from nclient.cli.shell_session import BUILTINS, Session
from nclient.connector import open_backend
from nclient.errors import AddressError, FaultPlanError, ShellError, StartError, WireError, WorldFileError
from nclient.protocol.commands import COMMANDS
from nclient.transports import listener
from nclient.url import OPTIONS, parse_address
from nserver_emu.server.inprocess import open_address

_SHELL = (
    "pr 240 0 0; wait", "vm(10, -20, 0)", "ct", "Smask[17] = 0", "State[34]", "Laser", "help vm", 'tk "hello there"',
    "conf_sn 15 {0, 2, 255}", "sleep 0.5 # a comment", "motion_check 0 1.5 2 3 4", "special_request 50 1 2 3",
    "state pose sonar", "add_obstacle 3 0 0 100 0 100 100", "place_robot 0 0 900 900", "zr; ws 1 1 1 20; quit",
)  # fmt: skip
_ADDRESSES = (
    "nserver://localhost:7019/1?timeout_s=2&model=scout", "serial:///dev/ttyUSB0?model=n150&baud=38400&checks=0",
    "robotd://[::1]:65001?model=n200&reconnect=5&retries=2", "sim:thesis_room?robot=n150&seed=1&noisy=1",
    "replay:run.log?order=loose&connection=1", "sim:thesis_room?line=1&bumper_stop=1&tm_s=5&max_speed_in_s=3.5",
)  # fmt: skip
_SIMULATIONS = (
    "sim:several_walls?robot=scout&seed=7&step_s=0.5", "sim:?robots=2&start=10,10,90,0&start=40,40",
    "sim:thesis_room?setup=worn&noisy=no", "sim:thesis_room?robot=n200&line=1", "sim:x.toml?model_file=y.toml",
)  # fmt: skip
_NETWORKS = ("192.168.1.0/24", "10.0.0.1", "::1", "fe80::1%eth0", "::ffff:127.0.0.1", "2001:db8::/32", "localhost")


@functools.cache
def _shell_session(address: str) -> Session:
    """Return a shell session; lines are only checked and not sent to its robot."""
    return Session(open_backend(address), lambda _: None, pid=1)


def _shell(data: bytes) -> None:
    line = data[1:].decode("utf-8", "replace")
    _shell_session(("sim:several_walls", "sim:several_walls?line=1")[data[0] & 1 if data else 0]).check(line)


def _address(data: bytes) -> None:
    parse_address(data.decode("utf-8", "replace"))


def _simulation(data: bytes) -> None:
    open_address("sim:" + data.decode("utf-8", "replace").removeprefix("sim:"))


@functools.cache
def _allow_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(exit_on_error=False)
    listener.add_options(parser)
    return parser


def _network(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    listener.is_loopback(text)
    allowed = listener.allowlist_from_options(_allow_parser().parse_args([f"--allow={text}"]))
    allowed.allows("192.168.1.7")
    listener.warning("0.0.0.0", allowed)


def _encode(lines: tuple[str, ...], head: bytes = b"") -> list[bytes]:
    return [head + line.encode() for line in lines]


_COMMAND_WORDS = tuple(name.encode() for name in (*(row.name for row in COMMANDS), *BUILTINS))
_SHELL_SYNTAX = (b"{", b"}", b"(", b")", b";", b"Smask[", b"]", b"=", b"#", b"State", b'"')
_QUERY = (b"&", b"?", b"=", b"%00", b"%", b"//", b":", b"@", b"[", b"]", b"#", b"+", b";")
_OPTION = tuple(f"&{name}=".encode() for name in OPTIONS)
_SIMULATION_OPTIONS = (b"&robots=", b"&start=", b"&seed=", b"&step_s=", b"&setup=", b"&model_file=", b"&line=", b",",
                       b"robot=")  # fmt: skip

READERS = (
    Reader("shell_lines", "lines of nomad shell", _shell, (ShellError, WireError),
           lambda: [*_encode(_SHELL, b"\0"), *_encode(_SHELL, b"\1")],
           any_of(word_mutator(*_COMMAND_WORDS, *_SHELL_SYNTAX), mutate_bytes), max_size=1024),
    Reader("addresses", "addresses of robots", _address, (AddressError, FaultPlanError), lambda: _encode(_ADDRESSES),
           any_of(word_mutator(*_QUERY, *_OPTION), mutate_bytes), max_size=1024),
    Reader("simulations", "addresses of simulations, opened", _simulation, (AddressError, WorldFileError, StartError),
           lambda: _encode(_SIMULATIONS), any_of(word_mutator(*_QUERY, *_SIMULATION_OPTIONS), mutate_bytes),
           max_size=1024),
    Reader("networks", "allowed networks", _network, (argparse.ArgumentError,), lambda: _encode(_NETWORKS),
           any_of(word_mutator(b".", b":", b"/", b"%", b"::"), mutate_bytes), max_size=64),
)  # fmt: skip
