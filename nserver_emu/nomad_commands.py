"""The subcommands of `nomad` that run an emulator: rosbridge, ros2 and challenge."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import secrets
import signal
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import degrees, hypot
from pathlib import Path
from statistics import fmean
from typing import Any, Final, NamedTuple

from nclient.common.arguments import ABOVE_ZERO, add_address, add_flag, add_value, number, whole_number
from nclient.common.process import ExitCode
from nclient.connector import address_or_default
from nclient.errors import NomadError
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.transports.listener import LOOPBACK
from nserver_emu import cli
from nserver_emu.ros.options import ANY, DEFAULT_PORT, add_distro, add_origin, config_of, port_text
from nserver_emu.ros.options import LOOPBACK as ROS_LOOPBACK
from nserver_emu.server.config import FIRST_ROBOT, SimulationConfig
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import SimulationClock
from nserver_emu.server.session import REFUSED, ConnectionContext, DeferredReply, error_reply
from worlds.io import load_world
from worlds.world import StartPose


class RosbridgeCommand:
    """Serve a robot to programs that speak rosbridge v2: roslibpy, roslibjs, Foxglove.

        nomad rosbridge "serial:///dev/ttyUSB0?model=n150"        prints ws://127.0.0.1:9090/?token=...
        nomad rosbridge nserver://lab/1 --port 0 --map room.toml  any free port; /map is the world of that file

    Topics /robot1/odom, /robot1/sonar, /tf and others, /robot1/cmd_vel in; nserver --rosbridge serves simulated
    robots the same way. The robot stops when a program that drives it disconnects, falls silent, or this command
    ends.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        add_address(parser)
        parser.add_argument("--port", type=port_text, default=str(DEFAULT_PORT), metavar="[HOST:]PORT",
                            help=f"port to listen on, on loopback unless HOST is given (default: {DEFAULT_PORT}; 0 "
                            "takes a free one)")
        parser.add_argument("--map", metavar="WORLD", help="publish this world as /map: a shipped world or a TOML file")
        parser.add_argument("--token-file", type=Path, metavar="FILE",
                            help="store the tokens in this file, so that the address stays the same over restarts")
        add_origin(parser, "--origin")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Serve until the end, and return the exit code."""
        words = [options.map] if options.map else []
        words += ["--real", address_or_default(options.address), "--port", "0", "--rosbridge", options.port]
        words += ["--rosbridge-token-file", str(options.token_file)] if options.token_file else []
        words += [word for origin in options.origin for word in ("--rosbridge-origin", origin)]
        return cli.main(words)


class Ros2Command:
    """Serve a robot as ROS 2 topics by DDS, without ROS on this machine.

        nomad ros2 "serial:///dev/ttyUSB0?model=n150"        for programs on this machine (ROS_LOCALHOST_ONLY=1)
        nomad ros2 nserver://lab/1 --interface eth0          for those on the network of eth0: there is no password
        nomad ros2 sim:thesis_room --map thesis_room         /map is that world
        nomad ros2 --print-config                            CYCLONEDDS_URI for other programs on loopback

    Topics /robot1/odom, /robot1/sonar, /tf and others, /robot1/cmd_vel in, in the domain of ROS_DOMAIN_ID; nserver
    --ros2 serves simulated robots the same way. The robot stops when the program that drives it ends or falls silent,
    or this command ends.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        add_address(parser)
        parser.add_argument("--interface", default=ROS_LOOPBACK, metavar="NAME",
                            help=f"network interface or its address, such as eth0; {ANY}: that of CYCLONEDDS_URI, or "
                            f"what Cyclone DDS chooses (default: {ROS_LOOPBACK})")
        parser.add_argument("--map", metavar="WORLD", help="publish this world as /map: a shipped world or a TOML file")
        add_distro(parser, "--distro")
        parser.add_argument("--rosbridge", nargs="?", type=port_text, const=str(DEFAULT_PORT), metavar="[HOST:]PORT",
                            help="serve rosbridge as well; to the printed address `nomad localize --publish` sends "
                            f"estimates for both (default: port {DEFAULT_PORT}; needs the extra viewer)")
        add_flag(parser, "--print-config",
                 "print a configuration of Cyclone DDS, with which its other programs find this one, and exit")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Serve until the end, and return the exit code."""
        if options.print_config:
            print(config_of(options.interface) or "")
            return 0
        words = [options.map] if options.map else []
        words += ["--real", address_or_default(options.address), "--port", "0", "--ros2", options.interface]
        words += ["--ros2-distro", options.distro]
        words += ["--rosbridge", options.rosbridge] if options.rosbridge else []
        return cli.main(words)


STEP_S: Final = 0.1
"""Simulated seconds per request: ten decisions a second on any machine."""
PRECISE_IN: Final = 24.0
"""An error of so much or more earns nothing for precision, inches."""
POINTS_PROGRESS, POINTS_PRECISION, POINTS_PER_S, POINTS_PER_BUMP = 50.0, 50.0, 0.1, 5.0
MAX_RUNS: Final = 1000
MAX_SEED: Final = 2**31 - 1
STDERR: Final = 2
END_S: Final = 2.0
"""Seconds between SIGTERM and SIGKILL."""

REFUSED_CALLS: Final = frozenset({
    "sim_truth", "get_rpx", "get_robot_conf", "place_robot", "predict_sensors", "create_robot", "add_obstacle",
    "delete_obstacle", "move_obstacle", "new_world", "sim_control",
})  # fmt: skip
"""Commands that a real robot does not have: they would report the true pose or change the world."""


class ChallengeCommand:
    """Run a program on hidden seeds of a world, and score how near it brings the robot to a goal.

        nomad challenge corridor my_program.py                  three runs, one line each, then a JSON line
        nomad challenge flat ./my_program --runs 10 --seed 7    the runs of a class: the same seeds for everybody

    The program gets the robot's address as its argument and as NOMAD_ADDRESS, the goal as NOMAD_GOAL (X,Y in inches),
    and the start as NOMAD_START (X,Y,HEADING in inches and degrees). Files that end in .py are run by this Python.

    Rules: docs/challenge.md.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument("world", choices=sorted(CHALLENGES), metavar="WORLD",
                            help=f"one of {', '.join(CHALLENGES)}")
        parser.add_argument("program", type=Path, metavar="PROGRAM", help="a Python file, or another program")
        add_value(parser, "--seed", "N", whole_number("a seed", 0, MAX_SEED),
                  "seed of the first run; the others follow (default: a random one)")
        add_value(parser, "--runs", "N", whole_number("the number of runs", 1, MAX_RUNS), "number of runs", 3)
        add_value(parser, "--setup", "KIND", str, "noise of robot and sensors, as in nserver --setup", "noisy")
        add_value(parser, "--timeout", "S", number("a number of seconds above 0", ABOVE_ZERO),
                  "real seconds that one run of the program may take", 60.0)
        add_flag(parser, "--json", "print the JSON line only")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Run the command and return its exit code."""
        command = _command_of(options.program)
        first = secrets.randbelow(MAX_SEED - MAX_RUNS) if options.seed is None else options.seed
        results = []
        for seed in range(first, first + options.runs):
            result = asyncio.run(play(options.world, command, seed, options.setup, options.timeout))
            results.append(result)
            if not options.json:
                print(f"run {len(results)}: score {result.score:5.1f}  error {result.error_in:6.1f} in  time "
                      f"{result.time_s:5.1f} s  bumps {result.bumps}  {result.ended}", flush=True)  # fmt: skip
        print(json.dumps(_summary(options.world, options.program, results)))
        return ExitCode.DONE


class Challenge(NamedTuple):
    """A task: number of the world's start, goal in inches, time limit in simulated seconds."""

    start: int
    goal_in: tuple[float, float]
    limit_s: float


