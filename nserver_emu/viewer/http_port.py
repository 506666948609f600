"""HTTP port with limits and access control, and websockets without waiting: for the page and for rosbridge.

Connections are limited before HTTP is parsed (`HttpAdmission`). A client that receives too slowly skips pictures; the
messages of clients are handled in turns that all connections of the daemon share.

Access to the page: tokens, host names and origins, and the number of connections.

    token file   first line: the token that allows everything; second line: the token that only allows watching.
                 Readable by its owner only; created with new tokens where it is missing.

    socket ──> AdmissionProtocol ──> aiohttp's handler ──> a request      or closed: at once if there are too many
                                                                          connections, after --limit-stall without one

A Host header must be a number, localhost, or the name given to --viewer, so that no other name can lead another site's
page here (DNS rebinding). Connections to the page use the same descriptors as clients', hence the limit.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import ipaddress
import logging
import re
import secrets
import socket
import stat
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from http import HTTPStatus
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from aiohttp import WSCloseCode, web
from aiohttp.http import HttpProcessingError

from nclient.errors import ConnectionLost, NomadError
from nclient.transports.listener import LOOPBACK_NAME, NOT_ALLOWED, is_loopback, parse_listen_address
from nserver_emu.server.admission import AdmissionControl, AdmissionProtocol, at_port, listen
from nserver_emu.server.connection import FairScheduler, Job, TokenBucket, end_task

log = logging.getLogger(__name__)

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
            tokens = new_tokens()
            # Permissions are set before the secret is written.
            path.touch(0o600, exist_ok=False)
            path.write_text("\n".join(tokens) + "\n")
            return tokens
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
    return f"http://{at_port(name, port)}"


def to_loopback(place: str) -> str:
    """Return `HOST:PORT` with loopback in place of a wildcard host, for a client on this machine."""
    host, port = parse_listen_address(place)
    return at_port(_WILDCARDS[host][1] if host in _WILDCARDS else host, port)


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
        # A rejected connection is counted and logged there.
        self.reject = door.reject
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


Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

PERIOD_S: Final = 0.05
"""Twenty pictures a second."""
HEARTBEAT_S: Final = 6.0
"""Interval of pings; a page must answer within half of it."""
CONNECTION_LOST_S: Final = 10.0
"""Ping interval plus reply time-out, rounded up."""
CLOSING_S: Final = 0.5
"""Time-out of the closing handshake."""
STALLED_S: Final = 8.0
"""Time after which a page that receives nothing is disconnected."""
NO_LIMIT: Final = 2**31
"""Write buffer limit of a page's transport in bytes: sending never waits, and PageWriter does the flow control."""


class PageWriter:
    """Sends text messages to one page, without waiting.

    A page gets nothing new before it has received everything sent so far, so that pictures are skipped before they are
    sent. So the transport's write buffer never holds more than one round of messages, and its limit, at which aiohttp
    would wait, is switched off. `now` is real time in seconds.
    """

    def __init__(self, socket: web.WebSocketResponse, transport: asyncio.Transport, now: float) -> None:
        self._socket = socket
        self._transport = transport
        # Disconnects at once; closing would wait until everything is received.
        self.abort = transport.abort
        self._unsent = 0
        self._last_progress_s = now
        transport.set_write_buffer_limits(high=NO_LIMIT)

    def is_ready(self, now: float) -> bool:
        """Return True if the page has received everything and more can be sent."""
        # Progress is a shrinking buffer; an empty one has nothing to wait for.
        unsent = self._transport.get_write_buffer_size()
        if unsent < self._unsent or not self._unsent:
            self._last_progress_s = now
        self._unsent = unsent
        return not unsent and not self._socket.closed and not self._transport.is_closing()

    def is_stalled(self, now: float) -> bool:
        """Return True if the page has received nothing for STALLED_S, as far as `is_ready` observed."""
        return self._unsent > 0 and now - self._last_progress_s > STALLED_S

    async def send(self, text: str) -> None:
        """Send a text message; nothing to a page that is closing, whose end the receiving task sees."""
        with contextlib.suppress(ConnectionResetError):
            await self._socket.send_str(text)


class PageMessages(Job):
    """Handles the messages of one page in turns of the event loop that connections share (a `Job`).

    `rate` is the limit of messages per second, 0 for none.
    """

    def __init__(self, scheduler: FairScheduler, handle: Callable[[str], None], rate: int) -> None:
        self._scheduler = scheduler
        self._handle = handle
        self._limit = TokenBucket(rate, 1, loop_time()) if rate else None
        self._text = ""
        self._done: asyncio.Future[None] | None = None

    async def handle(self, text: str) -> None:
        """Handle a message when its turn has come."""
        await wait_for_rate(self._limit)
        self._text, self._done = text, asyncio.get_running_loop().create_future()
        self._scheduler.submit(self)
        try:
            await self._done
        finally:
            self.is_queued = False

    def run_turn(self) -> None:
        """Handle the message, for the scheduler."""
        assert self._done is not None
        try:
            self._handle(self._text)
        finally:
            self._done.set_result(None)


async def wait_for_rate(limit: TokenBucket | None) -> None:
    """Take a token of a rate limit, and wait until it is there: in the order of the calls."""
    if limit is not None:
        limit.consume(1, loop_time())
        if wait_s := limit.wait_s(loop_time()):
            await asyncio.sleep(wait_s)


async def _run_clock(tick: Callable[[], Awaitable[None]]) -> None:
    due = loop_time()
    while True:
        due = next_due(due, loop_time())
        await asyncio.sleep(due - loop_time())
        await tick()


