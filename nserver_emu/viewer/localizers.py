"""Localizers started from the page: for each robot at most one process of `nomad localize`.

    page ──localize──> Localizers.start ──> process ──POST /publish──> all pages
    page <──localizers── starting, running, ended or failed, and the process's own words

The process is an ordinary client: it connects to the robot at the daemon's port and publishes to the page like a
localizer started in a terminal. It ends when a page stops it, when it is replaced, or with the daemon. The map is the
world at the time of the start; pages are informed when the world is another one. The page's address contains its token,
so the process gets it in its environment, which only its owner can read, and not on its command line.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import tempfile
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from nclient.common.process import NOMAD
from nclient.errors import suggest
from nserver_emu.server.daemon import Daemon
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.viewer.http_port import to_loopback
from nserver_emu.viewer.messages import InvalidMessage, LocalizationMethod
from worlds.io import format_world
from worlds.world import StartPose, World

log = logging.getLogger(__name__)

METHODS: Final[tuple[str, ...]] = get_args(LocalizationMethod)
PUBLISH_VARIABLE: Final = "NOMAD_PUBLISH"
"""Environment variable that is the default of `nomad localize --publish` (localization/cli/arguments.py)."""
TIME_LIMIT_S: Final = 1e9
"""A localizer of the page runs until it is stopped."""
WORN_SCALE_STD: Final = "0.05,0.05,0.003"
"""--scale-std for a robot with wheel errors: distance scale, turn scale, drift in rad/in."""
END_S: Final = 2.0
"""Time to end after SIGTERM, then SIGKILL."""
MAX_LOCALIZERS: Final = 50
"""Processes at once: as many as pages by default. Each has some 100 MB."""
MAX_KNOWN_POSES: Final = 100
MAX_LINES: Final = 20
MAX_LINE_BYTES: Final = 2**20
MAX_WORDS: Final = 500
"""Characters of a process's words on the page."""