CHALLENGES: Final = {
    "corridor": Challenge(2, (1000.0, 39.0), 400.0),
    "flat": Challenge(0, (400.0, 280.0), 400.0),
    "several_walls": Challenge(0, (90.0, 55.0), 120.0),
    "thesis_room": Challenge(0, (80.0, 80.0), 120.0),
}


class ChallengeError(NomadError):
    """The program of a challenge cannot be run."""

    usage = True


@dataclass(frozen=True, slots=True)
class Result:
    """Result of one run.

    Attributes
    ----------
    seed
        Seed of the simulation.
    time_s
        Simulated seconds until the program ended, or the time limit.
    error_in
        Distance of the true position from the goal at the end.
    bumps
        Number of times that the robot touched something.
    score
        0 to 100.
    ended
        "finished", "exit code N", "time limit" (simulated) or "timeout" (real).
    """

    seed: int
    time_s: float
    error_in: float
    bumps: int
    score: float
    ended: str


def score(error_in: float, start_in: float, time_s: float, bumps: int) -> float:
    """Return the score of a run, 0 to 100; 0 for a robot that stands.

    Parameters
    ----------
    error_in, start_in
        Distance from the goal at the end and at the start.
    time_s
        Simulated seconds.
    bumps
        Contacts.
    """
    progress = POINTS_PROGRESS * max(0.0, 1.0 - error_in / start_in)
    precision = POINTS_PRECISION * max(0.0, 1.0 - error_in / PRECISE_IN)
    return max(0.0, progress + precision - POINTS_PER_S * time_s - POINTS_PER_BUMP * bumps)


