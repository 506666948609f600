"""The daemon's control socket: a Unix socket that only its owner can open, a JSON object a line each way (control.py).

Rules: mode 0600 before the first who could connect. A socket left behind by a daemon that is gone is replaced, one of
a daemon that lives is not, and no file that is no socket is ever touched. Gone when the daemon ends.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import stat
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from nclient.errors import ConnectionLost
from nclient.faults.plan import MAX_BYTES

log = logging.getLogger(__name__)

NAME: Final = "nserver.sock"
OWNER_ONLY, OWNERS_FOLDER = 0o600, 0o700
LONGEST_LINE: Final = 8 * MAX_BYTES
"""A plan of faults as JSON at its longest, and more."""


def default_path(environment: Mapping[str, str]) -> Path:
    """Where daemon and `nserver ctl` meet when nobody says: the user's runtime folder, else one of theirs in /tmp."""
    runtime = environment.get("XDG_RUNTIME_DIR", "")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / NAME
    return Path(tempfile.gettempdir()) / f"nserver-{os.getuid()}" / NAME


class ControlSocket:
    """See the head of this file. `answer`: a line in, a line out."""

    def __init__(self, path: Path, answer: Callable[[bytes], bytes]) -> None:
        self.path = path
        self._answer = answer
        self._server: asyncio.Server | None = None
        self._identity: tuple[int, int] | None = None
        self._talks: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Listen. Raises ConnectionLost, naming the remedy."""
        _make_way(self.path)
        door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            door.bind(str(self.path))
            self.path.chmod(OWNER_ONLY)
            self._server = await asyncio.start_unix_server(self._meet, sock=door, limit=LONGEST_LINE)
        except OSError as error:
            door.close()
            raise _cannot(self.path, error.strerror or str(error)) from error
        self._identity = _identity(self.path)

    def close(self) -> None:
        """Stop listening; the socket is gone, unless somebody else's is in its place."""
        for talk in self._talks:
            talk.cancel()
        if self._server is None:
            return
        self._server.close()
        if self._identity is not None and _identity(self.path) == self._identity:
            self.path.unlink(missing_ok=True)

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        talk = asyncio.current_task()
        assert talk is not None
        self._talks.add(talk)
        try:
            await self._talk(reader, writer)
        except (ConnectionError, ValueError) as error:  # ValueError: a line beyond LONGEST_LINE
            log.warning("control: closed: %s", error)
        except Exception:
            log.exception("control: closed because of a fault of ours")
        finally:
            self._talks.discard(talk)
            writer.close()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            log.debug("control: %s", line[:200])
            writer.write(self._answer(line))
            await writer.drain()


def _make_way(path: Path) -> None:
    """The folder is there, and nothing stands where the socket will. Raises ConnectionLost."""
    try:
        if path.name == NAME:
            path.parent.mkdir(mode=OWNERS_FOLDER, exist_ok=True)
            if path.parent.stat().st_uid != os.getuid():
                raise _cannot(path, "its folder is another user's")
        if not path.exists() and not path.is_symlink():
            return
        if not stat.S_ISSOCK(path.stat().st_mode):
            raise _cannot(path, "something that is no socket is there")
        if _answers(path):
            raise _cannot(path, "another nserver is reached there")
        path.unlink()
    except OSError as error:
        if isinstance(error, ConnectionLost):
            raise
        raise _cannot(path, error.strerror or str(error)) from error


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        try:
            caller.connect(str(path))
        except ConnectionRefusedError:
            return False
    return True


def _cannot(path: Path, reason: str) -> ConnectionLost:
    return ConnectionLost(f"cannot be controlled at {path}: {reason}; --control PATH takes another place")


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
