"""Options of `nserver`, the original's spelling of some of them, and the checks for wrong usage.

    read_options(parser, words) ──> options; or an error message and exit code 2

Files are only checked for existence here. Options of a package are defined in the package (`add_options`).
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from nclient.common import allowlist
from nclient.common.allowlist import LOOPBACK
from nclient.common.arguments import (
    ABOVE_ZERO,
    Parser,
    add_flag,
    add_version,
    number,
    protect_coordinates,
    whole_number,
)
from nclient.common.hints import suggest
from nserver_emu import logs
from nserver_emu.control import save_options as restore_options
from nserver_emu.control import socket as control_options
from nserver_emu.gateway import run as real_options
from nserver_emu.ros import options as ros_options
from nserver_emu.server import limits, serial_lines
from nserver_emu.server.config import MAX_ROBOTS, MODEL_NAMES
from nserver_emu.server.server_state import MAX_LOCKSTEP_S, MAX_TIME_FACTOR, MIN_TIME_FACTOR
from nserver_emu.simulation.noise import NOISY, SETUPS, SUFFIX
from nserver_emu.viewer import options as viewer_options
from nserver_emu.viewer.classroom import WORLD as CLASS_WORLD
from worlds.io import DEFAULT_WORLD, world_names

# The port that clients of the original use by default.
DEFAULT_PORT = 7019
# Value of --speed for as fast as possible.
MAX_SPEED = "max"
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
    for package in (serial_lines, real_options, control_options, allowlist, limits, viewer_options, ros_options):
        package.add_options(parser)
    add_flag(parser, "--list-worlds", "list the shipped worlds and exit")
    logs.add_options(parser)
    add_version(parser)
    return parser


def _add_robots(parser: Parser) -> None:
    parser.add_argument("--robot", action="append", metavar="MODEL",
                        help=f"the robot's model: {', '.join(MODEL_NAMES)} or one of --model-file (default: "
                        f"{MODEL_NAMES[0]}); repeatable, for robot 2 and so on")
    parser.add_argument("--robots", type=whole_number("the number of robots", 1, MAX_ROBOTS), default=1, metavar="N",
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
    step = number(f"a step is more than 0 and at most {MAX_LOCKSTEP_S:.0f} s", ABOVE_ZERO, MAX_LOCKSTEP_S)
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
        raise argparse.ArgumentTypeError(
            f"no setup {text!r}; there are {', '.join(SETUPS)}, and files that end in {SUFFIX}"
            f"{suggest(text, SETUPS)}"
        )
    return text


def _host(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError(f"an address or a host name, such as {LOOPBACK}, or 0.0.0.0 for all")
    return text