class Referee(Emulator):
    """An emulator that counts contacts, ends after a time, and refuses what would disclose the true pose."""

    def watch(self, limit_s: float) -> None:
        """Begin to count; `over` is set when the limit of simulated time has passed."""
        self.limit_s, self.bumps, self.over = limit_s, 0, asyncio.Event()
        self._touches = False

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """Execute a call, unless it is refused."""
        return error_reply(REFUSED) if call.name in REFUSED_CALLS else super().answer(call, context)

    def pass_time(self, seconds: float) -> None:
        """Advance simulated time up to the limit, and count contacts that begin."""
        if self.over.is_set():
            return
        super().pass_time(seconds)
        touches = bool(self.simulation.robots[FIRST_ROBOT].bumpers)
        self.bumps += touches and not self._touches
        self._touches = touches
        if self.simulation.time_s >= self.limit_s:
            self.over.set()


def _summary(world: str, program: Path, results: list[Result]) -> dict[str, Any]:
    """Return the JSON values: means over all runs, and the runs."""
    means = {key: round(fmean(getattr(result, key) for result in results), 2)
             for key in ("score", "error_in", "time_s", "bumps")}  # fmt: skip
    return {"world": world, "program": str(program), **means, "runs": [asdict(result) for result in results]}


def _command_of(program: Path) -> list[str]:
    """Return the words that start a program. Raises ChallengeError."""
    if not program.is_file():
        raise ChallengeError(f"{program}: no such file; expected a Python file or a program")
    if program.suffix == ".py":
        return [sys.executable, str(program)]
    if not os.access(program, os.X_OK):
        raise ChallengeError(f"{program} cannot be executed: chmod +x {program}, or name a file that ends in .py")
    return [str(program.resolve())]


async def play(world: str, command: list[str], seed: int, setup: str, timeout_s: float) -> Result:
    """Simulate one run and return its result.

    Parameters
    ----------
    world
        Key of CHALLENGES.
    command
        Words that start the program; the address is added.
    seed, setup
        Of the simulation.
    timeout_s
        Real time for the program.
    """
    # 1. A simulation in lockstep with the program's requests: neither the machine nor its load changes a result.
    task = CHALLENGES[world]
    start, (goal_x, goal_y) = load_world(world).starts[task.start], task.goal_in
    config = SimulationConfig(world=world, start=start, seed=seed, setup=setup)
    emulator = Referee(config.simulation(), clock=SimulationClock(lockstep_s=STEP_S))
    emulator.watch(task.limit_s)
    daemon, stop = Daemon(emulator), asyncio.Event()
    port = await daemon.listen(LOOPBACK, 0)
    serving = asyncio.create_task(daemon.serve(stop))
    # 2. The program, until it ends or is ended.
    address = f"nserver://{LOOPBACK}:{port}/{FIRST_ROBOT}"
    try:
        ended = await _run_program([*command, address], _environment(address, world, start, task.goal_in),
                                   emulator.over, timeout_s)  # fmt: skip
    finally:
        # The pose counts before the connection closes; a robot in motion has not arrived anywhere else.
        pose, time_s = emulator.simulation.robots[FIRST_ROBOT].actual, emulator.simulation.time_s
        stop.set()
        await serving
    error_in = hypot(pose.x_in - goal_x, pose.y_in - goal_y)
    start_in = hypot(start.x_in - goal_x, start.y_in - goal_y)
    points = score(error_in, start_in, time_s, emulator.bumps)
    return Result(seed, round(time_s, 1), round(error_in, 2), emulator.bumps, round(points, 1), ended)


def _environment(address: str, world: str, start: StartPose, goal_in: tuple[float, float]) -> dict[str, str]:
    return os.environ | {
        "NOMAD_ADDRESS": address,
        "NOMAD_ROBOT": address,
        "NOMAD_WORLD": world,
        "NOMAD_GOAL": f"{goal_in[0]:g},{goal_in[1]:g}",
        "NOMAD_START": f"{start.x_in:.2f},{start.y_in:.2f},{degrees(start.steering_rad):g}",
    }


async def _run_program(command: list[str], environment: dict[str, str], over: asyncio.Event, timeout_s: float) -> str:
    """Run the program until it ends, simulated time is over or real time is; return how it ended."""
    # Its output goes to stderr: stdout has the results. A group of its own ends with its children.
    try:
        process = await asyncio.create_subprocess_exec(*command, env=environment, stdin=asyncio.subprocess.DEVNULL,
                                                       stdout=STDERR, start_new_session=True)
    except OSError as error:
        reason = f"{command[0]} cannot be started: {error.strerror}; does the script begin with #!?"
        raise ChallengeError(reason) from error
    finished, limit = asyncio.create_task(process.wait()), asyncio.create_task(over.wait())
    try:
        await asyncio.wait({finished, limit}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        if finished.done():
            return f"exit code {finished.result()}" if finished.result() else "finished"
        return "time limit" if limit.done() else "timeout"
    finally:
        # From now on time stands still: a program that ignores SIGTERM, or its children, drive no farther.
        over.set()
        limit.cancel()
        for number_ in (signal.SIGTERM, signal.SIGKILL):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, number_)
            await asyncio.wait({finished}, timeout=END_S)
