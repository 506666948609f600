"""Access to the page: tokens, host names and origins, and the number of connections.

    token file   first line: the token that allows everything; second line: the token that only allows watching.
                 Readable by its owner only; created with new tokens where it is missing.

    socket ──> AdmissionProtocol ──> aiohttp's handler ──> a request      or closed: at once if there are too many
                                                                          connections, after --limit-stall without one

A Host header must be a number, localhost, or the name given to --viewer, so that no other name can lead another site's
page here (DNS rebinding). Connections to the page use the same descriptors as clients', hence the limit.
"""

import asyncio
import hmac
import ipaddress
import logging
import re
import secrets
import socket
import stat
from collections.abc import Collection
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.http import HttpProcessingError

from nclient.common.allowlist import LOOPBACK_NAME
from nclient.errors import NomadError
from nserver_emu.server.admission import AdmissionControl, AdmissionProtocol
from nserver_emu.server.connection import TokenBucket

_WILDCARDS: Final = {"0.0.0.0": ("192.0.2.1", "127.0.0.1"), "::": ("2001:db8::1", "::1")}
"""Wildcard addresses: a documentation address to find the outgoing interface (RFC 5737, 3849), and loopback."""
# Characters of a URL that need no escape; the minimum of 16 is 96 bits.
_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{16,200}")
# Permissions of group and others, which a token file must not have.
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
# Requests that opening a page needs at once, and addresses whose rate is counted.
MIN_BURST: Final = 40
MAX_RATE_LIMITS: Final = 1000
# Port of a UDP socket that is connected and never used.
_ANY_PORT: Final = 9

REFUSED: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Nserver: access denied</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"></head>
<body><h1>This address gives no access</h1>
<p>Its token is wrong, missing, or belongs to an nserver that has ended: use the whole address that nserver printed
when it started, such as <code>http://127.0.0.1:7080/?token=...</code></p>
<p>An address stays the same over restarts with <code>nserver --viewer --viewer-token-file FILE</code>.</p>
</body></html>
"""


class TokenFileError(NomadError, ValueError):
    """A token file that cannot be used; the message names the file and the remedy."""


class Tokens(NamedTuple):
    """`act` allows everything, `watch` only watching."""

    act: str
    watch: str

    def may_act(self, token: str) -> bool | None:
        """Return True if the token allows everything, False if only watching, None if it is unknown.

        The comparison takes constant time.
        """
        act, watch = (hmac.compare_digest(token.encode(errors="replace"), valid.encode()) for valid in self)
        return True if act else False if watch else None


class Access(NamedTuple):
    """Rights of a token; `robot` and `name` are those of a student, who acts on that robot alone."""

    may_act: bool
    robot: int | None = None
    name: str = ""


def new_tokens() -> Tokens:
    """Return two random tokens of 192 bits."""
    return Tokens(secrets.token_urlsafe(24), secrets.token_urlsafe(24))


def load_tokens(path: Path) -> Tokens:
    """Read the tokens of a file; create it where it is missing. Raises TokenFileError."""
    try:
        # 1. A missing file is created, readable by its owner from the beginning.
        if not path.exists():
            return _made(path)
        text, state = path.read_text(), path.stat()
    except (OSError, UnicodeDecodeError) as error:
        raise TokenFileError(f"{path}: cannot be used for tokens: {error}") from error
    # 2. Secrets that others can read are refused rather than used.
    if state.st_mode & _OTHERS:
        raise TokenFileError(f"{path}: others than its owner may read the tokens: chmod 600 {path}")
    # 3. Two different tokens: the same one twice would make watching pages act.
    words = text.split()
    if len(words) != 2 or words[0] == words[1] or not all(map(_TOKEN.fullmatch, words)):
        raise TokenFileError(f"{path}: two different tokens are required, one per line, of 16 to 200 letters, digits, "
                             "- and _; a missing file is created")
    return Tokens(*words)


def _made(path: Path) -> Tokens:
    tokens = new_tokens()
    # Permissions are set before the secret is written.
    path.touch(0o600, exist_ok=False)
    path.write_text("\n".join(tokens) + "\n")
    return tokens


def is_same_origin(origin: str, scheme: str, host: str) -> bool:
    """Return True if a page of this Origin was served under this Host."""
    return origin.lower() == f"{scheme}://{host}".lower()


def is_known_host(host: str, serve_viewer: str = LOOPBACK_NAME) -> bool:
    """Return True if the page is served under this Host: a number, localhost, or the name given to --viewer."""
    try:
        # Numeric addresses cannot be rebound by another site's DNS.
        parts = urlsplit(f"//{host}")
        name = parts.hostname or ""
        _ = parts.port  # raises where it is none
        if name in (LOOPBACK_NAME, serve_viewer):
            return True
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def address(host: str, port: int) -> str:
    """Return the URL of a page that is served on this host and port, as `http://HOST:PORT`.

    For a wildcard host it has the address of the outgoing interface, or loopback where there is none.
    """
    name = _outgoing_address(*_WILDCARDS[host]) if host in _WILDCARDS else host
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def to_loopback(place: str) -> str:
    """Return `HOST:PORT` with loopback in place of a wildcard host, for a client on this machine."""
    host, _, port = place.rpartition(":")
    loopback = _WILDCARDS.get(host.strip("[]"), (host, host))[1]
    return f"[{loopback}]:{port}" if ":" in loopback.strip("[]") else f"{loopback}:{port}"


def _outgoing_address(destination: str, loopback: str) -> str:
    """Return the source address of packets to a destination; none is sent."""
    family = socket.AF_INET6 if ":" in destination else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            # Connecting a UDP socket selects the interface and sends nothing.
            probe.connect((destination, _ANY_PORT))
            return str(probe.getsockname()[0])
    except OSError:
        return loopback


HTTP_LOG: Final = logging.getLogger("nserver_emu.viewer.http")
"""aiohttp's logger for failed requests."""


