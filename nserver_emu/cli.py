"""`nserver`: the command line of the daemon. Reads options, builds the simulation, and runs the daemon.

    nserver [options] [WORLD] [robot.setup] [world.setup]       the original's -help -noisy -port n work as well
    nserver ctl COMMAND                                         sends a command to a running daemon (control/cli.py)
    nserver help [ctl]                                          help on either

Programs read `listening KIND ADDRESS` lines from stdout; everything else goes to stderr. Exit codes are those of
nclient.common.process.

Options of `nserver`, the original's spelling of some of them, and the checks for wrong usage.

    read_options(parser, words) ──> options; or an error message and exit code 2

Files are only checked for existence here. Options of a package are defined in the package (`add_options`).

Notification of a service manager, as sd_notify(3) specifies it: datagrams to NOTIFY_SOCKET.

    READY=1      all ports are open             WATCHDOG=1    the event loop runs; sent twice within WATCHDOG_USEC
    STOPPING=1   the daemon ends                nothing       where no service manager started the daemon

The watchdog message comes from the event loop that serves the clients, so that a blocked loop is detected. Notification
never waits and never fails the daemon: what the manager does not accept, because its queue is full or it restarts, is
sent again later. This is logged once, until it accepts messages again.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from textwrap import indent
from typing import Final

import numpy as np

from nclient.common import arguments, process
from nclient.common.arguments import Parser, add_flag, add_version, number, protect_coordinates, whole_number
from nclient.common.process import ExitCode
from nclient.errors import NomadError, SnapshotError, suggest
from nclient.recording.format import read_recording
from nclient.transports import listener
from nclient.transports.listener import LOOPBACK, allowlist_from_options, warning
from nserver_emu import logs
from nserver_emu.control import cli, snapshot
from nserver_emu.control import commands as control_options
from nserver_emu.control import recording as restore_options
from nserver_emu.control.commands import MAX_SPEED, controlled, may_have_faults
from nserver_emu.control.recording import RunHeader, SaveFile, autosaved, replay, resolve_restore
from nserver_emu.gateway import run as real_options
from nserver_emu.gateway.gateway import Gateway, RealRobotProxy
from nserver_emu.gateway.run import connected, model_of, run_gateway
from nserver_emu.ros import options as ros_options
from nserver_emu.ros.options import running_ros
from nserver_emu.server import admission, config, serial_lines
from nserver_emu.server.admission import RESERVED_CONNECTIONS, AdmissionControl, at_port, limits_of, make_room
from nserver_emu.server.config import MODEL_NAMES, SimulationConfig, read_setups, robot_placements
from nserver_emu.server.connection import MAX_REQUESTS_PER_TURN, end_task
from nserver_emu.server.daemon import Daemon, ignore_signals, rare_collection, restored_signals, stop_on_signals
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_lines import open_lines
from nserver_emu.server.serial_session import FaultController
from nserver_emu.server.server_state import MAX_LOCKSTEP_S, MAX_TIME_FACTOR, MIN_TIME_FACTOR, Allowed, SimulationClock
from nserver_emu.simulation.acoustics import FIRST_ECHO, Polaroid
from nserver_emu.simulation.noise import NOISY, SETUPS, SUFFIX
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.visibility import NEAREST_OBSTACLE, load_compiled
from nserver_emu.viewer import options as viewer_options
from nserver_emu.viewer.classroom import WORLD as CLASS_WORLD
from nserver_emu.viewer.classroom import read_class
from nserver_emu.viewer.options import running_viewer
from worlds.cells import braille_picture
from worlds.io import DEFAULT_WORLD, load_world, world_names

# The port that clients of the original use by default.
DEFAULT_PORT = 7019
SETUP_SUFFIX = ".setup"
# robot.setup and world.setup.
MAX_SETUPS = 2
OLD_OPTIONS = ("help", "noisy", "port")
"""Options that the original accepted after a single dash, abbreviated to any number of letters."""


def nserver_parser(*, with_files: bool = True) -> Parser:
    """Return the parser with all options, and with the files that `nserver` takes as arguments or without them."""
    parser = Parser(
        prog="nserver",
        description="An Nserver for Nomad robots: a simulated robot that old and new client programs connect to.",
        epilog="example: nserver thesis_room --noisy --seed 1 --start 0,0,0,0; "
        "nserver ctl --help: commands for a running daemon",
    )
    if with_files:
        parser.add_argument("files", nargs="*", metavar="WORLD | SETUP",
                            help=f"a shipped world or a TOML file (default: {DEFAULT_WORLD}; see --list-worlds); and "
                            "the original's robot.setup and world.setup, of which the documented keys are read")
    parser.add_argument("--port", type=whole_number("a port", 0, 65535),
                        help=f"TCP port to listen on (default: {DEFAULT_PORT}; 0 takes a free one)")
    parser.add_argument("--bind", type=_host, default=LOOPBACK, metavar="HOST",
                        help=f"address to listen on (default: {LOOPBACK}; the protocol has no authentication)")
    _add_robots(parser)
    _add_time(parser)
    _add_persistence(parser)
    _add_setup(parser)
    # Packages add their own options, in the order of --help.
    for package in (serial_lines, real_options, control_options, listener, admission, viewer_options, ros_options):
        package.add_options(parser)
    add_flag(parser, "--list-worlds", "list the shipped worlds and exit")
    logs.add_options(parser)
    add_version(parser)
    return parser


def _add_robots(parser: Parser) -> None:
    parser.add_argument("--robot", action="append", metavar="MODEL",
                        help=f"the robot's model: {', '.join(MODEL_NAMES)} or one of --model-file (default: "
                        f"{MODEL_NAMES[0]}); repeatable, for robot 2 and so on")
    count = whole_number("the number of robots", 1, config.MAX_ROBOTS)
    parser.add_argument("--robots", type=count, default=1, metavar="N",
                        help="number of robots (default: 1), numbered 1 to N; clients find the second at nserver://HOST/2")
    parser.add_argument("--model-file", type=Path, metavar="FILE",
                        help="read a TOML file of models that override or extend the built-in ones")
    parser.add_argument("--start", action="append", metavar="X,Y,STEER,TURRET",
                        help="set the start pose in inches and degrees; repeatable, for robot 2 and so on")
    parser.add_argument("--seed", type=whole_number("a seed", 0, 2**31 - 1), default=0,
                        help="set the seed of all noise (default: 0)")


def _add_time(parser: Parser) -> None:
    parser.add_argument("--speed", type=_speed, default=1.0, metavar="X",
                        help=f"run at X simulated seconds per second: {MIN_TIME_FACTOR} to {MAX_TIME_FACTOR:.0f}, or "
                        f"{MAX_SPEED} (default: 1)")
    add_flag(parser, "--paused", "start with simulated time paused, until a client resumes it")
    step = number(f"a step is more than 0 and at most {MAX_LOCKSTEP_S:.0f} s", arguments.ABOVE_ZERO, MAX_LOCKSTEP_S)
    parser.add_argument("--lockstep", type=step, metavar="DT",
                        help="advance simulated time by DT seconds per client request, and only then")
    add_flag(parser, "--allow-control", "allow clients to pause, step and speed up simulated time")
    add_flag(parser, "--allow-quit", "allow clients to end the server")


def _add_persistence(parser: Parser) -> None:
    parser.add_argument("--restore", type=Path, metavar="FILE",
                        help="continue a saved simulation with its world, robots, seed and setup, at its pace unless "
                        "--speed, --paused or --lockstep is given; with --save of the same file start a new one if the "
                        "file does not exist")
    restore_options.add_options(parser)
    parser.add_argument("--record", type=Path, metavar="FILE",
                        help="record all traffic to FILE, with everything --replay needs")
    parser.add_argument("--replay", type=Path, metavar="FILE",
                        help="repeat the requests of a recording, compare every byte of the replies, and exit; world, "
                        "robots, seed and setup are the recording's")


def _add_setup(parser: Parser) -> None:
    parser.add_argument("--setup", type=_setup, metavar="KIND | FILE.toml",
                        help="select the noise: ideal (default), noisy (ramps, noise of motion and sonars), measured "
                        "(acoustics of a Polaroid ring, compass error), worn (systematic wheel errors); or a file "
                        "based on one of them, such as the two lines: base = \"measured\", sonar.dead = [3, 11] (all "
                        "keys are in docs/setups.md)")
    add_flag(parser, "--noisy", "the same as --setup noisy")


def read_options(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """Parse the words; add `world`, the old setup files (`setups`) and `keeps_pace` to the options."""
    # 1. Old spellings and coordinates, then argparse.
    words = [protect_coordinates(as_long_option(word)) for word in words]
    options: argparse.Namespace = parser.parse_args(words)
    # 2. Positional words: a world and the original's setup files.
    default_world = CLASS_WORLD if options.class_file else DEFAULT_WORLD
    options.world, options.setups = _sorted_files(parser, options.files, default_world)
    # 3. Combinations that argparse cannot express.
    _refuse_unknown_models(parser, options)
    _refuse_contradictions(parser, options, words)
    serial_lines.refuse(parser, options)
    real_options.refuse(parser, options)
    viewer_options.refuse(parser, options)
    ros_options.refuse(parser, options)
    restore_options.check_options(parser, options, words)
    # 4. With --restore the saved pace applies unless an option of time was given.
    options.keeps_pace = restore_options.keeps_pace(parser, words)
    return options


def _refuse_unknown_models(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Report a model that neither the built-in ones nor a model file can have."""
    for name in options.robot or ():
        if options.model_file is None and name.lower() not in MODEL_NAMES:
            hint = suggest(name.lower(), MODEL_NAMES)
            parser.error(f"argument --robot: no model {name!r}; there are {', '.join(MODEL_NAMES)}{hint}")


