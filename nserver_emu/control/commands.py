"""The control socket of a server: its commands, the socket, and the options for both.

    {"command": "speed", "argument": "10"}   ->   {"ok": true, "said": {...}}   or   {"ok": false, "error": "..."}

One JSON object per line, in each direction. Only the owner of the server can open the socket, so there are no further
permissions. An invalid request is answered with what is valid, and changes nothing.

Commands are a table, and a function for each; they do no I/O except for `save`. The socket has mode 0600 before the
first client can connect. A socket left by a server that has ended is replaced; the socket of a running server, and
files that are no sockets, are not touched. It is removed when the server ends.

The options of `nserver` for injected faults and for control at run time: --faults FILE, --control [PATH].
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import logging
import math
import os
import socket
import stat
import sys
import tempfile
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from nclient.errors import ConnectionLost, ControlError, NomadError, suggest, version
from nclient.faults.inject import total
from nclient.faults.plan import MAX_BYTES, load_plan, parse_plan, plan_text
from nclient.transports.listener import before_world
from nserver_emu.control import snapshot
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers import runtime_settings
from nserver_emu.server.handlers.table import MAX_STEP_MS
from nserver_emu.server.serial_session import FaultController
from nserver_emu.server.server_state import MAX_TIME_FACTOR, MIN_TIME_FACTOR
from worlds.world import World

log = logging.getLogger(__name__)

MAX_SPEED: Final = "max"
WORLD_SET: Final = "world set"
# Time after which a thread that computes lets the event loop run; and Python's own default.
SWITCH_INTERVAL_S, DEFAULT_SWITCH_INTERVAL_S = 0.0005, 0.005
# The operator in an emergency stop.
OPERATOR: Final = "nserver ctl"
JsonObject = dict[str, Any]


@dataclass(frozen=True, slots=True)
class ControlCommand:
    """A command."""

    name: str
    # Name of the argument: empty for none, in brackets if optional.
    argument: str
    about: str
    run: Callable[[Daemon, Any], JsonObject]

    @property
    def requires_argument(self) -> bool:
        """True if the argument is required."""
        return bool(self.argument) and not self.argument.startswith("[")


def answer_line(server: Daemon, line: bytes) -> bytes:
    """Return the response line to a request line."""
    try:
        answer = {"ok": True, "said": _execute(server, line)}
    except NomadError as error:
        answer = {"ok": False, "error": str(error)}
    return json.dumps(answer).encode() + b"\n"


async def answer_line_in_thread(server: Daemon, line: bytes) -> bytes:
    """Return the response line as `answer_line` does, and prepare a new world outside of the event loop."""
    try:
        name, argument = _request(line)
        if name != WORLD_SET:
            return answer_line(server, line)
        text, file = _world_text(argument)
        world = None
        if text not in server.emulator.exported_worlds:
            with _short_switch_interval():
                world = await asyncio.to_thread(runtime_settings.read_world_file, text, file)
        answer = {"ok": True, "said": _put_world(server, argument, world)}
    except NomadError as error:
        answer = {"ok": False, "error": str(error)}
    return json.dumps(answer).encode() + b"\n"


@contextlib.contextmanager
def _short_switch_interval() -> Iterator[None]:
    """Let the event loop run within SWITCH_INTERVAL_S while a thread computes."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, SWITCH_INTERVAL_S))
    try:
        yield
    finally:
        sys.setswitchinterval(max(before, DEFAULT_SWITCH_INTERVAL_S))


def _request(line: bytes) -> tuple[object, object]:
    """Return command and argument of a request line."""
    try:
        request = json.loads(line)
        return request["command"], request.get("argument")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ControlError('a request is a line such as {"command": "speed", "argument": "10"}') from None


def _execute(server: Daemon, line: bytes) -> JsonObject:
    name, argument = _request(line)
    # A name of another type would not be hashable.
    row = BY_NAME.get(name) if isinstance(name, str) else None
    if row is None:
        raise ControlError(f"no command {name!r}; there are {', '.join(BY_NAME)}{suggest(str(name), BY_NAME)}")
    if row.requires_argument and argument is None:
        raise ControlError(f"{row.name} requires {row.argument}")
    return row.run(server, argument)


