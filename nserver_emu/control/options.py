"""The options of `nserver` for faults on purpose and for its owner's control while it runs.

    --faults FILE    --control [PATH]

Rules: the socket is one line on stdout, for programs.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from nclient.errors import NomadError
from nclient.faults.plan import load_plan
from nserver_emu.control.commands import answer_line
from nserver_emu.control.socket import ControlSocket, default_path

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

_SUFFIX: Final = ".sock"
_USERS_OWN: Final = Path()


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of this room."""
    group = parser.add_argument_group("faults and control")
    group.add_argument("--faults", type=Path, metavar="FILE",
                       help="a plan of faults on purpose, in TOML: what is lost, late, corrupted or refused, on "
                       "which line")
    group.add_argument("--control", type=_socket_after_a_world, nargs="?", const=_USERS_OWN, metavar="PATH",
                       help="let `nserver ctl` control the daemon over a socket that only you can open (default: one "
                       "in your runtime folder)")


def may_have_faults(options: argparse.Namespace) -> bool:
    """Whether a plan can come into force."""
    return options.faults is not None or options.control is not None


@asynccontextmanager
async def controlled(daemon: Daemon, options: argparse.Namespace) -> AsyncIterator[list[str]]:
    """Faults and control as the options say, while it lasts; what to print of it.

    Raises FaultPlanError or ConnectionLost, naming the remedy; the daemon is then closed.
    """
    try:
        control = await _begun(daemon, options)
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


async def _begun(daemon: Daemon, options: argparse.Namespace) -> ControlSocket | None:
    if options.faults:
        daemon.faults.put(load_plan(options.faults), daemon.lines())
    if options.control is None:
        return None
    path = default_path(os.environ) if options.control == _USERS_OWN else options.control
    control = ControlSocket(path, lambda line: answer_line(daemon, line))
    await control.open()
    return control


def socket_path(text: str) -> Path:
    """What may follow --control, of the daemon and of `nserver ctl`: no world and no command, which have no slash."""
    if "/" not in text and not text.endswith(_SUFFIX):
        wanted = f"a path with a slash or ending in {_SUFFIX}, such as ./nserver{_SUFFIX}"
        raise argparse.ArgumentTypeError(f"{wanted}, not {text!r}")
    return Path(text)


def _socket_after_a_world(text: str) -> Path:
    try:
        return socket_path(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}; the world goes before --control") from None
