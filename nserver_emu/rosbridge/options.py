"""Options of `nserver` for rosbridge, and the check for aiohttp, which the extra `viewer` installs.

--rosbridge [[HOST:]PORT]    --rosbridge-token-file FILE    --rosbridge-origin URL
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Final

from nclient.common.hints import install_command
from nclient.errors import ExtraMissing, NomadError
from nserver_emu.rosbridge.topics import Estimates
from nserver_emu.server.daemon import Daemon
from nserver_emu.viewer.options import ListenAddress, listen_address_of, parse_listen_address

DEFAULT_PORT: Final = 9090
"""The port that rosbridge clients use by default."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add rosbridge's options, in a group of their own."""
    group = parser.add_argument_group("rosbridge")
    group.add_argument("--rosbridge", type=listen_address_of("--rosbridge"), nargs="?",
                       const=ListenAddress(port=DEFAULT_PORT), metavar="PORT",
                       help=f"serve the robots as ROS topics to rosbridge clients; the address with a token is printed "
                       f"on stdout (default port {DEFAULT_PORT}, 0 takes a free one; on loopback unless HOST is given; "
                       "needs the extra viewer; the world goes before --rosbridge)")
    group.add_argument("--rosbridge-token-file", type=Path, metavar="FILE",
                       help="store its tokens in a file that only you may read, so that the address stays the same "
                       "over restarts (created where it is missing; may be that of the page)")
    add_origin(group, "--rosbridge-origin")


def add_origin(parser: argparse._ActionsContainer, name: str) -> None:
    """Add the option of pages of other servers."""
    parser.add_argument(name, type=_origin, action="append", default=[], metavar="URL",
                        help="let pages of this server connect, with a token, such as http://localhost:3000 for "
                        "roslibjs or https://app.foxglove.dev; repeatable (default: programs only, no pages)")


def _origin(text: str) -> str:
    """Return the origin of pages as browsers send it. Raises ArgumentTypeError."""
    scheme, separator, host = text.lower().removesuffix("/").partition("://")
    if scheme not in ("http", "https") or not separator or not host or "/" in host:
        raise argparse.ArgumentTypeError(f"an origin is scheme and host, such as http://localhost:3000, not {text!r}")
    return f"{scheme}://{host}"


def port_text(text: str) -> str:
    """Return the text of a port that can be read. Raises ArgumentTypeError."""
    parse_listen_address(text)
    return text


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Report options that exclude each other as wrong usage."""
    for name in ("rosbridge_token_file", "rosbridge_origin"):
        if getattr(options, name) and options.rosbridge is None:
            parser.error(f"--{name.replace('_', '-')} is for rosbridge: give --rosbridge too")


@asynccontextmanager
async def running_rosbridge(
    daemon: Daemon, options: argparse.Namespace, estimates: Estimates
) -> AsyncIterator[list[str]]:
    """Serve rosbridge clients as the options require; yield the lines to print.

    Parameters
    ----------
    daemon : the robots.
    options : the options of `nserver`.
    estimates : gets what localizers publish.

    Raises
    ------
    ExtraMissing, TokenFileError, ConnectionLost
        With a remedy; the daemon is closed before.
    """
    if options.rosbridge is None:
        yield []
        return
    async with AsyncExitStack() as opened:
        try:
            if importlib.util.find_spec("aiohttp") is None:
                raise ExtraMissing(f"--rosbridge needs aiohttp: {install_command('viewer')}")
            from nserver_emu.rosbridge.server import serve_rosbridge
            from nserver_emu.viewer.auth import load_tokens

            tokens = None if options.rosbridge_token_file is None else load_tokens(options.rosbridge_token_file)
            host, port = options.rosbridge
            # The world of a real robot is known only if it was named.
            has_map = options.real is None or bool(options.files)
            origins = frozenset(options.rosbridge_origin)
            serving = serve_rosbridge(
                daemon, host, port, tokens, has_map=has_map, estimates=estimates, origins=origins
            )
            lines = await opened.enter_async_context(serving)
        except NomadError:
            await daemon.close()
            raise
        yield lines
