"""`nserver`: the command line of the daemon. Reads options, builds the simulation, hands both to the daemon.

    nserver [options] [WORLD] [robot.setup] [world.setup]       the original's -help -noisy -port n work as well
    nserver ctl COMMAND                                         says one thing to a daemon that runs (ctl.py)

Rules: one line on stdout that a program can read, `listening nserver HOST:PORT`; everything else goes to stderr.
Exit codes are those of nclient.exit_codes.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

from nclient.arguments import Parser
from nclient.errors import NomadError, SnapshotError
from nclient.exit_codes import ExitCode
from nclient.recording.log import read_recording
from nclient.suggesting import did_you_mean
from nserver_emu import ctl, logs
from nserver_emu.garbage import seldom_sought
from nserver_emu.gateway import options as real_options
from nserver_emu.gateway.gateway import Gateway
from nserver_emu.gateway.keeping import kept
from nserver_emu.gateway.options import model_of, reached
from nserver_emu.gateway.side import RealSide
from nserver_emu.server import autosave, restore_options
from nserver_emu.server.access import access_of, warning
from nserver_emu.server.access import add_options as add_access_options
from nserver_emu.server.autosave import SaveFile, autosaved
from nserver_emu.server.control import BY_NAME
from nserver_emu.server.control_options import add_options as add_control_options
from nserver_emu.server.control_options import controlled, may_have_faults
from nserver_emu.server.daemon import LOOPBACK, Daemon, stop_on_signals
from nserver_emu.server.door import Door
from nserver_emu.server.fault_desk import FaultDesk
from nserver_emu.server.limits import add_options as add_limit_options
from nserver_emu.server.limits import limits_of
from nserver_emu.server.line_options import add_options as add_line_options
from nserver_emu.server.line_options import at_port, open_lines
from nserver_emu.server.line_options import refuse as refuse_lines
from nserver_emu.server.pace import FASTEST, LONGEST_LOCKSTEP_S, SLOWEST, Pace
from nserver_emu.server.recording import Beginning, header
from nserver_emu.server.replay import replay
from nserver_emu.server.setting import DEFAULT_WORLD, MOST_ROBOTS, READY_MODELS, Setting, placed
from nserver_emu.server.setup_files import OldSetup, read_setups
from nserver_emu.server.stage import Allowed
from nserver_emu.server.talker import REQUESTS_A_TURN
from nserver_emu.service import STOPPING, Manager, announced
from nserver_emu.simulation.setup import SETUPS
from nserver_emu.simulation.setup_toml import SUFFIX
from nserver_emu.viewer.options import add_options as add_viewer_options
from nserver_emu.viewer.options import refuse as refuse_viewer
from nserver_emu.viewer.options import viewed
from worlds.compiled import load_for
from worlds.files import load_world, world_names

log = logging.getLogger(__name__)

Number = TypeVar("Number", int, float)
DEFAULT_PORT = 7019
MAX_SPEED = "max"
CONTROL = "ctl"
"""Instead of options: what follows is for a daemon that runs (ctl.py)."""
SETUP_SUFFIX = ".setup"
MOST_SETUPS = 2
OLD_OPTIONS = ("help", "noisy", "port")
"""What the original took after a single dash, by as few first letters as one likes."""


def main(argv: list[str] | None = None) -> int:
    """Run the daemon until SIGINT or SIGTERM, or until a client that may ends it; the exit code."""
    parser = _parser()
    words = sys.argv[1:] if argv is None else argv
    if words[:1] == [CONTROL]:
        return ctl.main(words[1:])
    words = [_as_value(_as_long_option(word)) for word in words]
    options = parser.parse_args(words)
    options.world, options.setups = _sorted_files(parser, options.files)
    _refuse_unknown_models(parser, options)
    refuse_lines(parser, options)
    real_options.refuse(parser, options)
    refuse_viewer(parser, options)
    restore_options.refuse(parser, options, words)
    autosave.refuse(parser, options)
    options.keeps_pace = restore_options.keeps_pace(parser, words)
    logs.begin(options)
    restore_options.settle(parser, options)
    try:
        if options.list_worlds:
            _list_worlds()
            return ExitCode.DONE
        if options.replay:
            return _replay(options.replay)
        return asyncio.run(_serve(options))
    except NomadError as error:
        logs.tell_failure(options, error)
        return ExitCode.FAILED
    except KeyboardInterrupt:
        return ExitCode.DONE


async def _serve(options: argparse.Namespace) -> int:
    setups = read_setups(options.setups)
    for key in setups.unused:
        log.warning("%s of the setup file is read and has no effect: what its numbers mean is not known", key)
    faults = FaultDesk(time.monotonic)
    with reached(options, faults if may_have_faults(options) else None) as sides:
        return await _serve_with(sides, setups, options, faults)


async def _serve_with(
    sides: Mapping[int, RealSide], setups: OldSetup, options: argparse.Namespace, faults: FaultDesk
) -> int:
    port = next((port for port in (options.port, setups.port) if port is not None), DEFAULT_PORT)
    beginning = _beginning(options, setups.robot or model_of(sides) or READY_MODELS[0])
    emulator = beginning.emulator()
    load_for(len(emulator.simulation.robots))
    if emulator.pace.paused and not options.allow_control:
        log.warning("paused, and no client can resume: --allow-control lets them")
    gateway = Gateway(emulator, sides, shadow=options.shadow, around=real_options.around(options))
    daemon = Daemon(emulator, emulator.pace.factor, gateway, faults)
    daemon.door = Door(limits_of(options), access_of(options))
    daemon.places |= real_options.places(options)
    stop = asyncio.Event()
    stop_on_signals(stop)
    file = SaveFile(emulator, options.save) if options.save else None
    if file:
        _save_on_signal(file)
    try:
        port = await daemon.listen(options.bind, port)
        if open_to := warning(options.bind, daemon.door.access):
            log.warning("%s", open_to)
        if options.record:
            numbers = {"port": port, "requests_a_turn": REQUESTS_A_TURN, "real_robots": len(sides)}
            daemon.record(options.record, header(beginning, _now(), **numbers))
        lines = await open_lines(daemon, options)
        async with (
            controlled(daemon, options) as control,
            viewed(daemon, options) as page,
            kept(gateway, daemon, options.shadow_every),
            autosaved(file, options.autosave),
        ):
            for line in (f"listening nserver {at_port(options.bind, port)}", *lines, *control, *page):
                logs.tell(line)
            manager = Manager(os.environ)
            with seldom_sought():
                async with announced(manager):
                    await daemon.serve(stop, lambda: _end(manager, file))
    finally:
        await daemon.close()
    return ExitCode.DONE


def _end(manager: Manager, file: SaveFile | None) -> None:
    manager.tell(STOPPING)
    if file:
        file.save()


def _refuse_unknown_models(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Wrong usage, where no file could know the model."""
    for name in options.robot or ():
        if options.model_file is None and name.lower() not in READY_MODELS:
            hint = did_you_mean(name.lower(), READY_MODELS)
            parser.error(f"argument --robot: no model {name!r}; there are {', '.join(READY_MODELS)}{hint}")


