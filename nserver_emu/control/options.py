"""The options of `nserver` for injected faults and for control at run time: --faults FILE, --control [PATH]."""

from __future__ import annotations

import argparse
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from nclient.errors import NomadError
from nclient.faults.plan import load_plan
from nserver_emu.control.commands import answer_line_in_thread
from nserver_emu.control.socket import ControlSocket, default_path

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

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
