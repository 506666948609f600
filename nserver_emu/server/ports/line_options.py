"""The options of `nserver` for robots' own lines, and the lines that they ask for.

    --serial-link PATH[@ROBOT]    --robotd [PORT[@ROBOT]]    --baud RATE

Rules: the k-th line of a kind is robot k's where it names none. Each open line is one line on stdout, for programs.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from nclient.errors import ConnectionLost
from nserver_emu.server.ports.cable import PacedCable
from nserver_emu.server.ports.lines import OwnLine, RobotdConnection, SerialLine, own_line

if TYPE_CHECKING:
    from nserver_emu.server.ports.daemon import Daemon

ROBOTD_PORT: Final = 65001
"""Where a robot on a network answers."""
SLOWEST_BAUD, FASTEST_BAUD = 9600, 4_000_000
_HIGHEST_PORT = 65535


class Wanted(NamedTuple):
    """A line that an option asks for: a path or a port, and whose; None: by its place among those of its kind."""

    place: str
    robot_id: int | None


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of this room."""
    group = parser.add_argument_group("robots' own lines")
    group.add_argument("--serial-link", action="append", type=_link, default=[], metavar="PATH[@ROBOT]",
                       help="a robot's own serial line: a pseudo-terminal, and PATH a symbolic link to it; once more "
                       "for robot 2, and so on; clients find it at serial://PATH?model=MODEL")
    group.add_argument("--robotd", action="append", type=_port, nargs="?", const=Wanted(str(ROBOTD_PORT), None),
                       default=[], metavar="PORT[@ROBOT]",
                       help=f"the same over TCP (default {ROBOTD_PORT}; 0 takes a free port); clients find it at "
                       "robotd://HOST:PORT?model=MODEL")
    group.add_argument("--baud", type=_baud, metavar="RATE",
                       help="let serial lines be as slow as a real one, 38400 for a Nomad's (default: no time at all)")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Wrong usage that only several options together show."""
    if options.baud is not None and not options.serial_link:
        parser.error("--baud is the rate of serial lines, and there is none: add --serial-link PATH")


async def open_lines(daemon: Daemon, options: argparse.Namespace) -> list[str]:
    """Open the lines; what to print of each. Raises AddressError or ConnectionLost, naming the remedy."""
    host = options.bind
    ports = [await _open_robotd(daemon, own, host, int(port)) for own, port in _lines(daemon, options.robotd)]
    paths = [_open_serial(daemon, own, path, options.baud) for own, path in _lines(daemon, options.serial_link)]
    return [f"listening robotd {port}" for port in ports] + [f"listening serial {path}" for path in paths]


def at_port(host: str, port: int) -> str:
    """HOST:PORT, as addresses have it."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _lines(daemon: Daemon, wanted: list[Wanted]) -> list[tuple[OwnLine, str]]:
    return [
        (own_line(daemon, number if robot_id is None else robot_id), place)
        for number, (place, robot_id) in enumerate(wanted, start=1)
    ]


async def _open_robotd(daemon: Daemon, own: OwnLine, host: str, port: int) -> str:
    place = at_port(host, await daemon.open_door(lambda: RobotdConnection(daemon, own), host, port, "--robotd"))
    _note(daemon, f"robotd:{own.robot_id}", place)
    return place


def _open_serial(daemon: Daemon, own: OwnLine, path: str, baud: int | None) -> str:
    try:
        from nserver_emu.server.ports.pseudo_terminal import PseudoTerminal
    except ImportError:
        raise ConnectionLost(f"no serial link {path}: this system has no pseudo-terminals; use --robotd") from None
    SerialLine(daemon, own, PseudoTerminal(Path(path)), None if baud is None else lambda: PacedCable(baud))
    _note(daemon, f"serial:{own.robot_id}", path)
    return path


def _note(daemon: Daemon, line: str, place: str) -> None:
    """Where a line of a robot is; where it has several of a kind they count as one, and all are told."""
    daemon.places[line] = ", ".join(filter(None, (daemon.places.get(line), place)))


def _link(text: str) -> Wanted:
    wanted = _split(text)
    if not wanted.place:
        raise argparse.ArgumentTypeError("a path such as /tmp/nomad, or /tmp/nomad@2 for robot 2")
    if wanted.robot_id is None and "@" in Path(wanted.place).name:
        raise argparse.ArgumentTypeError(f"after @ comes the number of a robot, PATH@2, not {text!r}")
    return wanted


def _port(text: str) -> Wanted:
    wanted = _split(text)
    if not wanted.place.isdecimal() or int(wanted.place) > _HIGHEST_PORT:
        raise argparse.ArgumentTypeError(
            f"a port is 0 to {_HIGHEST_PORT}, or PORT@ROBOT, not {text!r}; the world goes before --robotd"
        )
    return wanted


def _split(text: str) -> Wanted:
    """PATH@2 names robot 2."""
    numbered = re.fullmatch(r"(.*)@(\d+)", text)
    return Wanted(numbered[1], int(numbered[2])) if numbered else Wanted(text, None)


def _baud(text: str) -> int:
    if not text.isdecimal() or not SLOWEST_BAUD <= int(text) <= FASTEST_BAUD:
        raise argparse.ArgumentTypeError(f"a rate is {SLOWEST_BAUD} to {FASTEST_BAUD} bits a second, not {text!r}")
    return int(text)
