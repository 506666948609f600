"""Who may connect, by address: `--allow ADDRESS[/BITS]`, as often as needed; for all that let others in. Pure.

Rules: without a rule, whoever reaches the port; with one, these networks and this machine itself, by whichever of its
addresses. What is no address (a socket of the machine's own) is this machine. An IPv4 address that came by IPv6 is the
IPv4 address.
"""

from __future__ import annotations

import argparse
import ipaddress
from dataclasses import dataclass
from typing import Final

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
LOOPBACK_NAME: Final = "localhost"
NOT_ALLOWED: Final = "that address is not allowed (--allow)"
"""Why somebody is turned away."""
DRIVES: Final = "may drive the robots"
"""What most ports are for."""


@dataclass(frozen=True, slots=True)
class Allowlist:
    """The networks that are let in; none: everybody."""

    allowed: tuple[Network, ...] = ()

    def allows(self, host: str, at: str = "") -> bool:
        """Whether who comes from this address may; `at`: the one of ours that he came to."""
        if not self.allowed or is_same_machine(host, at):
            return True
        address = ipaddress.ip_address(host.partition("%")[0])
        mapped = getattr(address, "ipv4_mapped", None) or address
        return any(mapped in network for network in self.allowed)


def add_options(parser: argparse.ArgumentParser) -> None:
    """The option of this room."""
    parser.add_argument("--allow", action="append", type=_network, default=[], metavar="ADDRESS[/BITS]",
                        help="let in who comes from there, and from this machine, and nobody else; once more for "
                        "another (default: whoever reaches the port)")


def allowlist_from_options(options: argparse.Namespace) -> Allowlist:
    """What the options say."""
    return Allowlist(tuple(options.allow))


def is_same_machine(host: str, at: str) -> bool:
    """Whether who comes from the address `host` to our `at` is on this machine: the system sends nothing of others that
    says it comes from where it goes to."""
    return not host or host == at or is_loopback(host)


def is_loopback(host: str) -> bool:
    """Whether nobody from another machine is or comes in at this address."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host.lower() == LOOPBACK_NAME
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


def warning(host: str, access: Allowlist, may: str = DRIVES) -> str:
    """What to say of listening on this address, and of what those who come may do; empty on loopback."""
    if is_loopback(host):
        return ""
    who = f"whoever comes from {', '.join(map(str, access.allowed))}" if access.allowed else "anybody who reaches it"
    remedy = "" if access.allowed else " --allow ADDRESS/BITS lets in fewer;"
    return (f"open to the network at {host}: the protocol has no authentication and no encryption, and {who} {may};"
            f"{remedy} ssh -L brings a port on loopback elsewhere (docs/limits.md)")


def _network(text: str) -> Network:
    try:
        return ipaddress.ip_network(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"an address or a network such as 192.168.1.0/24: {error}") from None