def next_due(due_s: float, now_s: float) -> float:
    """Return the time of the next picture, given the time at which the last one was due.

    One period after that one was due, so that the average rate is right; a longer delay is not made up for.
    """
    return max(due_s + PERIOD_S, now_s)


def loop_time() -> float:
    """Return the event loop's time in seconds."""
    return asyncio.get_running_loop().time()


class HttpPort:
    """A port that serves an application of aiohttp; connections are limited before HTTP is parsed.

    Parameters
    ----------
    door
        Permitted addresses and limits.
    title, option
        What is served, and the option that chooses the port, for errors.
    """

    def __init__(self, door: AdmissionControl, title: str, option: str) -> None:
        self.door, self._title, self._option = door, title, option
        self.runner: web.AppRunner | None = None
        self.admission: HttpAdmission | None = None
        self._server: asyncio.Server | None = None
        self._sockets: set[web.WebSocketResponse] = set()
        self._clock: asyncio.Task[None] | None = None

    async def open(self, app: web.Application, host: str, port: int) -> int:
        """Start serving; return the port. Raises ConnectionLost if it cannot be used; the message names the remedy."""
        self.runner = web.AppRunner(app, access_log=None, logger=HTTP_LOG, shutdown_timeout=1.0)
        await self.runner.setup()
        try:
            assert self.runner.server is not None
            self.admission = HttpAdmission(self.door, self.runner.server)
            self._server = await listen(self.admission.protocol_factory, host, port)
        except OSError as error:
            await self.runner.cleanup()
            remedies = {errno.EADDRINUSE: f"{self._option} 0 takes a free port", errno.EACCES: "take a port above 1023"}
            remedy = remedies.get(error.errno or 0, "take an address of this machine")
            raise ConnectionLost(
                f"cannot serve {self._title} on {host}:{port}: {error.strerror or error}; {remedy}"
            ) from error
        HTTP_LOG.addFilter(self.admission.keep_record)  # only if something is served: close() removes it
        port = int(self._server.sockets[0].getsockname()[1])
        if not is_loopback(host):
            log.warning("%s is open to the network, unencrypted: all who read its address can drive the robots; "
                        "ssh -L %d:127.0.0.1:%d forwards its port to another machine", self._title, port, port)
        return port

    def start_clock(self, tick: Callable[[], Awaitable[None]]) -> None:
        """Call a function every PERIOD_S until `close`."""
        self._clock = asyncio.create_task(_run_clock(tick))

    @contextlib.asynccontextmanager
    async def websocket(self, request: web.Request, clients: str, max_bytes: int, *,
                        is_limited: bool = True) -> AsyncIterator[tuple[web.WebSocketResponse, PageWriter]]:
        """Accept a websocket, which counts towards --limit-viewers until the end of the block.

        Parameters
        ----------
        request
        clients
            Who there are too many of if the limit is reached, such as "clients".
        max_bytes
            Size of the largest message.
        is_limited
            False: accept it in any case.
        """
        if is_limited and len(self._sockets) >= self.door.limits.viewers:
            self.door.reject(request.remote or "", f"too many {clients} (--limit-viewers)")
            raise web.HTTPServiceUnavailable(text=f"too many {clients}: close one (--limit-viewers)\n")
        socket = web.WebSocketResponse(compress=False, heartbeat=HEARTBEAT_S, timeout=CLOSING_S, max_msg_size=max_bytes)
        self._sockets.add(socket)
        writer = None
        try:
            await socket.prepare(request)
            writer = PageWriter(socket, transport_of(request), loop_time())
            yield socket, writer
        finally:
            self._sockets.discard(socket)
            if writer and socket.close_code == WSCloseCode.ABNORMAL_CLOSURE:
                writer.abort()
            clear_tracebacks(socket.exception())

    async def close(self) -> None:
        """Stop serving: the clock, websockets, the port. May be called twice."""
        await end_task(self._clock)
        self._clock = None
        closing = [socket.close(code=WSCloseCode.GOING_AWAY, drain=False) for socket in self._sockets]
        await asyncio.gather(*closing, return_exceptions=True)
        if self._server is not None:
            self._server.close()
            self._server = None
        if self.admission is not None:
            HTTP_LOG.removeFilter(self.admission.keep_record)
            self.admission = None
        if self.runner is not None:
            await self.runner.cleanup()
            self.runner = None

    @web.middleware
    async def admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a request by its handler if its address is allowed, at the rate of its address."""
        host = request.remote or ""
        if self.admission is not None:
            self.admission.request_received(request)
            await wait_for_rate(self.admission.rate_limit(host, loop_time()))
        if not self.door.access.allows(host, local_address(request)):
            self.door.reject(host, NOT_ALLOWED)
            return web.Response(status=HTTPStatus.FORBIDDEN, text="this address is not allowed\n")
        try:
            return await handler(request)
        except web.HTTPException as refusal:  # aiohttp stores what is raised, with its traceback
            clear_tracebacks(refusal)
            return web.Response(status=refusal.status, headers=refusal.headers, body=refusal.body)


def transport_of(request: web.Request) -> asyncio.Transport:
    """Return the request's transport. Raises ConnectionResetError, which aiohttp ignores, if it is closed."""
    if request.transport is None:
        raise ConnectionResetError("closed before the request was answered")
    return request.transport


def clear_tracebacks(error: BaseException | None) -> None:
    """Drop the tracebacks of an error and its context: their frames would keep it alive until garbage collection."""
    while error is not None:
        error.__traceback__, error = None, error.__context__


def local_address(request: web.Request) -> str:
    """Return the local address of a request's connection."""
    own = request.transport and request.transport.get_extra_info("sockname")
    return str(own[0]) if own else ""
