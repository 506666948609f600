"""Serve a robot to programs that speak rosbridge v2: roslibpy, roslibjs, Foxglove.

    nomad rosbridge "serial:///dev/ttyUSB0?model=n150"        prints ws://127.0.0.1:9090/?token=...
    nomad rosbridge nserver://lab/1 --port 0 --map room.toml  any free port; /map is the world of that file

Topics /robot1/odom, /robot1/sonar, /tf and others, /robot1/cmd_vel in; nserver --rosbridge serves simulated robots the
same way. The robot stops when a program that drives it disconnects, falls silent, or this command ends.
"""

import argparse
from pathlib import Path

from nclient.common.arguments import add_address
from nclient.connector import address_or_default
from nserver_emu import cli
from nserver_emu.ros.options import DEFAULT_PORT, add_origin, port_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_address(parser)
    parser.add_argument("--port", type=port_text, default=str(DEFAULT_PORT), metavar="[HOST:]PORT",
                        help=f"port to listen on, on loopback unless HOST is given (default: {DEFAULT_PORT}; 0 takes a "
                        "free one)")
    parser.add_argument("--map", metavar="WORLD", help="publish this world as /map: a shipped world or a TOML file")
    parser.add_argument("--token-file", type=Path, metavar="FILE",
                        help="store the tokens in this file, so that the address stays the same over restarts")
    add_origin(parser, "--origin")


def run(options: argparse.Namespace) -> int:
    """Serve until the end, and return the exit code."""
    words = [options.map] if options.map else []
    words += ["--real", address_or_default(options.address), "--port", "0", "--rosbridge", options.port]
    words += ["--rosbridge-token-file", str(options.token_file)] if options.token_file else []
    words += [word for origin in options.origin for word in ("--rosbridge-origin", origin)]
    return cli.main(words)