def _refuse_contradictions(parser: argparse.ArgumentParser, options: argparse.Namespace, words: list[str]) -> None:
    """Report options that would be ignored beside another."""
    if options.noisy and options.setup not in (None, NOISY.name):
        parser.error(f"argument --noisy: it is --setup {NOISY.name}, and --setup says {options.setup}: leave one out")
    if options.lockstep and restore_options.given_options(parser, words, ["speed"]):
        parser.error("argument --speed: in lockstep time passes with each request: leave --speed or --lockstep out")


def as_long_option(word: str) -> str:
    """Return the long form of an abbreviated option of the original, such as -noisy or -p."""
    # Only letters after one dash; -v and other short options are the beginning of no old name.
    letters = word[1:]
    if not word.startswith("-") or not letters.isalpha():
        return word
    return next((f"--{name}" for name in OLD_OPTIONS if name.startswith(letters)), word)


def _sorted_files(parser: argparse.ArgumentParser, files: list[str], default: str) -> tuple[str, list[Path]]:
    """Return the world and the old setup files: those with their suffix, or that exist and are no TOML."""
    setups = [name for name in files if _is_setup(name)]
    worlds = [name for name in files if not _is_setup(name)]
    if len(worlds) > 1 or len(setups) > MAX_SETUPS:
        parser.error(f"one world and two setup files at most, not {' '.join(files)}")
    return (worlds[0] if worlds else default), [Path(name) for name in setups]


