"""Options of `nserver` for its page, and the check for aiohttp, which the extra `viewer` installs.

The options:

    --viewer [[HOST:]PORT]    --viewer-token-file FILE    --class FILE    --method FILE.py:CLASS    --localize
    --open-browser
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from nclient.errors import require_packages
from nclient.transports.listener import ListenAddress, before_world, parse_listen_address
from nserver_emu.server.config import ROOM_AHEAD_IN, has_room_ahead
from nserver_emu.server.daemon import Daemon
from worlds.world import StartPose

if TYPE_CHECKING:
    from nserver_emu.viewer.classroom import Student

log = logging.getLogger(__name__)

DEFAULT_PORT: Final = 7080


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the page's options, in a group of their own."""
    group = parser.add_argument_group("page")
    group.add_argument("--viewer", type=before_world("--viewer", parse_listen_address), nargs="?",
                       const=ListenAddress(port=DEFAULT_PORT), metavar="PORT",
                       help=f"serve the page for the browser; its address with a token is printed on stdout "
                       f"(default: port {DEFAULT_PORT}, 0 takes a free one; on loopback unless HOST is given; "
                       "needs the extra viewer; the world goes before --viewer)")
    group.add_argument("--viewer-token-file", type=Path, metavar="FILE",
                       help="store the page's tokens in a file that only you may read, so that its address stays the "
                       "same over restarts (created where it is missing)")
    group.add_argument("--method", type=parse_own_method, action="append", default=[], metavar="FILE.py:CLASS",
                       help="offer a filter of your own on the page, beside the built-in ones; repeatable; it runs in "
                       "the process of the localizer (docs/own-filter.md)")
    group.add_argument("--localize", action="store_true",
                       help="start a localizer of each robot, as Localize on the page does; implies --viewer")
    group.add_argument("--open-browser", action="store_true", help="open the page in your browser; implies --viewer")
    group.add_argument("--class", dest="class_file", type=Path, metavar="STUDENTS.csv",
                       help="a class: give each student of the file (name[,token][,robot] per line) a robot and a link "
                       "of the page that drives only that robot; links are written to STUDENTS.links.csv; implies "
                       "--viewer, and the world arena unless another is named")
    parser.set_defaults(students=[])


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Report options that exclude each other as wrong usage."""
    if options.viewer is None and (options.class_file is not None or options.localize or options.open_browser):
        options.viewer = ListenAddress(port=DEFAULT_PORT)
    if options.viewer_token_file is not None and options.viewer is None:
        parser.error("--viewer-token-file is for the page: give --viewer too")
    if options.method and options.viewer is None:
        parser.error("--method is for the page: give --viewer too, or use nomad localize --method")


@asynccontextmanager
async def running_viewer(daemon: Daemon, options: argparse.Namespace) -> AsyncIterator[list[str]]:
    """Serve the page as the options require; yield the lines to print.

    Raises
    ------
    ExtraMissing, TokenFileError, ConnectionLost
        With a remedy.
    """
    if options.viewer is None:
        yield []
        return
    require_packages("--viewer", "viewer", "aiohttp")
    from nserver_emu.viewer.classroom import write_links
    from nserver_emu.viewer.http_port import address, load_tokens
    from nserver_emu.viewer.server import ViewerServer, serve_viewer

    token_file = options.viewer_token_file
    tokens = None if token_file is None else load_tokens(token_file)
    students = require_robots(options, daemon)
    server = ViewerServer(daemon, tokens, students)
    server.controller.localizers.model_file = options.model_file
    server.controller.localizers.own_methods = tuple(options.method)
    async with serve_viewer(server, *options.viewer) as lines:
        if options.localize:
            server.controller.localizers.start_all()
        if options.open_browser:
            # In a thread: some browsers return only when they are closed. Without one, the address is printed.
            asyncio.get_running_loop().run_in_executor(None, webbrowser.open, lines[0].split()[-1])
        if students:
            page = lines[0].split()[-1].partition("/?")[0]
            program = address(options.bind, daemon.emulator.port).replace("http:", "nserver:")
            file = write_links(options.class_file, students, page, program)
            print(f"nserver: links of {len(students)} students are in {file}; the teacher opens the address below",
                  file=sys.stderr)
        yield lines


def require_robots(options: argparse.Namespace, daemon: Daemon) -> list[Student]:
    """Return the students. Raises ClassFileError if one has no robot; warns where a robot has little room."""
    from nserver_emu.viewer.classroom import ClassFileError

    students: list[Student] = options.students
    if not students:
        return []
    robots = daemon.emulator.simulation.robots
    for student in students:
        if student.robot not in robots:
            raise ClassFileError(f"{options.class_file}: {student.name} has robot {student.robot}, and there are only "
                                 f"{len(robots)}: a saved simulation keeps its robots, leave --restore out")
    simulation = daemon.emulator.simulation
    cramped = [str(number) for number, robot in robots.items()
               if not has_room_ahead(simulation, StartPose(*robot.actual), robot.model.body.radius_in, number)]
    if cramped:
        log.warning("robots %s have less than %g in of room ahead: the world %s is small for a class, arena has thirty "
                    "starts", ", ".join(cramped), ROOM_AHEAD_IN, simulation.world.name)
    return students


def parse_own_method(text: str) -> str:
    """Return `FILE.py:CLASS` with the whole path, or `MODULE:CLASS` as it is. Raises ArgumentTypeError."""
    place, _, name = text.rpartition(":")
    if not place or not name.isidentifier():
        raise argparse.ArgumentTypeError(f"a filter of your own is FILE.py:CLASS or MODULE:CLASS, not {text!r}; the "
                                         "built-in ones are on the page without this option")
    if not place.endswith(".py"):
        return text
    path = Path(place).absolute()
    if not path.is_file():
        raise argparse.ArgumentTypeError(f"{place}: no such file; expected FILE.py:CLASS")
    return f"{path}:{name}"
