"""`nserver`: the command line of the daemon. Reads options, builds the simulation, hands both to the daemon.

Rules: one line on stdout that a program can read, `listening nserver HOST:PORT`; everything else goes to stderr.
Exit codes: 0 stopped as asked, 1 could not start (the reason on stderr), 2 wrong usage.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import re
import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import TypeVar

from nclient.errors import NomadError
from nserver_emu.server.daemon import LOOPBACK, Daemon, stop_on_signals
from nserver_emu.server.handlers import Emulator
from nserver_emu.server.setting import DEFAULT_WORLD, READY_MODELS, Setting, pose_from_text
from worlds.files import load_world, world_names

Number = TypeVar("Number", int, float)
DEFAULT_PORT = 7019
MAX_SPEED = "max"
SLOWEST, FASTEST = 0.1, 100.0


def main(argv: list[str] | None = None) -> int:
    """Run the daemon until SIGINT or SIGTERM; the exit code."""
    options = _parser().parse_args([_as_value(word) for word in (sys.argv[1:] if argv is None else argv)])
    logging.basicConfig(
        level=logging.DEBUG if options.verbose > 1 else logging.INFO if options.verbose else logging.WARNING,
        format="%(asctime)s %(levelname)s %(message)s",
        stream=sys.stderr,
    )
    try:
        if options.list_worlds:
            _list_worlds()
            return 0
        return asyncio.run(_serve(options))
    except NomadError as error:
        print(f"nserver: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0


async def _serve(options: argparse.Namespace) -> int:
    start = pose_from_text(options.start) if options.start else None
    setting = Setting(options.world, options.robot, start, options.seed, options.noisy)
    daemon = Daemon(Emulator(setting.simulation()), options.speed)
    stop = asyncio.Event()
    stop_on_signals(stop)
    port = await daemon.listen(options.bind, options.port)
    host = f"[{options.bind}]" if ":" in options.bind else options.bind
    print(f"listening nserver {host}:{port}", flush=True)
    await daemon.serve(stop)
    return 0


def _list_worlds() -> None:
    for name in world_names():
        print(f"{name:16} {load_world(name).title}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nserver",
        description="An Nserver for Nomad robots: a simulated robot that old and new client programs connect to.",
        epilog="example: nserver thesis_room --noisy --seed 1 --start 0,0,0,0",
    )
    parser.add_argument("world", nargs="?", default=DEFAULT_WORLD, metavar="WORLD",
                        help=f"a shipped world or a TOML file (default: {DEFAULT_WORLD}; see --list-worlds)")
    parser.add_argument("--port", type=_port, default=DEFAULT_PORT, help=f"default {DEFAULT_PORT}; 0 takes a free one")
    parser.add_argument("--bind", type=_host, default=LOOPBACK, metavar="HOST",
                        help=f"address to listen on (default {LOOPBACK}; the protocol has no authentication)")
    parser.add_argument("--robot", default=READY_MODELS[0], choices=READY_MODELS, help="the robot's model")
    parser.add_argument("--start", metavar="X,Y,STEER,TURRET", help="start pose in inches and degrees")
    parser.add_argument("--seed", type=_seed, default=0, help="seed of all noise (default 0)")
    parser.add_argument("--speed", type=_speed, default=1.0, metavar="X",
                        help=f"simulated seconds a second, {SLOWEST} to {FASTEST:.0f}, or {MAX_SPEED} (default 1)")
    parser.add_argument("--noisy", action="store_true", help="noise on motion and sonars, and ramps (default: ideal)")
    parser.add_argument("--list-worlds", action="store_true", help="name the shipped worlds and stop")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more on stderr (-vv: everything)")
    parser.add_argument("--version", action="version", version=f"nserver {version('nomad-nserver')}")
    return parser


def _as_value(word: str) -> str:
    """Coordinates such as -5,3 are a value: argparse takes what begins with a minus and is no number for an option."""
    return f" {word}" if re.match(r"-[\d.][^,]*,", word) else word


def _speed(text: str) -> float | None:
    if text == MAX_SPEED:
        return None
    return _number(text, float, (SLOWEST, FASTEST), f"a speed is {SLOWEST} to {FASTEST:.0f}, or {MAX_SPEED}")


def _port(text: str) -> int:
    return _number(text, int, (0, 65535), "a port is 0 to 65535")


def _seed(text: str) -> int:
    return _number(text, int, (0, 2**31 - 1), "a seed is 0 to 2147483647")


def _host(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError(f"an address or a host name, such as {LOOPBACK}, or 0.0.0.0 for all")
    return text


def _number(text: str, kind: Callable[[str], Number], bounds: tuple[float, float], wanted: str) -> Number:
    try:
        number = kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{wanted}, not {text!r}") from None
    if not bounds[0] <= number <= bounds[1]:
        raise argparse.ArgumentTypeError(f"{wanted}, not {text}")
    return number
