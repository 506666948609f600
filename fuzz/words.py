"""Readers of what people type: lines of `nomad shell`, addresses, who may connect, where a robot starts.

Rules: text is taken as typed, in UTF-8; an address is understood and nothing is opened but simulations.
"""

from __future__ import annotations

import argparse
import functools

from fuzz.mutating import bytes_changed, either, words_changed
from fuzz.reader import Reader
from nclient.cli.shell_help import OWN
from nclient.cli.shell_session import Session
from nclient.common import allowlist
from nclient.connect import open_backend
from nclient.errors import AddressError, FaultPlanError, ShellError, StartError, WireError, WorldFileError
from nclient.protocol.commands import COMMANDS
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
def _session(address: str) -> Session:
    """A shell's session; what it is only to check never reaches its robot."""
    return Session(open_backend(address), lambda _: None, pid=1)


def _shell(data: bytes) -> None:
    line = data[1:].decode("utf-8", "replace")
    _session(("sim:several_walls", "sim:several_walls?line=1")[data[0] & 1 if data else 0]).check(line)


def _address(data: bytes) -> None:
    parse_address(data.decode("utf-8", "replace"))


def _simulation(data: bytes) -> None:
    open_address("sim:" + data.decode("utf-8", "replace").removeprefix("sim:"))


@functools.cache
def _allowing() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(exit_on_error=False)
    allowlist.add_options(parser)
    return parser


def _network(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    allowlist.is_loopback(text)
    allowed = allowlist.access_of(_allowing().parse_args([f"--allow={text}"]))
    allowed.admits("192.168.1.7")
    allowlist.warning("0.0.0.0", allowed)


def _coded(lines: tuple[str, ...], head: bytes = b"") -> list[bytes]:
    return [head + line.encode() for line in lines]


_SAID = tuple(name.encode() for name in (*(row.name for row in COMMANDS), *OWN))
_QUERY = (b"&", b"?", b"=", b"%00", b"%", b"//", b":", b"@", b"[", b"]", b"#", b"+", b";")
_OPTION = tuple(f"&{option.name}=".encode() for option in OPTIONS)
_SIMULATED = (b"&robots=", b"&start=", b"&seed=", b"&step_s=", b"&setup=", b"&model_file=", b"&line=", b",", b"robot=")

READERS = (
    Reader("shell_lines", "lines of nomad shell", _shell, (ShellError, WireError),
           lambda: [*_coded(_SHELL, b"\0"), *_coded(_SHELL, b"\1")],
           either(words_changed(*_SAID, b"{", b"}", b"(", b")", b";", b"Smask[", b"]", b"=", b"#", b"State", b'"'),
                  bytes_changed), longest=1024),
    Reader("addresses", "addresses of robots", _address, (AddressError, FaultPlanError), lambda: _coded(_ADDRESSES),
           either(words_changed(*_QUERY, *_OPTION), bytes_changed), longest=1024),
    Reader("simulations", "addresses of simulations, opened", _simulation, (AddressError, WorldFileError, StartError),
           lambda: _coded(_SIMULATIONS), either(words_changed(*_QUERY, *_SIMULATED), bytes_changed), longest=1024),
    Reader("networks", "who may connect", _network, (argparse.ArgumentError,), lambda: _coded(_NETWORKS),
           either(words_changed(b".", b":", b"/", b"%", b"::"), bytes_changed), longest=64),
)  # fmt: skip