@dataclass(slots=True, eq=False)
class LocalizerState:
    """State of a robot's localizer, as sent to the pages.

    Attributes
    ----------
    method : name of the filter.
    world : the world when it was started, which is its map.
    state : "starting" until the first estimate, then "running"; "ended" or "failed" after the process.
    words : what it waits for, why it ended, or the error with its remedy.
    has_old_map : True if the world has other walls since.
    """

    method: str
    world: World
    state: str = "starting"
    words: str = ""
    has_old_map: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the state as plain data."""
        return {"method": self.method, "state": self.state, "words": self.words[:MAX_WORDS],
                "has_old_map": self.has_old_map}  # fmt: skip


class Localizers:
    """Localizer processes of one daemon, by robot.

    Parameters
    ----------
    daemon : Daemon
    on_change : called when the state of a localizer has changed.
    program : the program `nomad`, replaced in tests.
    """

    def __init__(self, daemon: Daemon, on_change: Callable[[], None], program: Sequence[str] = NOMAD) -> None:
        self._daemon = daemon
        self._on_change = on_change
        self._program = tuple(program)
        # Tasks of each robot that have not ended; all but the last were cancelled.
        self._tasks: dict[int, list[asyncio.Task[None]]] = {}
        self._is_closed = False
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.states: dict[int, LocalizerState] = {}
        # Poses at which the encoders were right: where robots were switched on, and where pages have placed them. A
        # restored simulation has driven already.
        simulation = daemon.emulator.simulation
        self._known_poses = [robot.encoder for robot in simulation.robots.values()] if not simulation.time_s else []
        # Set by the server of the page once its port is open.
        self.page_url = ""
        self.model_file: Path | None = None
        # Filters of the user, `FILE.py:CLASS`, that nserver was started with: a page selects among them.
        self.own_methods: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Return the states of all localizers by robot."""
        return {str(robot): state.as_dict() for robot, state in self.states.items()}

    def start(self, robot: int, method: str, *, is_lost: bool, resumes: bool = False) -> None:
        """Start the localizer of a robot, in place of one that runs.

        Parameters
        ----------
        robot : number of the robot.
        method : name of the filter, one of METHODS or `own_methods`.
        is_lost : True if the pose is not known and is to be found; False if it is that of the encoders.
        resumes : True to begin with the last estimate of the localizer before, where that has saved one.

        Raises
        ------
        InvalidMessage
            If it cannot be started; the one that runs goes on.
        """
        # 1. All that can fail.
        if method not in (*METHODS, *self.own_methods):
            names = ", ".join((*METHODS, *self.own_methods))
            raise InvalidMessage(f"there is no method {method!r}{suggest(method, METHODS)}; there are {names}; a class "
                                 "of your own needs nserver --method FILE.py:CLASS")
        if self._is_closed:
            raise InvalidMessage("this nserver ends: start it again")
        if not self._tasks.get(robot) and sum(map(bool, self._tasks.values())) >= MAX_LOCALIZERS:
            raise InvalidMessage(f"there are {MAX_LOCALIZERS} localizers already: stop one, or run `nomad localize`")
        try:
            command, saved = self._command(robot, method, is_lost), self._file(robot, "estimate.json")
        except OSError as error:
            raise InvalidMessage(f"the map of the localizer cannot be written: {error}; free space in "
                                 f"{tempfile.gettempdir()}, or set TMPDIR to another folder") from error
        # 2. The end of the one that runs, and a task for the new one.
        self.stop(robot)
        state = self.states[robot] = LocalizerState(method, self._daemon.emulator.simulation.world)
        tasks = self._tasks.setdefault(robot, [])
        task = asyncio.create_task(self._run(state, command, saved, tuple(tasks), resumes=resumes))
        tasks.append(task)

        def finish(task: asyncio.Task[None]) -> None:
            tasks.remove(task)
            # Also a task that was cancelled before its first step.
            if task.cancelled():
                self._change(state, "ended", "stopped")
            elif error := task.exception():
                log.error("localizer of robot %d: internal error", robot, exc_info=error)
                self._change(state, "failed", f"internal error, see the daemon's log: {error!r}")

        task.add_done_callback(finish)
        self._on_change()

    def start_all(self) -> None:
        """Start a localizer of each robot, as many as there may be."""
        robots = list(self._daemon.emulator.simulation.robots)
        for robot in robots[:MAX_LOCALIZERS]:
            self.start(robot, METHODS[0], is_lost=False)
        if len(robots) > MAX_LOCALIZERS:
            log.warning("--localize: only the first %d of %d robots have a localizer, the maximum",
                        MAX_LOCALIZERS, len(robots))  # fmt: skip

    def stop(self, robot: int) -> None:
        """End the localizer of a robot, if there is one."""
        for task in self._tasks.get(robot, ()):
            task.cancel()

    def check_maps(self) -> None:
        """Report localizers whose map has other walls than the world, or the same again. Walkers are in no map."""
        world = self._daemon.emulator.simulation.world
        changed = [
            state for state in self.states.values()
            if (state.world is not world and not np.array_equal(state.world.walls, world.walls)) != state.has_old_map
        ]  # fmt: skip
        for state in changed:
            state.has_old_map = not state.has_old_map
        if changed:
            self._on_change()

    def mark_placed(self, robot: int) -> None:
        """Record that a page has placed this robot, and its encoders with it."""
        self._known_poses.append(self._daemon.emulator.simulation.robots[robot].encoder)
        del self._known_poses[:-MAX_KNOWN_POSES]

    def mark_published(self, robot: int) -> None:
        """Record that an estimate of this robot was published."""
        state = self.states.get(robot)
        if state is not None and state.state == "starting":
            self._change(state, "running", "")

    async def close(self) -> None:
        """End all localizers, and start none from now on; may be called twice."""
        self._is_closed = True
        tasks = [task for ending in self._tasks.values() for task in ending]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _command(self, robot: int, method: str, is_lost: bool) -> list[str]:
        """Return the command line of a localizer."""
        # 1. Robot, map and filter. A pose that is not known is found by the method that this option implies.
        address = f"nserver://{to_loopback(self._daemon.places['nserver'])}/{robot}"
        command = [*self._program, "localize", address, "--map", str(self._write_map(robot)), "--stay", "--json",
                   "--time-limit", f"{TIME_LIMIT_S:g}"]  # fmt: skip
        command += ["--start", "unknown"] if is_lost else ["--method", method]
        # 2. Models of the robot and its sensors. A real robot's are the program's own defaults.
        if self.model_file is not None:
            command += ["--model-file", str(self.model_file)]
        if self._daemon.handler is self._daemon.emulator:
            setup = self._daemon.emulator.simulation.robots[robot].setup
            command += ["--sonars", "cones" if isinstance(setup.sonar, Polaroid) else "rays"]
            if not setup.odometry.is_exact:
                command += ["--scale-std", WORN_SCALE_STD]
        return command

    def _write_map(self, robot: int) -> Path:
        """Write the present world to a file and return its path.

        Its starts include the poses at which encoders were right: from there a localizer trusts them.
        """
        world = self._daemon.emulator.simulation.world
        starts = dict.fromkeys((*world.starts, *(StartPose(*pose) for pose in self._known_poses)))
        path = self._file(robot, "world.toml")
        path.write_text(format_world(replace(world, starts=tuple(starts))))
        return path

    def _file(self, robot: int, name: str) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="nserver-")
        return Path(self._folder.name) / f"robot_{robot}_{name}"

    async def _run(self, state: LocalizerState, command: list[str], saved: Path, previous: Sequence[asyncio.Task[None]],
                   *, resumes: bool) -> None:
        # 1. Two localizers of one robot would publish in turns: wait for the end of those before. The last one saves
        # its estimate unless it is lost.
        await asyncio.gather(*previous, return_exceptions=True)
        if resumes and saved.exists():
            command += ["--resume", str(saved.replace(saved.with_suffix(".before")))]
        saved.unlink(missing_ok=True)
        command += ["--save", str(saved)]
        # 2. A session of its own: Ctrl-C in the daemon's terminal reaches only the daemon, which ends it in order.
        try:
            process = await asyncio.create_subprocess_exec(
                *command, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT, limit=MAX_LINE_BYTES, start_new_session=True,
                env=os.environ | {PUBLISH_VARIABLE: self.page_url},
            )  # fmt: skip
        except OSError as error:
            self._change(state, "failed", f"cannot start {command[0]}: {error.strerror or error}")
            return
        log.info("localizer started: pid=%d", process.pid)
        # 3. Its output until it ends, without the token: all pages see it. A cancelled task ends it.
        token = self.page_url.partition("token=")[2]
        lines: deque[str] = deque(maxlen=MAX_LINES)
        try:
            assert process.stdout is not None
            async for line in process.stdout:
                text = line.decode(errors="replace").replace(token or "\0", "...").strip()
                if text:
                    lines.append(text)
                    # The page shows what a starting localizer waits for.
                    if state.state == "starting" and not text.startswith("{"):
                        self._change(state, "starting", text.removeprefix("nomad: "))
            code = await process.wait()
        except asyncio.CancelledError:
            await _complete(_end(process))
            raise
        except ValueError:
            # A line longer than MAX_LINE_BYTES: not the program that was started.
            await _complete(_end(process))
            code = process.returncode or 1
        # 4. It ended by itself.
        log.info("localizer ended: pid=%d code=%d", process.pid, code)
        if stopped := _reason_to_stop(lines):
            self._change(state, "ended", stopped)
        else:
            self._change(state, "failed", _error_words(lines, code))
            # All of it, such as the traceback of a filter of the user.
            log.warning("localizer failed: %s", " | ".join(lines))

    def _change(self, state: LocalizerState, name: str, words: str) -> None:
        state.state, state.words = name, words
        # A state that was replaced is not shown any more.
        if state in self.states.values():
            self._on_change()


