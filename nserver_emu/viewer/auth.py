"""Who gets in to the page, and by which address: the two tokens, the hosts it is known by, where pages may come from.

    token file   the token to act in the first line, the one to look only in the second; only the owner may read it;
                 made with new tokens where there is none

Rules: nothing here knows HTTP. A Host is a number, localhost, or the very name that --viewer was given, so that no
other name leads another site's page in, whatever it resolves to.

Who comes to the page's port, before there is a request: no more than pages want, and nobody who asks nothing.

    socket ──> Doorkeeper ──> aiohttp's handler ──> a request, heard     or closed: at once where there are too many,
                                                                         after --limit-stall where none came

Rules: a connection is a descriptor, and those are what clients come in by too: whoever opens many here, and says
nothing, takes none of theirs. Who may ask what is web.py's.
"""

from __future__ import annotations

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

_WILDCARDS: Final = {"0.0.0.0": ("192.0.2.1", "127.0.0.1"), "::": ("2001:db8::1", "::1")}
"""Addresses that mean all: somewhere out there to find the way out (RFC 5737, 3849: nobody), and the one way in."""
_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{16,200}")
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_ANY_PORT: Final = 9

REFUSED: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Nserver: no way in</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"></head>
<body><h1>No way in by this address</h1>
<p>The token in it is wrong, missing, or of an nserver that has ended since: take the whole address that nserver printed
when it was started, such as <code>http://127.0.0.1:7080/?token=...</code></p>
<p>An address stays the same over restarts with <code>nserver --viewer --viewer-token-file FILE</code>.</p>
</body></html>
"""


class TokenFileError(NomadError, ValueError):
    """A file of tokens that cannot be used; the message names the file and the remedy."""


class Tokens(NamedTuple):
    """`act` lets do all, `watch` look only."""

    act: str
    watch: str

    def may_act(self, token: str) -> bool | None:
        """Whether who has this token may act; None: it is none of ours. Takes as long whatever is wrong."""
        act, watch = (hmac.compare_digest(token.encode(errors="replace"), ours.encode()) for ours in self)
        return True if act else False if watch else None


def new_tokens() -> Tokens:
    """Two that nobody can guess."""
    return Tokens(secrets.token_urlsafe(24), secrets.token_urlsafe(24))


def tokens_of(path: Path) -> Tokens:
    """The tokens in a file, made if there is none. Raises TokenFileError."""
    try:
        if not path.exists():
            return _made(path)
        text, state = path.read_text(), path.stat()
    except (OSError, UnicodeDecodeError) as error:
        raise TokenFileError(f"{path}: cannot be used for tokens: {error}") from error
    if state.st_mode & _OTHERS:
        raise TokenFileError(f"{path}: others than its owner may read the tokens: chmod 600 {path}")
    words = text.split()
    if len(words) != 2 or words[0] == words[1] or not all(map(_TOKEN.fullmatch, words)):
        raise TokenFileError(f"{path}: two different tokens are wanted, a line each, of 16 to 200 letters, digits, - "
                             "and _; where there is no file it is made")
    return Tokens(*words)


def _made(path: Path) -> Tokens:
    tokens = new_tokens()
    path.touch(0o600, exist_ok=False)
    path.write_text("\n".join(tokens) + "\n")
    return tokens


def from_here(origin: str, scheme: str, host: str) -> bool:
    """Whether a page of this Origin is the one that is served under this Host."""
    return origin.lower() == f"{scheme}://{host}".lower()


def known_host(host: str, served: str = LOOPBACK_NAME) -> bool:
    """Whether a page asked for under this Host can be ours: a number, loopback's name, or the one it is served on."""
    try:
        parts = urlsplit(f"//{host}")
        name = parts.hostname or ""
        _ = parts.port  # raises where it is none
        if name in (LOOPBACK_NAME, served):
            return True
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def address(host: str, port: int) -> str:
    """Where a page that is served on this host and port can be asked for, as `http://HOST:PORT`.

    For all addresses it is the one by which this machine reaches others, or loopback where it reaches none.
    """
    name = _way_in(*_WILDCARDS[host]) if host in _WILDCARDS else host
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def _way_in(somewhere: str, loopback: str) -> str:
    """The address that packets to somewhere would have; none is sent."""
    family = socket.AF_INET6 if ":" in somewhere else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((somewhere, _ANY_PORT))
            return str(probe.getsockname()[0])
    except OSError:
        return loopback


HTTP_LOG: Final = logging.getLogger("nserver_emu.viewer.http")
"""Where aiohttp says what went wrong with a request."""


class Reception:
    """See the head of this file. `server`: aiohttp's, which makes a handler for each connection."""

    def __init__(self, door: AdmissionControl, server: web.Server) -> None:
        self._door, self._server = door, server
        self._silent: set[asyncio.BaseProtocol] = set()

    def keeper(self) -> AdmissionProtocol:
        """The protocol of a newcomer's socket."""
        return AdmissionProtocol(self, self._hosts, self._receive)

    def heard(self, request: web.Request) -> None:
        """Whose request this is has asked something."""
        self._silent.discard(request.protocol)

    def rejection_reason(self, host: str, present: Collection[str], at: str = "") -> str:
        """Why a newcomer may not come in; empty: he may. By the address he is asked with his request, in words."""
        del at
        limits = self._door.limits
        if len(present) >= limits.page_connections:
            return f"there are {len(present)} connections to the page already (--limit-viewers)"
        if sum(one == host for one in present) >= limits.per_address:
            return f"there are {limits.per_address} connections to the page from there already (--limit-per-address)"
        return ""

    def reject(self, host: str, reason: str) -> None:
        """He was not let in."""
        self._door.reject(host, reason)

    def worth_saying(self, record: logging.LogRecord) -> bool:
        """A filter of HTTP_LOG: what is no HTTP is one more who was turned away, and no fault with a traceback."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, HttpProcessingError):
            host, *_ = record.args if isinstance(record.args, tuple) else ("somebody",)
            self.reject(str(host), "what it says at the page's port is no HTTP")
        return not isinstance(error, HttpProcessingError)

    def _hosts(self) -> list[str]:
        peers = [handler.transport and handler.transport.get_extra_info("peername")
                 for handler in self._server.connections]  # fmt: skip
        return [peer[0] if peer else "" for peer in peers]

    def _receive(self) -> asyncio.BaseProtocol:
        handler = self._server()
        if self._door.limits.stall:
            self._silent.add(handler)
            asyncio.get_running_loop().call_later(self._door.limits.stall, self._look_at, handler)
        return handler

    def _look_at(self, handler: web.RequestHandler) -> None:
        if handler in self._silent:
            self._silent.discard(handler)
            handler.force_close()
