"""The control socket: a Unix socket that only its owner can open, one JSON object per line (commands.py).

It has mode 0600 before the first client can connect. A socket left by a server that has ended is replaced; the socket
of a running server, and files that are no sockets, are not touched. It is removed when the server ends.
"""

import asyncio
import contextlib
import logging
import os
import socket
import stat
import tempfile
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Final

from nclient.errors import ConnectionLost
from nclient.faults.plan import MAX_BYTES

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
    """Raise ConnectionLost unless the folder of a socket is the user's own; in /tmp nobody else may write to it."""
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
