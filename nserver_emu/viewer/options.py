"""The options of `nserver` for its page. aiohttp is the extra `viewer`, asked for only here.

    --viewer [[HOST:]PORT]    --viewer-token-file FILE
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from nclient.errors import ExtraMissing, NomadError
from nserver_emu.viewer.auth import tokens_of

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

DEFAULT_PORT: Final = 7080
LOOPBACK: Final = "127.0.0.1"


class Place(NamedTuple):
    """Where the page is served."""

    host: str = LOOPBACK
    port: int = DEFAULT_PORT


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of this room."""
    group = parser.add_argument_group("page")
    group.add_argument("--viewer", type=_place, nargs="?", const=Place(), metavar="PORT",
                       help=f"show the windows on a page for the browser, at its address with a token on stdout "
                       f"(default port {DEFAULT_PORT}, 0 takes a free one; on loopback unless HOST:PORT says else; "
                       "needs the extra viewer; the world goes before --viewer)")
    group.add_argument("--viewer-token-file", type=Path, metavar="FILE",
                       help="keep the page's tokens in a file that only you may read, so that its address stays the "
                       "same over restarts (made where there is none)")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Options that do not go together are wrong usage."""
    if options.viewer_token_file is not None and options.viewer is None:
        parser.error("--viewer-token-file is for the page: give --viewer too")


class ViewerMissing(ExtraMissing):
    """The page was asked for and aiohttp is not installed; the message names the extra."""


@asynccontextmanager
async def viewed(daemon: Daemon, options: argparse.Namespace) -> AsyncIterator[list[str]]:
    """The page as the options say, while it lasts; what to print of it.

    Raises ViewerMissing, TokenFileError or ConnectionLost, naming the remedy; the daemon is then closed.
    """
    if options.viewer is None:
        yield []
        return
    async with AsyncExitStack() as open_page:
        try:
            require_aiohttp()
            from nserver_emu.viewer.server import served

            kept = options.viewer_token_file
            tokens = None if kept is None else tokens_of(kept)
            host, port = options.viewer
            lines = await open_page.enter_async_context(served(daemon, host, port, tokens))
        except NomadError:
            await daemon.close()
            raise
        yield lines


def require_aiohttp() -> None:
    """Raises ViewerMissing where the page cannot be served for want of aiohttp."""
    if importlib.util.find_spec("aiohttp") is None:
        raise ViewerMissing("--viewer needs aiohttp: pip install 'nomad-nserver[viewer]'")


def _place(text: str) -> Place:
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"a port is 0 to 65535, or HOST:PORT, not {text!r}; "
                                         "the world goes before --viewer")
    return Place(host.strip("[]") or LOOPBACK, int(port))
