"""The emulator in the client's own process: the address `sim:WORLD?robot=n150&seed=1&noisy=1`.

    send(bytes) ──> session ──> simulated time advances by `step_s` ──> answers, read with receive()

Rules: no socket, no clock; simulated time passes in lockstep, with each exchange and at no other moment, so that a run
repeats to the bit. Connecting and asking for the truth take no time. The client may control the time: it is its own.
nclient finds this by entry point and does not import it.
"""

from __future__ import annotations

import difflib
import math
from urllib.parse import parse_qsl

from nclient.errors import AddressError
from nserver_emu.server.handlers import Emulator
from nserver_emu.server.session import Session
from nserver_emu.server.setting import DEFAULT_WORLD, Setting, pose_from_text
from nserver_emu.server.stage import Allowed
from nserver_emu.simulation.setup import SETUPS

SCHEME = "sim"
DEFAULT_STEP_S = 0.1
_OPTIONS = ("robot", "seed", "noisy", "setup", "start", "step_s")
_FLAGS = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}


class InProcess:
    """One client's end: what it sends is answered at once, in simulated time."""

    def __init__(self, emulator: Emulator, step_s: float = DEFAULT_STEP_S) -> None:
        self.emulator = emulator
        emulator.pace.lockstep_s = step_s
        self._session = Session(emulator.answer, "in process")
        self._outgoing = bytearray()

    def send(self, data: bytes) -> None:
        """Requests, in any cuts."""
        self._session.receive(data)
        while self._session.ready or (self._session.waiting and self.emulator.pace.asked_s):
            if self._session.waiting:
                self.emulator.simulation.step(self.emulator.pace.asked_s)
                self._outgoing += self._session.tick()
            self._outgoing += self._session.answers(most=1)

    def receive(self) -> bytes:
        """What has been answered; empty when no more will come before something is sent."""
        answered = bytes(self._outgoing)
        self._outgoing.clear()
        return answered

    def close(self) -> None:
        """The client is gone; its robot stops."""
        self._session.closing = True
        self.emulator.leave(self._session.visit)


def open_address(address: str) -> InProcess:
    """The simulation that an address names.

    `sim:WORLD?robot=n150&seed=1&noisy=1&start=0,0,0,0&step_s=0.1`; the world is a shipped name or a file, every
    option may be left out. `step_s`: simulated seconds an exchange, 0.001 to 10; `setup`: ideal, noisy or measured, and
    counts before `noisy`. Raises AddressError naming the option and the nearest known, WorldFileError or StartError.
    """
    path, _, query = address.removeprefix(f"{SCHEME}:").partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    for name in options:
        if name not in _OPTIONS:
            near = difflib.get_close_matches(name, _OPTIONS, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise AddressError(f"{address}: no option {name!r}{hint} There are {', '.join(_OPTIONS)}.")
    start = options.get("start")
    setting = Setting(
        world=path or DEFAULT_WORLD,
        robot=options.get("robot", "n150"),
        start=pose_from_text(start) if start is not None else None,
        seed=_seed(address, options.get("seed", "0")),
        noisy=_flag(address, options.get("noisy", "0")),
        setup=_setup(address, options.get("setup", "")),
    )
    emulator = Emulator(setting.simulation(), allowed=Allowed(control=True))
    return InProcess(emulator, _step(address, options.get("step_s", str(DEFAULT_STEP_S))))


def _seed(address: str, text: str) -> int:
    if not text.isdecimal():
        raise AddressError(f"{address}: seed is a whole number of 0 or more, not {text!r}")
    return int(text)


def _flag(address: str, text: str) -> bool:
    try:
        return _FLAGS[text.lower()]
    except KeyError:
        raise AddressError(f"{address}: noisy is 1 or 0, not {text!r}") from None


def _setup(address: str, text: str) -> str:
    if text and text not in SETUPS:
        raise AddressError(f"{address}: setup is one of {', '.join(SETUPS)}, not {text!r}")
    return text


def _step(address: str, text: str) -> float:
    try:
        step_s = float(text)
    except ValueError:
        step_s = math.nan
    if not 0.001 <= step_s <= 10:
        raise AddressError(f"{address}: step_s is 0.001 to 10 simulated seconds an exchange, not {text!r}")
    return step_s