def status(server: Daemon, _: object = None) -> JsonObject:
    """Return time, world, actual poses of robots, lines, clients and faults."""
    emulator, clock = server.emulator, server.emulator.clock
    simulation = emulator.simulation
    # Poses are rounded: they are for display, not for evaluation.
    return {
        "version": version(), "world": simulation.world.name, "seed": simulation.seed,
        "time_s": round(simulation.time_s, 6), "speed": MAX_SPEED if clock.factor is None else clock.factor,
        "paused": clock.paused, "lockstep_s": clock.lockstep_s,
        "robots": [
            {
                "number": number, "model": robot.model.name, "moving": any(robot.moving), "bumpers": robot.bumpers,
                "x_in": round(robot.actual.x_in, 3), "y_in": round(robot.actual.y_in, 3),
                "steering_deg": round(math.degrees(robot.actual.steering_rad), 2),
                "turret_deg": round(math.degrees(robot.actual.turret_rad), 2),
                "noise": runtime_settings.noise_of(robot),
                "held": None if (hold := emulator.estop.get(number)) is None else hold.as_dict(),
            }
            for number, robot in simulation.robots.items()
        ],
        "lines": dict(server.lines()),
        "connections": server.connected_clients(),
        "faults": {"rules": len(server.faults.plan.rules), "struck": _injected(server.faults)},
    }  # fmt: skip


def _injected(faults: FaultController) -> dict[str, int]:
    totals: Counter[str] = Counter()
    for rules in faults.counts().values():
        totals.update(total(rules))
    return {kind: count for kind, count in totals.items() if count}


# Simulated time.


def _set_paused(server: Daemon, _: object, *, is_paused: bool) -> JsonObject:
    server.emulator.clock.paused = is_paused
    return _time(server)


def _speed(server: Daemon, argument: object) -> JsonObject:
    if server.emulator.clock.lockstep_s is not None:
        raise ControlError("speed: in lockstep time advances with requests only; start nserver without --lockstep")
    if argument == MAX_SPEED:
        server.emulator.clock.factor = None
    else:
        usage = f"speed: {MAX_SPEED}, or a number"
        server.emulator.clock.factor = _number(argument, MIN_TIME_FACTOR, MAX_TIME_FACTOR, usage)
    return _time(server)


def _step(server: Daemon, argument: object) -> JsonObject:
    server.step(_number(argument, 0.0, MAX_STEP_MS / 1000, "step: seconds"))
    return _time(server)


def _time(server: Daemon) -> JsonObject:
    # State[0] shows the speed, and a recording must contain the change.
    server.emulator.invalidate_state_cache()
    server.record_clock()
    everything = status(server)
    return {key: everything[key] for key in ("time_s", "speed", "paused", "lockstep_s")}


# Emergency stop.


def _stop(server: Daemon, argument: object) -> JsonObject:
    server.hold(_robots(server, argument, "stop"), OPERATOR)
    return {"held": server.emulator.estop.as_dict()}


def _release(server: Daemon, argument: object) -> JsonObject:
    server.release(_robots(server, argument, "release"))
    return {"held": server.emulator.estop.as_dict()}


def _robots(server: Daemon, argument: object, command: str) -> list[int]:
    """Return the robot of a number, all robots if there is no argument."""
    robot_ids = list(server.emulator.simulation.robots)
    if argument is None:
        return robot_ids
    number = int(argument) if isinstance(argument, str) and argument.isdecimal() else argument
    if not isinstance(number, int) or number not in robot_ids:
        raise ControlError(f"{command}: no robot {argument}; there are {', '.join(map(str, robot_ids))}")
    return [number]


def _save(server: Daemon, argument: object) -> JsonObject:
    path = Path(_text(argument, "save: the name of a file"))
    snapshot.save(server.emulator, path)
    return {"saved": str(path)}


# Fault plans.


