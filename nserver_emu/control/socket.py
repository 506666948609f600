"""The control socket: a Unix socket that only its owner can open, one JSON object per line (commands.py).

It has mode 0600 before the first client can connect. A socket left by a server that has ended is replaced; the socket
of a running server, and files that are no sockets, are not touched. It is removed when the server ends.

The options of `nserver` for injected faults and for control at run time: --faults FILE, --control [PATH].
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import socket
import stat
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from nclient.errors import ConnectionLost, NomadError
from nclient.faults.plan import MAX_BYTES, load_plan
from nserver_emu.control.commands import answer_line_in_thread
from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

NAME: Final = "nserver.sock"
# Modes of the socket and of its folder.
OWNER_ONLY, OWNERS_FOLDER = 0o600, 0o700
# Longer than the longest fault plan as JSON.
MAX_LINE: Final = 8 * MAX_BYTES


def default_path(environment: Mapping[str, str]) -> Path:
    """Return the default path: in the user's runtime folder, else in a folder of theirs in /tmp."""
    runtime = environment.get("XDG_RUNTIME_DIR", "")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / NAME
    return Path(tempfile.gettempdir()) / f"nserver-{os.getuid()}" / NAME


class ControlSocket:
    """A listening control socket; `answer` returns the response to a request line."""

    def __init__(self, path: Path, answer: Callable[[bytes], Awaitable[bytes]]) -> None:
        self.path = path
        self._answer = answer
        self._server: asyncio.Server | None = None
        # Device and inode of the socket, to remove no other file at its path.
        self._identity: tuple[int, int] | None = None
        self._clients: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Listen. Raise ConnectionLost with a remedy."""
        _prepare(self.path)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.bind(str(self.path))
            self.path.chmod(OWNER_ONLY)
            self._server = await asyncio.start_unix_server(self._serve, sock=listener, limit=MAX_LINE)
        except OSError as error:
            listener.close()
            raise _cannot(self.path, error.strerror or str(error)) from error
        self._identity = _identity(self.path)

    def close(self) -> None:
        """Stop listening and remove the socket, unless another has replaced it."""
        for client in self._clients:
            client.cancel()
        if self._server is None:
            return
        self._server.close()
        if self._identity is not None and _identity(self.path) == self._identity:
            self.path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._clients.add(task)
        try:
            await self._answer_lines(reader, writer)
        except (ConnectionError, ValueError) as error:  # ValueError: a line beyond MAX_LINE
            log.warning("control: closed: %s", error)
        except Exception:
            log.exception("control: internal error; connection closed")
        finally:
            self._clients.discard(task)
            writer.close()

    async def _answer_lines(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            log.debug("control: %s", line[:200])
            writer.write(await self._answer(line))
            await writer.drain()


def _prepare(path: Path) -> None:
    """Create the folder and remove a socket without a server. Raise ConnectionLost if something else is there."""
    try:
        # 1. The default folder in /tmp must be the user's own.
        if path.name == NAME:
            with contextlib.suppress(FileExistsError):
                path.parent.mkdir(mode=OWNERS_FOLDER)
            _check_folder(path)
        # 2. Nothing there, or a socket without a server.
        if not path.exists() and not path.is_symlink():
            return
        if not stat.S_ISSOCK(path.stat().st_mode):
            raise _cannot(path, "it exists and is no socket")
        if _has_server(path):
            raise _cannot(path, "another nserver listens there")
        path.unlink()
    except OSError as error:
        if isinstance(error, ConnectionLost):
            raise
        raise _cannot(path, error.strerror or str(error)) from error


def _check_folder(path: Path) -> None:
    """Raise ConnectionLost unless the folder of a socket is the user's own; in /tmp no other user may write to it."""
    status, is_shared = path.parent.lstat(), path.parent.parent == Path(tempfile.gettempdir())
    if stat.S_ISLNK(status.st_mode) and is_shared:
        raise _cannot(path, "its folder is a symbolic link")
    if path.parent.stat().st_uid != os.getuid() or status.st_uid != os.getuid():
        raise _cannot(path, "its folder is another user's")
    if is_shared and status.st_mode & 0o022:
        raise _cannot(path, "other users may write to its folder")


def _has_server(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        try:
            client.connect(str(path))
        except ConnectionRefusedError:
            return False
    return True


def _cannot(path: Path, reason: str) -> ConnectionLost:
    return ConnectionLost(f"cannot open the control socket {path}: {reason}; choose another with --control PATH")


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.lstat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


_SUFFIX: Final = ".sock"
# The value of --control without a path: the default path.
_DEFAULT: Final = Path()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    group = parser.add_argument_group("faults and control")
    group.add_argument("--faults", type=Path, metavar="FILE",
                       help="inject faults by this plan (TOML): bytes lost, late, corrupted or refused, by line")
    group.add_argument("--control", type=_socket_after_a_world, nargs="?", const=_DEFAULT, metavar="PATH",
                       help="listen for `nserver ctl` on a Unix socket that only you can open (default: in your "
                       "runtime folder)")


def may_have_faults(options: argparse.Namespace) -> bool:
    """Return True if a fault plan can come into force."""
    return options.faults is not None or options.control is not None


@asynccontextmanager
async def controlled(daemon: Daemon, options: argparse.Namespace) -> AsyncIterator[list[str]]:
    """Load the fault plan and open the control socket; yield the lines to print.

    Raises FaultPlanError or ConnectionLost, with a remedy; the daemon is then closed.
    """
    try:
        control = await _open(daemon, options)
    except NomadError:
        await daemon.close()
        raise
    if control is None:
        yield []
        return
    try:
        yield [f"listening control {control.path}"]
    finally:
        control.close()


async def _open(daemon: Daemon, options: argparse.Namespace) -> ControlSocket | None:
    if options.faults:
        daemon.faults.put(load_plan(options.faults), daemon.lines())
    if options.control is None:
        return None
    path = default_path(os.environ) if options.control == _DEFAULT else options.control
    control = ControlSocket(path, lambda line: answer_line_in_thread(daemon, line))
    await control.open()
    return control


def socket_path(text: str) -> Path:
    """Parse the path after --control of the daemon and of `nserver ctl`."""
    # Without a slash or suffix it is a world or a command that follows an option without a path.
    if "/" not in text and not text.endswith(_SUFFIX):
        wanted = f"a path with a slash or ending in {_SUFFIX}, such as ./nserver{_SUFFIX}"
        raise argparse.ArgumentTypeError(f"{wanted}, not {text!r}")
    return Path(text)


def _socket_after_a_world(text: str) -> Path:
    try:
        return socket_path(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}; the world goes before --control") from None