def _is_setup(name: str) -> bool:
    path = Path(name)
    # A file of any name is a setup if it exists, and is neither TOML nor the name of a shipped world.
    return path.suffix == SETUP_SUFFIX or (name not in world_names() and path.suffix != ".toml" and path.is_file())


def _speed(text: str) -> float | None:
    if text == MAX_SPEED:
        return None
    expected = f"a speed is {MIN_TIME_FACTOR} to {MAX_TIME_FACTOR:.0f}, or {MAX_SPEED}"
    return number(expected, MIN_TIME_FACTOR, MAX_TIME_FACTOR)(text)


def _setup(text: str) -> str:
    """Return the name of a setup, or of a file, which is read later."""
    if text not in SETUPS and not text.endswith(SUFFIX):
        raise argparse.ArgumentTypeError(f"no setup {text!r}; there are {', '.join(SETUPS)}, and files that end in "
                                         f"{SUFFIX}{suggest(text, SETUPS)}")
    return text


def _host(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError(f"an address or a host name, such as {LOOPBACK}, or 0.0.0.0 for all")
    return text


log = logging.getLogger(__name__)

READY: Final = "READY=1"
STOPPING: Final = "STOPPING=1"
WATCHDOG: Final = "WATCHDOG=1"
_US_PER_S: Final = 1e6
_RETRY_S: Final = 1.0
"""Interval at which unaccepted messages are repeated where there is no watchdog."""


class ServiceManager:
    """The service manager that started the daemon.

    Parameters
    ----------
    environment : NOTIFY_SOCKET, a path or @abstract name; WATCHDOG_USEC, for process WATCHDOG_PID or for all.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        # Environment variables are inherited: only the process that is named has a watchdog.
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        timeout_us = environment.get("WATCHDOG_USEC", "")
        has_watchdog = bool(self._address) and is_for_us and timeout_us.isdecimal()
        self.feed_s = int(timeout_us) / _US_PER_S / 2 if has_watchdog else 0.0
        """Interval of watchdog messages; 0 without a watchdog."""
        self._unsent: list[str] = []
        self._accepts = True

    @property
    def interval_s(self) -> float:
        """Seconds to the next message; 0: none."""
        return self.feed_s or (_RETRY_S if self._unsent else 0.0)

    def feed(self) -> None:
        """Repeat unsent messages, and send the watchdog message."""
        self.notify(*self._unsent, *([WATCHDOG] if self.feed_s else []))

    def notify(self, *messages: str) -> None:
        """Send messages, one per line; unaccepted ones are sent again later, except WATCHDOG."""
        if not self._address:
            return
        # An old watchdog message says nothing about now.
        self._unsent = [message for message in messages if message != WATCHDOG]
        # An abstract socket is written with @ in the variable and with a zero byte in the address.
        address = self._address.replace("@", "\0", 1) if self._address[0] == "@" else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                # A full queue must not block the event loop.
                sender.setblocking(False)
                sender.sendto("\n".join(messages).encode(), address)
        except OSError as error:
            # Logged once per interruption.
            if self._accepts:
                log.warning("the service manager at %s does not listen: %s; trying again", self._address, error)
            self._accepts = False
            return
        if not self._accepts:
            log.warning("the service manager at %s listens again", self._address)
        self._accepts, self._unsent = True, []


@contextlib.asynccontextmanager
async def announced(manager: ServiceManager) -> AsyncIterator[None]:
    """Report that the daemon is ready, and feed the watchdog meanwhile."""
    manager.notify(READY)
    feeding = asyncio.create_task(_feed(manager)) if manager.interval_s else None
    try:
        yield
    finally:
        await end_task(feeding)


async def _feed(manager: ServiceManager) -> None:
    while manager.interval_s:
        manager.feed()
        await asyncio.sleep(manager.interval_s)


CONTROL = "ctl"
"""First word of a command for a running daemon."""
LIST_PICTURE = 48, 12
"""Width and height of the pictures of `--list-worlds`, characters."""
HELP = "help"
"""First word of a request for help."""


def main(argv: list[str] | None = None) -> int:
    """Run the daemon until SIGINT or SIGTERM, or until an authorized client ends it; return the exit code."""
    process.ensure_std_streams()
    # 1. The first word decides: a command for a running daemon, or the daemon itself.
    words = _help_as_option(sys.argv[1:] if argv is None else argv)
    run = _daemon if words[:1] != [CONTROL] else lambda words: cli.main(words[1:])
    # A program that calls this function with arguments continues after it, with its own signal handlers.
    handlers = contextlib.nullcontext() if argv is None else restored_signals()
    try:
        with handlers:
            code = run(words)
        sys.stdout.flush()
    # 2. A reader of stdout that has ended, such as `head`, is no error of the daemon.
    except OSError as error:
        return process.handle_broken_pipe(error, "nserver")
    return code


def _help_as_option(words: list[str]) -> list[str]:
    """Replace `help` by --help; return any other words unchanged."""
    if words[:1] != [HELP]:
        return words
    if words[1:2] not in ([], [CONTROL]):
        nserver_parser().error(f"{HELP} {words[1]}: it is {HELP} alone, or {HELP} {CONTROL}")
    return [*words[1:2], "--help"]


def _daemon(words: list[str]) -> int:
    parser = nserver_parser()
    options = read_options(parser, words)
    try:
        with logs.logging_to_stderr(options):
            resolve_restore(parser, options)
            return _run_command(options)
    except NomadError as error:
        logs.print_failure(options, error)
        return ExitCode.USAGE if error.usage else ExitCode.FAILED
    except KeyboardInterrupt:  # before it serves: afterwards stop_on_signals handles it
        return ExitCode.INTERRUPTED


def _run_command(options: argparse.Namespace) -> int:
    """Do what the options ask for: list worlds, replay a recording, or serve."""
    if options.list_worlds:
        _list_worlds()
        return ExitCode.DONE
    if options.replay:
        return _replay(options.replay)
    return asyncio.run(_serve(options))


async def _serve(options: argparse.Namespace) -> int:
    if options.class_file is not None:
        options.students = read_class(options.class_file)
        options.robots = max(options.robots, *(student.robot for student in options.students))
    setups = read_setups(options.setups)
    for key in setups.unused:
        log.warning("%s of the setup file is read and has no effect: what its numbers mean is not known", key)
    # Real robots are connected before anything else: without them no simulation is started.
    faults = FaultController(time.monotonic)
    with connected(options, faults if may_have_faults(options) else None) as proxies:
        return await _serve_with(proxies, setups, options, faults)


def _prepare_acoustics(simulation: Simulation) -> None:
    """Load or compile the acoustics of measured sonars, or decide that they run in plain Python."""
    is_used = any(isinstance(robot.sonar.model, Polaroid) for robot in simulation.robots.values())
    with process.show_seconds("preparing the sonars; numba compiles them once on a machine"):
        FIRST_ECHO.prepare(is_used)


async def _serve_with(proxies: Mapping[int, RealRobotProxy], setups: config.LegacySetup, options: argparse.Namespace,
                      faults: FaultController) -> int:
    # 1. Simulation: port and model from the options, else from the setup files, else the defaults.
    port = next((port for port in (options.port, setups.port) if port is not None), DEFAULT_PORT)
    run_header = _run_header(options, setups.robot or model_of(proxies) or MODEL_NAMES[0])
    emulator = run_header.create_emulator()
    # Compiled before clients connect: the first ray would otherwise take seconds.
    load_compiled(len(emulator.simulation.robots))
    NEAREST_OBSTACLE.prepare(is_used=False)  # nor later, while clients wait
    _prepare_acoustics(emulator.simulation)
    if emulator.clock.paused and not options.allow_control:
        log.warning("paused, and no client can resume: --allow-control lets them")
    # 2. Daemon, with a gateway between clients and simulation if there are real robots.
    gateway = Gateway(emulator, proxies, shadow=options.shadow, wrap=real_options.speed_limiter(options))
    daemon = Daemon(emulator, emulator.clock.factor, gateway if proxies else emulator, faults)
    admission = limits_of(options)
    pages = admission.page_connections * sum(map(bool, (options.viewer, options.rosbridge)))
    room = make_room(admission.connections + RESERVED_CONNECTIONS + pages)
    admission = replace(admission, connections=min(admission.connections, room))
    daemon.admission = AdmissionControl(admission, allowlist_from_options(options))
    if options.real is not None:
        daemon.places[real_options.LINE] = options.real
    # 3. Signals, before the first port is open.
    stop = asyncio.Event()
    stop_on_signals(stop)
    file = _saved_on_signal(emulator, options.save)
    try:
        # 4. Port and recording; with --port 0 only now the port is known.
        port = await daemon.listen(options.bind, port)
        if open_to := warning(options.bind, daemon.admission.access):
            log.warning("--bind: %s", open_to)
        if options.record:
            numbers = {"port": port, "requests_a_turn": MAX_REQUESTS_PER_TURN, "real_robots": len(proxies)}
            now = datetime.now(UTC).isoformat(timespec="seconds")
            daemon.record(options.record, run_header.to_json(now, **numbers))
        await _run(daemon, gateway, options, stop, file)
    finally:
        await daemon.close()
        ignore_signals()
    return ExitCode.DONE


async def _run(daemon: Daemon, gateway: Gateway, options: argparse.Namespace, stop: asyncio.Event,
               file: SaveFile | None) -> None:
    """Open lines, control socket and page, print their addresses, and serve until the end."""
    # 1. Everything that listens; each closes what it opened: pages and bridges before the gateway, which they drive.
    lines = await open_lines(daemon, options)
    manager = ServiceManager(os.environ)
    async with (
        controlled(daemon, options) as control,
        run_gateway(gateway, daemon, options.shadow_every),
        running_viewer(daemon, options) as page,
        running_ros(daemon, options) as ros,
        autosaved(file, options.autosave),
    ):
        # 2. Programs may connect as soon as they have read these lines.
        own = f"listening nserver {at_port(options.bind, daemon.emulator.port)}"
        for line in (own, *lines, *control, *page, *ros):
            logs.print_line(line)
        # 3. Serve; the service manager is notified when all is open.
        with rare_collection():
            async with announced(manager):
                with contextlib.suppress(asyncio.CancelledError):  # Ctrl-C, where an event loop has no signal handlers
                    await daemon.serve(stop, lambda: _end(manager, file))


def _end(manager: ServiceManager, file: SaveFile | None) -> None:
    manager.notify(STOPPING)
    if file:
        file.save()


def _run_header(options: argparse.Namespace, robot: str) -> RunHeader:
    """Return the configuration of the simulation: from the options, or from a snapshot."""
    # Robot 1 is the first placement, the others follow by number.
    (model, start), *others = robot_placements(options.robot or [robot], options.start or (), options.robots)
    setting = SimulationConfig(options.world, model, start, options.seed, options.noisy, options.setup or "",
                               tuple(others), options.model_file)
    pace = SimulationClock(options.speed, options.paused, options.lockstep)
    admission = limits_of(options)
    allowed = Allowed(
        options.allow_quit, options.allow_control, admission.obstacles, admission.graphics, admission.frame
    )
    return RunHeader(setting, pace, allowed, options.restore, options.keeps_pace)


def _replay(path: Path) -> int:
    """Repeat the requests of a recording on a new emulator; return FAILED if a reply differs."""
    # An incomplete last line is replayed up to there.
    recording = read_recording(path)
    if recording.cut:
        log.warning("--replay: %s", recording.cut)
    outcome = replay(recording)
    print(f"{outcome.answers} answers, {outcome.size} bytes as recorded{', then not' if outcome.difference else ''}")
    if outcome.difference:
        print(f"nserver: {outcome.difference}", file=sys.stderr)
    return ExitCode.FAILED if outcome.difference else ExitCode.DONE


def _saved_on_signal(emulator: Emulator, path: Path | None) -> SaveFile | None:
    """Return the file of --save, if any; SIGUSR1 writes it, on systems with that signal."""
    if path is None:
        return None
    file = SaveFile(emulator, path)
    # Reported at the start rather than when the state is to be saved.
    if path.is_dir():
        raise SnapshotError(f"{path}: is a folder: name a file in it")
    snapshot.require_regular(path)
    if not path.absolute().parent.is_dir():
        log.warning("%s: there is no folder %s, and nothing can be saved until there is", path, path.parent)

    def save() -> None:
        try:
            file.save()
        except SnapshotError as error:
            log.error("not saved: %s", error)

    # Windows has neither SIGUSR1 nor signal handlers of event loops.
    with contextlib.suppress(NotImplementedError, AttributeError):
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, save)
    return file


def _list_worlds() -> None:
    # Braille dots need a terminal or file that can show them.
    has_dots = (sys.stdout.encoding or "").lower().startswith("utf")
    for name in world_names():
        world = load_world(name)
        width_in, height_in = np.ptp(world.walls.reshape(-1, 2), axis=0)
        size = f"{width_in:.0f} x {height_in:.0f} in ({0.0254 * width_in:.3g} x {0.0254 * height_in:.3g} m)"
        starts = "1 start" if len(world.starts) == 1 else f"{len(world.starts)} starts"
        print(f"{name:16} {world.title}\n{'':16} {size}, {len(world.walls)} walls, {starts}")
        if has_dots:
            print(indent(braille_picture(world, *LIST_PICTURE), " " * 17))


def whole_parser() -> Parser:
    """Return the parser with ctl, help and the shipped worlds as subcommands, for shell completion."""
    # Subcommands, because the scripts for zsh complete either subcommands or words.
    parser = nserver_parser(with_files=False)
    first = parser.add_subparsers()
    for name in world_names():
        first.add_parser(name, help=load_world(name).title, parents=[nserver_parser(with_files=False)], add_help=False)
    cli.add_commands(first.add_parser(CONTROL, help="send a command to a running daemon"))
    asking = first.add_parser(HELP, help="show help", add_help=False)
    asking.add_argument("about", nargs="?", choices=[CONTROL])
    return parser