def _show(server: Daemon, _: object) -> JsonObject:
    return {"plan": plan_text(server.faults.plan)}


def _set(server: Daemon, argument: object) -> JsonObject:
    """Put a plan in force; the argument is its text and the name of its file for error messages."""
    usage = "faults set: the text of a plan, and the name of its file"
    if not isinstance(argument, dict):
        raise ControlError(f'{usage}: {{"text": ..., "file": ...}}')
    plan = parse_plan(_text(argument.get("text"), usage), str(argument.get("file", "plan")))
    server.faults.put(plan, server.lines())
    log.info("faults: %d rules in force", len(plan.rules))
    return {"rules": len(plan.rules)}


def _clear(server: Daemon, _: object) -> JsonObject:
    counts = server.faults.counts()
    server.faults.clear()
    return {"counts": counts}


def _counts(server: Daemon, _: object) -> JsonObject:
    return {"counts": server.faults.counts()}


def _reset(server: Daemon, _: object) -> JsonObject:
    counts = server.faults.counts()
    server.faults.reset()
    return {"counts": counts}


def _help(_served: Daemon, _: object) -> JsonObject:
    return {"commands": {row.name: [row.argument, row.about] for row in COMMANDS}}


# Noise, world, obstacles.


def _noise(server: Daemon, argument: object) -> JsonObject:
    change = runtime_settings.noise_words(argument) if isinstance(argument, str) else argument
    if not isinstance(change, dict):
        raise ControlError(f"noise: a text or an object, not {argument!r}")
    result = {"noise": runtime_settings.switch_noise(server.emulator, change)}
    server.record_change({"noise": change})
    return result


def _show_world(server: Daemon, _: object) -> JsonObject:
    text = runtime_settings.show_world(server.emulator)
    server.record_change({"shown": True})
    return {"text": text}


def _put_world(server: Daemon, argument: object, world: World | None = None) -> JsonObject:
    """Replace the world by that of a text; `world` is what was read from it already."""
    text, file = _world_text(argument)
    places = {"places": True} if isinstance(argument, dict) and argument.get("places") is True else {}
    world = runtime_settings.put_world(server.emulator, text, file, world, **places)
    server.record_change({"world": {"text": text, "file": file, **places}})
    return {"world": world.name}


def _world_text(argument: object) -> tuple[str, str]:
    """Return text and file name of `world set`."""
    usage = f"{WORLD_SET}: the text of a world file, and its name"
    if not isinstance(argument, dict):
        raise ControlError(f'{usage}: {{"text": ..., "file": ...}}')
    return _text(argument.get("text"), usage), _text(argument.get("file", "world.toml"), usage)


def _change_of(kind: str, usage: str,
               words: Callable[[str], JsonObject] | None = None) -> Callable[[Daemon, object], JsonObject]:
    """Return the command that makes and records a change, given as JSON or, where `words` parses them, in words."""

    def run(server: Daemon, argument: object) -> JsonObject:
        if words is not None and isinstance(argument, str) and not argument.lstrip().startswith("{"):
            argument = words(argument)
        wanted = _json_object(argument, usage)
        result = runtime_settings.CHANGES[kind](server.emulator, wanted)
        server.record_change({kind: wanted})
        return result

    return run


# Arguments.


def _json_object(argument: object, usage: str) -> JsonObject:
    """Return an argument that is an object, or the text of one."""
    try:
        change = json.loads(argument) if isinstance(argument, str) else argument
    except (ValueError, RecursionError):
        change = None
    if not isinstance(change, dict):
        raise ControlError(f"{usage}, not {argument!r:.200}")
    return change


def _number(argument: object, low: float, high: float, usage: str) -> float:
    try:
        value = float(argument) if isinstance(argument, int | float | str) and argument is not True else math.nan
    except (ValueError, OverflowError):
        value = math.nan
    if not low <= value <= high:
        raise ControlError(f"{usage} from {low:g} to {high:g}, not {argument!r:.60}")
    return value


def _text(argument: object, usage: str) -> str:
    if not isinstance(argument, str):
        raise ControlError(f"{usage}, not {argument!r}")
    return argument


