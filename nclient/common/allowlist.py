"""Network addresses: those that may connect, and those to listen on.

    --allow ADDRESS[/BITS]    of all servers        [HOST:]PORT    of the page and of rosbridge

Without --allow every address may connect; with it the listed networks, and always this machine, by any of its
addresses. A peer name that is no IP address (a Unix socket) is on this machine. An IPv4 address mapped to IPv6 counts
as the IPv4 address.
"""

import argparse
import ipaddress
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
LOOPBACK: Final = "127.0.0.1"
LOOPBACK_NAME: Final = "localhost"
NOT_ALLOWED: Final = "that address is not allowed (--allow)"
"""Reason for rejecting a connection."""
DRIVES: Final = "may drive the robots"
"""What a client of most ports may do, for the warning."""


@dataclass(frozen=True, slots=True)
class Allowlist:
    """Networks that may connect; none for all."""

    allowed: tuple[Network, ...] = ()

    def allows(self, host: str, at: str = "") -> bool:
        """Return True if `host` may connect; `at` is the local address that it connected to."""
        if not self.allowed or is_same_machine(host, at):
            return True
        # A scope such as %eth0 is no part of the address.
        address = ipaddress.ip_address(host.partition("%")[0])
        mapped = getattr(address, "ipv4_mapped", None) or address
        return any(mapped in network for network in self.allowed)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --allow."""
    parser.add_argument("--allow", action="append", type=_network, default=[], metavar="ADDRESS[/BITS]",
                        help="accept connections only from this address or network; repeatable; this machine is "
                        "always accepted (default: accept all)")


def allowlist_from_options(options: argparse.Namespace) -> Allowlist:
    """Return the allowlist of parsed options."""
    return Allowlist(tuple(options.allow))


def is_same_machine(host: str, at: str) -> bool:
    """Return True if a connection from `host` to the local address `at` comes from this machine.

    The kernel drops packets from elsewhere whose source is a local address, so that equal addresses are proof.
    """
    return not host or host == at or is_loopback(host)


def is_loopback(host: str) -> bool:
    """Return True if the address or name is reachable from this machine only."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host.lower() == LOOPBACK_NAME
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


def warning(host: str, allowlist: Allowlist, may: str = DRIVES) -> str:
    """Return a warning about listening on an address; "" on loopback.

    Parameters
    ----------
    host
        Address to listen on.
    allowlist
        Addresses that may connect.
    may
        What clients may do, such as DRIVES.
    """
    if is_loopback(host):
        return ""
    networks = ", ".join(map(str, allowlist.allowed))
    clients = f"any client from {networks}" if allowlist.allowed else "any client that reaches it"
    remedy = "" if allowlist.allowed else " --allow ADDRESS/BITS restricts the addresses;"
    return (f"open to the network at {host}: the protocol has no authentication and no encryption, and {clients} {may};"
            f"{remedy} ssh -L forwards a port on loopback to another machine (docs/limits.md)")


def _network(text: str) -> Network:
    try:
        return ipaddress.ip_network(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"an address or a network such as 192.168.1.0/24: {error}") from None


class ListenAddress(NamedTuple):
    """Address to listen on; port 0 takes a free one."""

    host: str = LOOPBACK
    port: int = 0


def parse_listen_address(text: str) -> ListenAddress:
    """Return the address of PORT or HOST:PORT. Raises ArgumentTypeError."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"a port is 0 to 65535, or HOST:PORT, not {text!r}")
    return ListenAddress(host.strip("[]") or LOOPBACK, int(port))


def listen_address_of(option: str) -> Callable[[str], ListenAddress]:
    """Return the type of an option whose address may be left out: what follows it may be meant as the world."""

    def read(text: str) -> ListenAddress:
        try:
            return parse_listen_address(text)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"{error}; the world goes before {option}") from None

    return read