def _beginning(options: argparse.Namespace, robot: str) -> Beginning:
    """The simulation as the options say, or as a snapshot has it."""
    (model, start), *others = placed(options.robot or [robot], options.start or (), options.robots)
    setting = Setting(
        options.world, model, start, options.seed, options.noisy, options.setup or "", tuple(others), options.model_file
    )
    pace = Pace(options.speed, options.paused, options.lockstep)
    limits = limits_of(options)
    allowed = Allowed(options.allow_quit, options.allow_control, limits.obstacles, limits.graphics, limits.frame)
    return Beginning(setting, pace, allowed, options.restore, options.keeps_pace)


def _replay(path: Path) -> int:
    """Ask a fresh emulator what a recording asked; FAILED where it says something else."""
    recording = read_recording(path)
    if recording.cut:
        log.warning("%s", recording.cut)
    outcome = replay(recording)
    print(f"{outcome.answers} answers, {outcome.size} bytes as recorded{', then not' if outcome.difference else ''}")
    if outcome.difference:
        print(f"nserver: {outcome.difference}", file=sys.stderr)
    return ExitCode.FAILED if outcome.difference else ExitCode.DONE


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _save_on_signal(file: SaveFile) -> None:
    """SIGUSR1 saves the simulation as it is, where the system has that signal."""

    def save() -> None:
        try:
            file.save()
        except SnapshotError as error:
            log.error("not saved: %s", error)

    with contextlib.suppress(NotImplementedError, AttributeError):
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, save)


def _list_worlds() -> None:
    for name in world_names():
        print(f"{name:16} {load_world(name).title}")


def whole_parser() -> Parser:
    """The parser, with what `nserver ctl` takes: for completion."""
    parser = _parser()
    parser.followers[CONTROL] = tuple(dict.fromkeys(word for name in BY_NAME for word in name.split()))
    return parser