async def _complete(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine to its end, even if the task that waits for it is cancelled again."""
    task = asyncio.create_task(work)
    while not task.done():
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()


async def _end(process: asyncio.subprocess.Process) -> None:
    """End a process: by SIGTERM, after END_S by SIGKILL."""
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    # The output is read to its end, so that a full pipe does not keep the process from ending.
    try:
        async with asyncio.timeout(END_S):
            await process.communicate()
    except (TimeoutError, ValueError):
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


def _reason_to_stop(lines: Sequence[str]) -> str:
    """Return why a run was given up, from its result, the JSON object in the last line; "" if there is none."""
    try:
        result: Any = json.loads(lines[-1])
        return str(result["stopped"] or "")
    except (IndexError, ValueError, KeyError, TypeError):
        return ""


def _error_words(lines: Sequence[str], code: int) -> str:
    """Return the error in the output of a process that failed; it names its remedy."""
    # An error is the last line that begins with the program's name; anything else is an unexpected one.
    errors = [line.removeprefix("nomad: ") for line in lines if line.startswith("nomad: ")]
    return errors[-1] if errors else (
        f"the localizer ended with exit code {code}: {lines[-1] if lines else 'without a word'}; "
        "run `nomad localize` in a terminal to see all of its output"
    )  # fmt: skip