COMMANDS: Final = (
    ControlCommand("status", "", "show time, robots, lines, clients, faults", status),
    ControlCommand("faults show", "", "show the fault plan in force, as TOML", _show),
    ControlCommand("faults set", "FILE", "put a fault plan in force, with all counts at 0", _set),
    ControlCommand("faults clear", "", "remove the fault plan", _clear),
    ControlCommand("faults counts", "", "show the number of injected faults by line and rule", _counts),
    ControlCommand("faults reset", "", "show the counts and set them to 0", _reset),
    ControlCommand("noise", "WORDS", "set noise models: 'sensors=measured motion=ideal robot=1'", _noise),
    ControlCommand("world show", "", "show the current world, as TOML", _show_world),
    ControlCommand(WORLD_SET, "WORLD", "replace the world; robots keep their poses", _put_world),
    ControlCommand("obstacle", "JSON", "move (by, to), remove or add (put) an obstacle",
                   _change_of("obstacle", runtime_settings.OBSTACLE_USAGE)),
    ControlCommand("wall", "JSON", "move (by, to), label (name), remove or add (put) an inner wall",
                   _change_of("wall", runtime_settings.WALL_USAGE)),
    ControlCommand("door", "WORDS", "open or close a door: 'kitchen open'; or add, move, remove one, as JSON",
                   _change_of("door", runtime_settings.DOOR_USAGE, runtime_settings.door_words)),
    ControlCommand("walker", "JSON", "add (put), move (by, to) or remove a person who walks along a route",
                   _change_of("walker", runtime_settings.WALKER_USAGE)),
    ControlCommand("pause", "", "pause simulated time", partial(_set_paused, is_paused=True)),
    ControlCommand("resume", "", "resume simulated time", partial(_set_paused, is_paused=False)),
    ControlCommand("speed", "X", f"set simulated seconds per second, or {MAX_SPEED}", _speed),
    ControlCommand("step", "SECONDS", "advance simulated time at once", _step),
    ControlCommand("stop", "[ROBOT]", "stop a robot, or all, and ignore motion commands until it is released", _stop),
    ControlCommand("release", "[ROBOT]", "release a robot, or all", _release),
    ControlCommand("save", "FILE", "save the simulation", _save),
    ControlCommand("help", "", "show the commands", _help),
)
BY_NAME: Final = {row.name: row for row in COMMANDS}


NAME: Final = "nserver.sock"
# Modes of the socket and of its folder.
OWNER_ONLY, OWNERS_FOLDER = 0o600, 0o700
# Longer than the longest fault plan as JSON.
MAX_LINE: Final = 8 * MAX_BYTES


def default_path(environment: Mapping[str, str]) -> Path:
    """Return the default path: in the user's runtime folder, else in a folder of theirs in /tmp."""
    runtime = environment.get("XDG_RUNTIME_DIR", "")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / NAME
    return Path(tempfile.gettempdir()) / f"nserver-{os.getuid()}" / NAME