def _parser() -> Parser:
    parser = Parser(
        prog="nserver",
        description="An Nserver for Nomad robots: a simulated robot that old and new client programs connect to.",
        epilog="example: nserver thesis_room --noisy --seed 1 --start 0,0,0,0; "
        "nserver ctl --help: what can be said to one that runs",
    )
    parser.add_argument("files", nargs="*", metavar="WORLD | SETUP",
                        help=f"a shipped world or a TOML file (default: {DEFAULT_WORLD}; see --list-worlds); and the "
                        "original's robot.setup and world.setup, read for the keys that are known")
    parser.add_argument("--port", type=_port, help=f"default {DEFAULT_PORT}; 0 takes a free one")
    parser.add_argument("--bind", type=_host, default=LOOPBACK, metavar="HOST",
                        help=f"address to listen on (default {LOOPBACK}; the protocol has no authentication)")
    parser.add_argument("--robot", action="append", metavar="MODEL",
                        help=f"the robot's model: {', '.join(READY_MODELS)} or one of --model-file (default "
                        f"{READY_MODELS[0]}); once more for robot 2, and so on")
    parser.add_argument("--robots", type=_robot_count, default=1, metavar="N",
                        help="how many robots, numbers 1 to N; clients find the second at nserver://HOST/2")
    parser.add_argument("--model-file", type=Path, metavar="FILE",
                        help="a TOML file of models that override or add to the known ones")
    parser.add_argument("--start", action="append", metavar="X,Y,STEER,TURRET",
                        help="start pose in inches and degrees; once more for robot 2, and so on")
    parser.add_argument("--seed", type=_seed, default=0, help="seed of all noise (default 0)")
    parser.add_argument("--speed", type=_speed, default=1.0, metavar="X",
                        help=f"simulated seconds a second, {SLOWEST} to {FASTEST:.0f}, or {MAX_SPEED} (default 1)")
    parser.add_argument("--paused", action="store_true", help="let time stand until a client resumes it")
    parser.add_argument("--lockstep", type=_lockstep, metavar="DT",
                        help="let DT simulated seconds pass when a client asks something, and none else")
    parser.add_argument("--allow-control", action="store_true", help="let clients pause, step and speed up the time")
    parser.add_argument("--allow-quit", action="store_true", help="let clients end the server")
    parser.add_argument("--restore", type=Path, metavar="FILE", help="go on where a saved simulation was, at the pace "
                        "that it had unless --speed, --paused or --lockstep say another; world, robots, seed and setup "
                        "are its own; with --save of the same file it begins anew where that is not there yet")
    autosave.add_options(parser)
    parser.add_argument("--record", type=Path, metavar="FILE",
                        help="write down all that is said, with what it takes to have it said again")
    parser.add_argument("--replay", type=Path, metavar="FILE",
                        help="ask what a recording asked once more, compare every byte, and stop")
    parser.add_argument("--setup", type=_setup, metavar="NAME | FILE.toml",
                        help="how real: ideal (default), noisy (ramps, noise of motion and sonars), measured (sonars "
                        "like a Polaroid ring, compass errs too), worn (wheels that err the same way every time); or a "
                        "file made from one of them, such as the two lines: base = \"measured\", sonar.dead = [3, 11] "
                        "(every key is in docs/setups.md)")
    parser.add_argument("--noisy", action="store_true", help="the same as --setup noisy")
    add_line_options(parser)
    real_options.add_options(parser)
    add_control_options(parser)
    add_access_options(parser)
    add_limit_options(parser)
    add_viewer_options(parser)
    parser.add_argument("--list-worlds", action="store_true", help="name the shipped worlds and stop")
    logs.add_options(parser)
    parser.add_argument("--version", action="version", version=f"nserver {version('nomad-nserver')}")
    return parser


def _as_long_option(word: str) -> str:
    """-noisy, -p: an option of the original by its first letters, as the long one that it is now."""
    letters = word[1:]
    if not word.startswith("-") or not letters.isalpha():
        return word
    return next((f"--{name}" for name in OLD_OPTIONS if name.startswith(letters)), word)


def _sorted_files(parser: argparse.ArgumentParser, files: list[str]) -> tuple[str, list[Path]]:
    """The world among the files, and the old setup files: those that are called so, or are there and no TOML."""
    setups = [name for name in files if _is_setup(name)]
    worlds = [name for name in files if not _is_setup(name)]
    if len(worlds) > 1 or len(setups) > MOST_SETUPS:
        parser.error(f"one world and two setup files at most, not {' '.join(files)}")
    return (worlds[0] if worlds else DEFAULT_WORLD), [Path(name) for name in setups]


def _is_setup(name: str) -> bool:
    path = Path(name)
    return path.suffix == SETUP_SUFFIX or (name not in world_names() and path.suffix != ".toml" and path.is_file())


def _as_value(word: str) -> str:
    """Coordinates such as -5,3 are a value: argparse takes what begins with a minus and is no number for an option."""
    return f" {word}" if re.match(r"-[\d.][^,]*,", word) else word


def _speed(text: str) -> float | None:
    if text == MAX_SPEED:
        return None
    return _number(text, float, (SLOWEST, FASTEST), f"a speed is {SLOWEST} to {FASTEST:.0f}, or {MAX_SPEED}")


def _lockstep(text: str) -> float:
    step_s = float(text)
    if not 0.0 < step_s <= LONGEST_LOCKSTEP_S:
        raise argparse.ArgumentTypeError(f"a step is more than 0 and at most {LONGEST_LOCKSTEP_S:.0f} s")
    return step_s


def _robot_count(text: str) -> int:
    return _number(text, int, (1, MOST_ROBOTS), f"robots are 1 to {MOST_ROBOTS}")


def _port(text: str) -> int:
    return _number(text, int, (0, 65535), "a port is 0 to 65535")


def _seed(text: str) -> int:
    return _number(text, int, (0, 2**31 - 1), "a seed is 0 to 2147483647")


def _setup(text: str) -> str:
    """The name of a setup, or a file, which is read later."""
    if text not in SETUPS and not text.endswith(SUFFIX):
        raise argparse.ArgumentTypeError(
            f"no setup {text!r}; there are {', '.join(SETUPS)}, and files that end in {SUFFIX}"
            f"{did_you_mean(text, SETUPS)}"
        )
    return text


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
