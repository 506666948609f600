"""The emulator in the client's own process: the address `sim:WORLD?robot=n150&seed=1&noisy=1`.

    send(bytes) -> session -> simulated time advances by `step_s` -> replies, read with receive()

No socket and no clock: simulated time advances with each exchange (lockstep) and by what the client waits for (ws,
sim_control), so that a run is repeatable bit by bit. Connecting and sim_truth take no time. Waiting while time is
paused is ERROR 5, because nothing else could advance it. With `line=1` the robot speaks the protocol of its own serial
line (serial_session.py). nclient finds this module by entry point and does not import it.
"""

import sys
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from nclient.errors import AddressError, suggest
from nclient.protocol.types import get_model
from nclient.url import Parser, RawAddress, flag, number, whole_number
from nserver_emu.server.config import FIRST_ROBOT, MAX_ROBOTS, SimulationConfig, robot_placements
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import SerialSession
from nserver_emu.server.server_state import POLL_INTERVAL_PS, Allowed
from nserver_emu.server.session import REFUSED, BaseSession, Session
from nserver_emu.simulation.segments import to_s
from worlds.io import DEFAULT_WORLD

SCHEME = "sim"
# Simulated seconds per exchange: about what one takes over TCP, and the resolution of the clock.
DEFAULT_STEP_S = 0.001
# Simulated seconds between two looks for a deferred reply.
_WAIT_STEP_S = to_s(POLL_INTERVAL_PS)
# Options after the ? of an address (docs/addresses.md).
OPTIONS = ("robot", "robots", "model_file", "start", "seed", "noisy", "setup", "step_s", "line")
# Options that may be repeated for robot 2 and so on.
_REPEATABLE = ("robot", "start")
_FLAGS = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}


def _noisy(text: str) -> bool:
    if text.lower() not in _FLAGS:
        raise ValueError("1 or 0")
    return _FLAGS[text.lower()]


_PARSERS: dict[str, Parser] = {
    "robots": whole_number(f"a whole number from 1 to {MAX_ROBOTS}", range(1, MAX_ROBOTS + 1)),
    "seed": whole_number("a whole number of 0 or more", range(sys.maxsize)),
    "noisy": _noisy,
    "setup": str,
    "model_file": Path,
    "step_s": number("0.001 to 10 simulated seconds an exchange", lambda value: 0.001 <= value <= 10),
    # Strictly, since the client reads it as well and speaks accordingly.
    "line": flag,
}
_DEFAULTS: dict[str, Any] = {"robots": 1, "step_s": DEFAULT_STEP_S, "line": False}


class InProcess:
    """The client's end of a connection to an emulator in the same process.

    Parameters
    ----------
    emulator
        The emulator, whose clock is set to lockstep.
    step_s
        Simulated seconds per exchange.
    session
        The session; None for one over TCP.
    """

    def __init__(self, emulator: Emulator, step_s: float = DEFAULT_STEP_S,
                 session: BaseSession[Any] | None = None) -> None:
        self.emulator = emulator
        emulator.clock.lockstep_s = step_s
        self._session = session or Session(emulator.answer, "in process")
        self._outgoing = bytearray()

    def send(self, data: bytes) -> None:
        """Send request bytes, split anywhere; time advances until all whole requests are answered."""
        self._session.receive(data)
        while self._session.ready or (self._session.waiting and self.emulator.clock.step_per_request_s):
            # 1. A deferred reply needs time.
            if self._session.waiting:
                self.emulator.pass_time(max(_WAIT_STEP_S, self.emulator.clock.step_per_request_s))
                self._outgoing += self._session.tick()
            # 2. The next request.
            self._outgoing += self._session.process_requests(max_requests=1)
            # 3. A reply that cannot come because time is paused.
            if self._session.waiting and not self.emulator.clock.step_per_request_s:
                self.emulator.deferred.cancel(self._session.context)
                self._outgoing += self._session.cancel_deferred(REFUSED)

    def receive(self) -> bytes:
        """Return the reply bytes; empty if there are none before the next request."""
        answered = bytes(self._outgoing)
        self._outgoing.clear()
        return answered

    def close(self) -> None:
        """Disconnect the client; its robot stops."""
        self._session.closing = True
        self.emulator.on_disconnect(self._session.context)


class InProcessLine(InProcess):
    """The host's end of robot 1's own serial line."""

    def __init__(self, emulator: Emulator, step_s: float = DEFAULT_STEP_S) -> None:
        model = get_model(emulator.simulation.robots[FIRST_ROBOT].model.family)
        wire_state = emulator.serial_wire_state(FIRST_ROBOT)
        session = SerialSession(emulator.answer, FIRST_ROBOT, model, lambda: emulator.simulation.time_s,
                                "in process, on its line", wire_state)
        super().__init__(emulator, step_s, session)

    def send(self, data: bytes) -> None:
        """Send bytes to the robot and, if nothing replies to them, advance the time."""
        super().send(data)
        # Bytes that get no reply take a step too: a frame timeout depends on it.
        if not self._outgoing and self.emulator.clock.step_per_request_s:
            self.emulator.pass_time(self.emulator.clock.step_per_request_s)
            self._outgoing += self._session.tick()

    def beside(self) -> InProcess:
        """Return a connection over the TCP protocol to the simulation behind the line."""
        return InProcess(self.emulator, self.emulator.clock.lockstep_s or DEFAULT_STEP_S)


def open_address(address: str) -> InProcess:
    """Create the simulation of an address.

    `sim:WORLD?robot=n150&seed=1&noisy=1&start=0,0,0,0&step_s=0.001`; WORLD is a name or a file, options are optional.

    robots      number of robots, 1 to 1000; the client's is number 1, the others stand still, because each address has
                a world of its own; `robot` and `start` may be repeated for them
    model_file  a TOML file of models that override or extend the built-in ones
    setup       ideal, noisy, measured, building, worn or a TOML file; takes precedence over `noisy`
    step_s      simulated seconds per exchange, 0.001 (default) to 10
    line        1: the robot's own serial line instead of the TCP protocol

    Raises AddressError (with the option and a suggestion), WorldFileError or StartError.
    """
    path, _, query = address.removeprefix(f"{SCHEME}:").partition("?")
    given = parse_qs(query, keep_blank_values=True)
    for name, values in given.items():
        if name not in OPTIONS:
            hint = suggest(name, OPTIONS)
            raise AddressError(f"{address}: no option {name!r}{hint} There are {', '.join(OPTIONS)}.")
        if len(values) > 1 and name not in _REPEATABLE:
            raise AddressError(f"{address}: {name} is given {len(values)} times; expected once")
    once = {name: values[-1] for name, values in given.items() if name not in _REPEATABLE}
    parsed: dict[str, Any] = _DEFAULTS | RawAddress(address, SCHEME, once).parse_options(_PARSERS)
    step_s, line, robots = parsed.pop("step_s"), parsed.pop("line"), parsed.pop("robots")
    (robot, start), *others = robot_placements(given.get("robot", ["n150"]), given.get("start", []), robots)
    setting = SimulationConfig(world=path or DEFAULT_WORLD, robot=robot, start=start, others=tuple(others), **parsed)
    emulator = Emulator(setting.simulation(), allowed=Allowed(control=True))
    return (InProcessLine if line else InProcess)(emulator, step_s)
