"""Options of `nserver` for ROS 2 by DDS, and the check for its packages, which the extra `ros2` installs.

--ros2 [INTERFACE]    --ros2-distro NAME
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Final

from nclient.common.hints import install_command
from nclient.errors import ExtraMissing, NomadError
from nserver_emu.rosbridge.topics import Estimates
from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

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
    """Add the options, in a group of their own."""
    group = parser.add_argument_group("ROS 2")
    group.add_argument("--ros2", nargs="?", const=LOOPBACK, metavar="INTERFACE",
                       help=f"serve the robots as ROS 2 topics by DDS, in the domain of {_DOMAIN} (default 0), on "
                       f"{LOOPBACK} or the named network interface or address, such as eth0; {ANY} uses "
                       "CYCLONEDDS_URI (needs the extra ros2; the world goes before --ros2)")
    add_distro(group, "--ros2-distro")


def add_distro(parser: argparse._ActionsContainer, name: str) -> None:
    """Add the option of the distribution of ROS 2."""
    default = os.environ.get("ROS_DISTRO", "")
    parser.add_argument(name, choices=DISTROS, default=default if default in DISTROS else DEFAULT_DISTRO,
                        help="distribution of ROS 2 whose message types are used: sensor_msgs/Range has one number "
                        f"more since iron (default: ROS_DISTRO, else {DEFAULT_DISTRO})")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Report a domain that is none as wrong usage."""
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
async def running_ros2(
    daemon: Daemon, options: argparse.Namespace, estimates: Estimates
) -> AsyncIterator[list[str]]:
    """Serve ROS 2 as the options require; yield the lines to print.

    Raises
    ------
    ExtraMissing, ConnectionLost
        With a remedy; the daemon is closed before.
    """
    domain = domain_id()
    if options.ros2 is None or domain is None:
        yield []
        return
    async with AsyncExitStack() as opened:
        try:
            for package in _PACKAGES:
                if importlib.util.find_spec(package) is None:
                    raise ExtraMissing(f"--ros2 needs {package}: {install_command('ros2')}")
            from nserver_emu.ros2.node import running_node

            # The world of a real robot is known only if it was named.
            has_map = options.real is None or bool(options.files)
            config = config_of(options.ros2)
            node = running_node(daemon, options.ros2_distro, domain, config, estimates, has_map=has_map)
            await opened.enter_async_context(node)
        except NomadError:
            await daemon.close()
            raise
        if options.ros2 != LOOPBACK:
            log.warning("ROS 2 is open to the network, unencrypted and without a password: every program of domain %d "
                        "there can drive the robots", domain)
        yield [f"listening ros2 {options.ros2} domain {domain}"]
