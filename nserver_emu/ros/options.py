"""Options of `nserver` for ROS: rosbridge (extra `viewer`), and ROS 2 by DDS (extra `ros2`).

--rosbridge [[HOST:]PORT]    --rosbridge-token-file FILE    --rosbridge-origin URL
--ros2 [INTERFACE]           --ros2-distro NAME
"""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Final

from nclient.errors import require_packages
from nclient.transports.listener import ListenAddress, before_world, parse_listen_address
from nserver_emu.ros.topics import Estimates
from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

DEFAULT_PORT: Final = 9090
"""The port that rosbridge clients use by default."""
LOOPBACK: Final = "loopback"
ANY: Final = "any"
"""Leaves the network interface to CYCLONEDDS_URI or, without it, to Cyclone DDS."""
DISTROS: Final = ("humble", "iron", "jazzy", "kilted", "lyrical")
DEFAULT_DISTRO: Final = "jazzy"
MAX_DOMAIN: Final = 232
"""The ports of higher domains are no port numbers."""
_DOMAIN: Final = "ROS_DOMAIN_ID"
_PACKAGES: Final = ("cyclonedds", "rosbags")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of rosbridge and of ROS 2, each in a group of their own."""
    group = parser.add_argument_group("rosbridge")
    group.add_argument("--rosbridge", type=before_world("--rosbridge", parse_listen_address), nargs="?",
                       const=ListenAddress(port=DEFAULT_PORT), metavar="PORT",
                       help=f"serve the robots as ROS topics to rosbridge clients; the address with a token is printed "
                       f"on stdout (default: port {DEFAULT_PORT}, 0 takes a free one; on loopback unless HOST is given;"
                       " needs the extra viewer; the world goes before --rosbridge)")
    group.add_argument("--rosbridge-token-file", type=Path, metavar="FILE",
                       help="store its tokens in a file that only you may read, so that the address stays the same "
                       "over restarts (created where it is missing; may be that of the page)")
    add_origin(group, "--rosbridge-origin")
    group = parser.add_argument_group("ROS 2")
    group.add_argument("--ros2", nargs="?", const=LOOPBACK, metavar="INTERFACE",
                       help=f"serve the robots as ROS 2 topics by DDS, in the domain of {_DOMAIN} (default: 0), on "
                       f"{LOOPBACK} or the named network interface or address, such as eth0; {ANY} uses "
                       "CYCLONEDDS_URI (needs the extra ros2; the world goes before --ros2)")
    add_distro(group, "--ros2-distro")


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
    # Browsers leave out the scheme's own port.
    return f"{scheme}://{host.removesuffix(':80' if scheme == 'http' else ':443')}"


def port_text(text: str) -> str:
    """Return the text of a port that can be read. Raises ArgumentTypeError."""
    parse_listen_address(text)
    return text


def add_distro(parser: argparse._ActionsContainer, name: str) -> None:
    """Add the option of the distribution of ROS 2."""
    default = os.environ.get("ROS_DISTRO", "")
    parser.add_argument(name, choices=DISTROS, default=default if default in DISTROS else DEFAULT_DISTRO,
                        help="distribution of ROS 2 whose message types are used: sensor_msgs/Range has one number "
                        f"more since iron (default: ROS_DISTRO, else {DEFAULT_DISTRO})")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Report options that exclude each other, and a domain that is none, as wrong usage."""
    for name in ("rosbridge_token_file", "rosbridge_origin"):
        if getattr(options, name) and options.rosbridge is None:
            parser.error(f"--{name.replace('_', '-')} is for rosbridge: give --rosbridge too")
    if options.ros2 is not None and domain_id() is None:
        parser.error(f"{_DOMAIN} is a number from 0 to {MAX_DOMAIN}, not {os.environ[_DOMAIN]!r}")


def domain_id() -> int | None:
    """Return the number of the DDS domain; None if the environment has no valid one."""
    text = os.environ.get(_DOMAIN) or "0"
    return int(text) if text.isdecimal() and len(text) <= 4 and int(text) <= MAX_DOMAIN else None


def config_of(interface: str) -> str | None:
    """Return the configuration of Cyclone DDS in XML; None for that of CYCLONEDDS_URI."""
    if interface == ANY:
        return None
    if interface != LOOPBACK:
        from xml.sax.saxutils import quoteattr  # here: it imports the HTTP client

        # An address has digits and points or colons; a name is that of the system.
        attribute = "address" if ":" in interface or interface.replace(".", "").isdecimal() else "name"
        general = f"<Interfaces><NetworkInterface {attribute}={quoteattr(interface)}/></Interfaces>"
        return f"<CycloneDDS><Domain><General>{general}</General></Domain></CycloneDDS>"
    # Loopback has no multicast: participants look for each other at the ports of the first 32 of a domain.
    return (
        '<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
        "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
        '<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers>'
        "</Discovery></Domain></CycloneDDS>"
    )


@asynccontextmanager
async def running_ros(daemon: Daemon, options: argparse.Namespace) -> AsyncIterator[list[str]]:
    """Serve rosbridge clients and ROS 2 as the options require; yield the lines to print.

    Raises
    ------
    ExtraMissing, TokenFileError, ConnectionLost
        With a remedy.
    """
    # The world of a real robot is known only if it was named.
    has_map = options.real is None or bool(options.files)
    # What localizers publish to rosbridge goes to ROS 2 as well.
    estimates, lines = Estimates(), []
    async with AsyncExitStack() as opened:
        if options.rosbridge is not None:
            lines += await opened.enter_async_context(_rosbridge(daemon, options, estimates, has_map=has_map))
        if options.ros2 is not None:
            lines += await opened.enter_async_context(_ros2(daemon, options, estimates, has_map=has_map))
        yield lines


def _rosbridge(daemon: Daemon, options: argparse.Namespace, estimates: Estimates, *,
               has_map: bool) -> AbstractAsyncContextManager[list[str]]:
    require_packages("--rosbridge", "viewer", "aiohttp")
    from nserver_emu.ros.rosbridge import RosbridgeServer, serve_rosbridge
    from nserver_emu.viewer.http_port import load_tokens

    tokens = None if options.rosbridge_token_file is None else load_tokens(options.rosbridge_token_file)
    host, port = options.rosbridge
    origins = frozenset(options.rosbridge_origin)
    server = RosbridgeServer(daemon, tokens, has_map=has_map, estimates=estimates, origins=origins)
    return serve_rosbridge(server, host, port)


@asynccontextmanager
async def _ros2(daemon: Daemon, options: argparse.Namespace, estimates: Estimates, *,
                has_map: bool) -> AsyncIterator[list[str]]:
    require_packages("--ros2", "ros2", *_PACKAGES)
    from nserver_emu.ros.dds import running_node

    domain, interface = domain_id() or 0, options.ros2
    async with running_node(daemon, options.ros2_distro, domain, config_of(interface), estimates, has_map=has_map):
        if interface != LOOPBACK:
            log.warning("ROS 2 is open to the network, unencrypted and without a password: every program of domain %d "
                        "there can drive the robots", domain)
        yield [f"listening ros2 {interface} domain {domain}"]