class HttpAdmission:
    """Admission of connections to the page; `server` is aiohttp's, which makes a handler per connection."""

    def __init__(self, door: AdmissionControl, server: web.Server) -> None:
        self._door, self._server = door, server
        self._silent: set[asyncio.BaseProtocol] = set()
        self._rate_limits: dict[str, TokenBucket] = {}

    def protocol_factory(self) -> AdmissionProtocol:
        """Return the protocol of a new socket."""
        return AdmissionProtocol(self, self._hosts, self._receive)

    def request_received(self, request: web.Request) -> None:
        """Record that the request's connection is in use."""
        self._silent.discard(request.protocol)

    def rate_limit(self, host: str, now_s: float) -> TokenBucket | None:
        """Return the rate limit of requests from an address, None if there is none."""
        rate = self._door.limits.page_rate
        if not rate:
            return None
        if host not in self._rate_limits and len(self._rate_limits) >= MAX_RATE_LIMITS:
            # A limit that is forgotten allows a burst; addresses that come and go cost no memory.
            self._rate_limits.clear()
        return self._rate_limits.setdefault(host, TokenBucket(rate, MIN_BURST, now_s))

    def rejection_reason(self, host: str, present: Collection[str], at: str = "") -> str:
        """Return the reason to reject a new connection; empty to accept it. Addresses are checked per request."""
        del at
        limits = self._door.limits
        # In total, then per address, so that one host cannot use up all connections.
        if len(present) >= limits.page_connections:
            return f"there are {len(present)} connections to the page already (--limit-viewers)"
        if sum(one == host for one in present) >= limits.per_address:
            return f"there are {limits.per_address} connections to the page from there already (--limit-per-address)"
        return ""

    def reject(self, host: str, reason: str) -> None:
        """Count and log a rejected connection."""
        self._door.reject(host, reason)

    def keep_record(self, record: logging.LogRecord) -> bool:
        """Filter of HTTP_LOG: bytes that are not HTTP count as a rejected connection, without a traceback."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, HttpProcessingError):
            host, *_ = record.args if isinstance(record.args, tuple) else ("unknown",)
            self.reject(str(host), "what it says at the page's port is no HTTP")
        return not isinstance(error, HttpProcessingError)

    def _hosts(self) -> list[str]:
        peers = [handler.transport and handler.transport.get_extra_info("peername")
                 for handler in self._server.connections]  # fmt: skip
        return [peer[0] if peer else "" for peer in peers]

    def _receive(self) -> asyncio.BaseProtocol:
        handler = self._server()
        # A connection without a request holds a descriptor: it is closed after --limit-stall.
        if self._door.limits.stall:
            self._silent.add(handler)
            asyncio.get_running_loop().call_later(self._door.limits.stall, self._close_if_silent, handler)
        return handler

    def _close_if_silent(self, handler: web.RequestHandler) -> None:
        if handler in self._silent:
            self._silent.discard(handler)
            handler.force_close()
