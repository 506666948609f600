"""`nserver`: the command line of the daemon. Reads options, builds the simulation, and runs the daemon.

    nserver [options] [WORLD] [robot.setup] [world.setup]       the original's -help -noisy -port n work as well
    nserver ctl COMMAND                                         sends a command to a running daemon (control/cli.py)
    nserver help [ctl]                                          help on either

Programs read `listening KIND ADDRESS` lines from stdout; everything else goes to stderr. Exit codes are those of
nclient.common.process.
"""

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from textwrap import indent

import numpy as np

from nclient.common import process
from nclient.common.allowlist import allowlist_from_options, warning
from nclient.common.arguments import Parser
from nclient.common.process import ExitCode
from nclient.errors import NomadError, SnapshotError
from nclient.recording.format import read_recording
from nserver_emu import logs
from nserver_emu.control import cli, snapshot
from nserver_emu.control.recording import RunHeader, replay
from nserver_emu.control.save_options import SaveFile, autosaved, resolve_restore
from nserver_emu.control.socket import controlled, may_have_faults
from nserver_emu.gateway import run as real_options
from nserver_emu.gateway.gateway import Gateway, RealRobotProxy
from nserver_emu.gateway.run import connected, model_of, run_gateway
from nserver_emu.options import DEFAULT_PORT, nserver_parser, read_options
from nserver_emu.ros.options import running_ros
from nserver_emu.server.admission import RESERVED_CONNECTIONS, AdmissionControl
from nserver_emu.server.config import MODEL_NAMES, SimulationConfig, robot_placements
from nserver_emu.server.connection import MAX_REQUESTS_PER_TURN
from nserver_emu.server.daemon import Daemon, ignore_signals, rare_collection, restored_signals, stop_on_signals
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.legacy_setup import LegacySetup, read_setups
from nserver_emu.server.limits import limits_of, make_room
from nserver_emu.server.link import FaultController
from nserver_emu.server.serial_lines import at_port, open_lines
from nserver_emu.server.server_state import Allowed, SimulationClock
from nserver_emu.service import STOPPING, ServiceManager, announced
from nserver_emu.simulation.acoustics import FIRST_ECHO, Polaroid
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.visibility import NEAREST_OBSTACLE, load_compiled
from nserver_emu.viewer.classroom import read_class
from nserver_emu.viewer.options import running_viewer
from worlds.cells import braille_picture
from worlds.io import load_world, world_names

log = logging.getLogger(__name__)

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


async def _serve_with(
    proxies: Mapping[int, RealRobotProxy], setups: LegacySetup, options: argparse.Namespace, faults: FaultController
) -> int:
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
    limits = limits_of(options)
    pages = limits.page_connections * sum(map(bool, (options.viewer, options.rosbridge)))
    room = make_room(limits.connections + RESERVED_CONNECTIONS + pages)
    limits = replace(limits, connections=min(limits.connections, room))
    daemon.admission = AdmissionControl(limits, allowlist_from_options(options))
    daemon.places |= real_options.line_addresses(options)
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
            daemon.record(options.record, run_header.to_json(_now(), **numbers))
        await _run(daemon, gateway, options, stop, file)
    finally:
        await daemon.close()
        ignore_signals()
    return ExitCode.DONE


async def _run(
    daemon: Daemon, gateway: Gateway, options: argparse.Namespace, stop: asyncio.Event, file: SaveFile | None
) -> None:
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
    setting = SimulationConfig(
        options.world, model, start, options.seed, options.noisy, options.setup or "", tuple(others), options.model_file
    )
    pace = SimulationClock(options.speed, options.paused, options.lockstep)
    limits = limits_of(options)
    allowed = Allowed(options.allow_quit, options.allow_control, limits.obstacles, limits.graphics, limits.frame)
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


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


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