class ControlSocket:
    """A listening control socket; `answer` returns the response to a request line."""

    def __init__(self, path: Path, answer: Callable[[bytes], Awaitable[bytes]]) -> None:
        self.path = path
        self._answer = answer
        self._server: asyncio.Server | None = None
        # Device and inode of the socket, to remove no other file at its path.
        self._identity: tuple[int, int] | None = None
        self._clients: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Listen. Raise ConnectionLost with a remedy."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _prepare(self.path)
            listener.bind(str(self.path))
            self.path.chmod(OWNER_ONLY)
            self._server = await asyncio.start_unix_server(self._serve, sock=listener, limit=MAX_LINE)
        except OSError as error:
            listener.close()
            if isinstance(error, ConnectionLost):
                raise
            raise _cannot(self.path, error.strerror or str(error)) from error
        self._identity = _identity(self.path)

    def close(self) -> None:
        """Stop listening and remove the socket, unless another has replaced it."""
        for client in self._clients:
            client.cancel()
        if self._server is None:
            return
        self._server.close()
        if self._identity is not None and _identity(self.path) == self._identity:
            self.path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._clients.add(task)
        try:
            await self._answer_lines(reader, writer)
        except (ConnectionError, ValueError) as error:  # ValueError: a line beyond MAX_LINE
            log.warning("control: closed: %s", error)
        except Exception:
            log.exception("control: internal error; connection closed")
        finally:
            self._clients.discard(task)
            writer.close()

    async def _answer_lines(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            log.debug("control: %s", line[:200])
            writer.write(await self._answer(line))
            await writer.drain()


def _prepare(path: Path) -> None:
    """Create the folder and remove a socket without a server. Raise ConnectionLost if something else is there."""
    # 1. The default folder in /tmp must be the user's own.
    if path.name == NAME:
        with contextlib.suppress(FileExistsError):
            path.parent.mkdir(mode=OWNERS_FOLDER)
        _check_folder(path)
    # 2. Nothing there, or a socket without a server.
    if not path.exists() and not path.is_symlink():
        return
    if not stat.S_ISSOCK(path.stat().st_mode):
        raise _cannot(path, "it exists and is no socket")
    if _has_server(path):
        raise _cannot(path, "another nserver listens there")
    path.unlink()


def _check_folder(path: Path) -> None:
    """Raise ConnectionLost unless the folder of a socket is the user's own; in /tmp no other user may write to it."""
    status, is_shared = path.parent.lstat(), path.parent.parent == Path(tempfile.gettempdir())
    if stat.S_ISLNK(status.st_mode) and is_shared:
        raise _cannot(path, "its folder is a symbolic link")
    if path.parent.stat().st_uid != os.getuid() or status.st_uid != os.getuid():
        raise _cannot(path, "its folder is another user's")
    if is_shared and status.st_mode & 0o022:
        raise _cannot(path, "other users may write to its folder")


def _has_server(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        try:
            client.connect(str(path))
        except ConnectionRefusedError:
            return False
    return True


def _cannot(path: Path, reason: str) -> ConnectionLost:
    return ConnectionLost(f"cannot open the control socket {path}: {reason}; choose another with --control PATH")


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.lstat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


_SUFFIX: Final = ".sock"
# The value of --control without a path: the default path.
_DEFAULT: Final = Path()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    group = parser.add_argument_group("faults and control")
    group.add_argument("--faults", type=Path, metavar="FILE",
                       help="inject faults by this plan (TOML): bytes lost, late, corrupted or refused, by line")
    group.add_argument("--control", type=before_world("--control", socket_path), nargs="?", const=_DEFAULT,
                       metavar="PATH", help="listen for `nserver ctl` on a Unix socket that only you can open "
                       "(default: in your runtime folder)")


def may_have_faults(options: argparse.Namespace) -> bool:
    """Return True if a fault plan can come into force."""
    return options.faults is not None or options.control is not None


@asynccontextmanager
async def controlled(daemon: Daemon, options: argparse.Namespace) -> AsyncIterator[list[str]]:
    """Load the fault plan and open the control socket; yield the lines to print.

    Raises FaultPlanError or ConnectionLost, with a remedy.
    """
    if options.faults:
        daemon.faults.put(load_plan(options.faults), daemon.lines())
    if options.control is None:
        yield []
        return
    path = default_path(os.environ) if options.control == _DEFAULT else options.control
    control = ControlSocket(path, lambda line: answer_line_in_thread(daemon, line))
    await control.open()
    try:
        yield [f"listening control {control.path}"]
    finally:
        control.close()


def socket_path(text: str) -> Path:
    """Parse the path after --control of the daemon and of `nserver ctl`."""
    # Without a slash or suffix it is a world or a command that follows an option without a path.
    if "/" not in text and not text.endswith(_SUFFIX):
        wanted = f"a path with a slash or ending in {_SUFFIX}, such as ./nserver{_SUFFIX}"
        raise argparse.ArgumentTypeError(f"{wanted}, not {text!r}")
    return Path(text)
