"""Gateway: Nserver's clients drive a real robot through the same calls.

    call ──> real_robot, simulated_robot: select which of the two a connection's robot is, for all its clients
         ──> world, window, server; robots without a real counterpart: the simulation
         ──> everything else: RealRobotProxy ──> plan ──> ownership ──> RobotWorker ──> deferred reply

Access to one real robot (`Ownership`):

    queries, ct, ws, st     every connection, at any time
    motions                 the owner; where there is none, the connection that moves the robot first becomes it
    all other changes       the owner; every connection while there is none

Nothing here waits, starts a thread or reads a clock: the clock is passed in, and a reply that needs time is deferred.

Shadow simulation: the simulated robot repeats the real one's calls, and the two states are compared.

    calls that the real robot made ──> the same calls to the simulation ──> both State vectors ──> ShadowReport

The differences are real minus simulated, per quantity, in inches, degrees and seconds. A sonar is compared where both
robots have an echo; cases in which only one has an echo are counted. 255 is no echo, 0 a defective sonar.
"""

from __future__ import annotations

import csv
import io
import json
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from nclient.backends.base import Backend
from nclient.common.files import write_errors_as
from nclient.errors import AddressError, RecordingError, RobotRefused
from nclient.protocol import types
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import BUMPER_SLOT, EVERYTHING, FULL_TURN_TENTHS, Model, rad_from_tenths, tcp_wire_state
from nserver_emu.gateway import real_robot
from nserver_emu.gateway.real_robot import SLOW, STOP, Job, JobResult, Link, RobotWorker, whole_state
from nserver_emu.server.estop import MOTIONS, moves
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import INFRARED, POSE_SLOTS, SONAR, SPEED_SLOT, VELOCITY_SLOTS, state_slots
from nserver_emu.server.session import REFUSED, Answer, ConnectionContext, DeferredReply, done, error_reply
from nserver_emu.simulation.robot import SimulatedRobot

log = logging.getLogger(__name__)

# Slots of State
_X, _Y, _STEERING, _TURRET = POSE_SLOTS

_NO_ECHO: Final = (0, 255)
_SIMULATION_SPEED: Final = 0
ALL_SONARS: Final = "sonars_in"
SYNCHRO_VELOCITIES: Final = ("translation_in_s", "steering_deg_s", "turret_deg_s")
WHEEL_VELOCITIES: Final = ("right_wheel_in_s", "left_wheel_in_s")
_COLUMNS: Final = ("count", "mean", "std", "max", "last", "one_sided")


@dataclass(slots=True)
class RunningStatistics:
    """Mean, standard deviation and extreme of a sequence of differences that is not stored.

    Attributes
    ----------
    largest : the difference farthest from 0, with its sign.
    one_sided : number of times that only one of the two robots had a reading.

    References
    ----------
    B. P. Welford, "Note on a method for calculating corrected sums of squares and products", Technometrics 4 (1962).
    """

    count: int = 0
    mean: float = 0.0
    largest: float = 0.0
    last: float = 0.0
    one_sided: int = 0
    _sum_of_squares: float = 0.0

    def add(self, difference: float) -> None:
        """Add a difference d. Welford: M2 += (d - old mean) (d - new mean)."""
        self.count += 1
        deviation = difference - self.mean
        self.mean += deviation / self.count
        self._sum_of_squares += deviation * (difference - self.mean)
        self.last = difference
        if abs(difference) > abs(self.largest):
            self.largest = difference

    @property
    def std(self) -> float:
        """Standard deviation of the sample; 0 for fewer than two differences."""
        return math.sqrt(self._sum_of_squares / (self.count - 1)) if self.count > 1 else 0.0

    def as_numbers(self) -> dict[str, Any]:
        """Return the figures of a report."""
        return {"count": self.count, "mean": self.mean, "std": self.std, "max": self.largest, "last": self.last,
                "one_sided": self.one_sided}  # fmt: skip


class ShadowReport:
    """Differences between a real robot and its simulation; `quantities` by name, in the order of State."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.states = 0
        self._axes = SYNCHRO_VELOCITIES if model.has_turret else WHEEL_VELOCITIES
        self._infrareds = [f"infrared_{number}" for number in range(16)] if model.has_infrared else []
        self._sonars = [f"sonar_{number}_in" for number in range(16)]
        names = ("x_in", "y_in", "steering_deg", "turret_deg", *self._axes, "compass_deg", "bumpers", *self._infrareds,
                 ALL_SONARS, *self._sonars)  # fmt: skip
        self.quantities = {name: RunningStatistics() for name in names}

    def compare(self, real: Sequence[int], simulated: Sequence[int]) -> None:
        """Add the differences of two State vectors of one moment: 45 numbers each in wire units, bumpers clean."""
        self.states += 1
        # 1. Positions and velocities, tenths of an inch or degree.
        lengths = [(_X, "x_in"), (_Y, "y_in"), *zip(VELOCITY_SLOTS, self._axes, strict=False)]
        for slot, name in lengths:
            self.quantities[name].add((real[slot] - simulated[slot]) / 10)
        # 2. Angles.
        for slot, name in ((_STEERING, "steering_deg"), (_TURRET, "turret_deg"), (types.COMPASS_SLOT, "compass_deg")):
            self.quantities[name].add(angle_difference_deg(real[slot] - simulated[slot]))
        # 3. Bumpers (number of differing bits) and range sensors.
        self.quantities["bumpers"].add((real[BUMPER_SLOT] ^ simulated[BUMPER_SLOT]).bit_count())
        for slot, name in zip(INFRARED.slots, self._infrareds, strict=False):
            self.quantities[name].add(real[slot] - simulated[slot])
        for slot, name in zip(SONAR.slots, self._sonars, strict=True):
            self._compare_sonar(name, real[slot], simulated[slot])

    def summary(self) -> str:
        """Return one line: mean and standard deviation of the main quantities, and the number of one-sided echoes."""
        parts = [f"{name} {found.mean:+.2f} ± {found.std:.2f}" for name, found in self.quantities.items()
                 if name in ("x_in", "y_in", "steering_deg", ALL_SONARS)]
        one_sided = self.quantities[ALL_SONARS].one_sided
        return f"{self.states} states: {', '.join(parts)}; {one_sided} echoes measured by one alone"

    def _compare_sonar(self, name: str, real: int, simulated: int) -> None:
        echoes = (real not in _NO_ECHO) + (simulated not in _NO_ECHO)
        for found in (self.quantities[name], self.quantities[ALL_SONARS]):
            if echoes == 2:
                found.add(real - simulated)
            else:
                found.one_sided += echoes

    def write(self, address: str, path: Path) -> None:
        """Write the report: CSV for a .csv file, else JSON.

        Raises
        ------
        RecordingError
            If the file cannot be written.
        """
        text = self.as_csv() if path.suffix.lower() == ".csv" else self.as_json(address)
        with write_errors_as(RecordingError, path, "the report of the shadow"):
            path.write_text(text, encoding="utf-8")

    def as_json(self, address: str) -> str:
        """Return address, model, number of compared states, and the quantities by name."""
        whole = {
            "robot": address, "model": self.model.name, "states": self.states, "difference": "real less simulated",
            "quantities": {name: found.as_numbers() for name, found in self.quantities.items()},
        }  # fmt: skip
        return json.dumps(whole, indent=2) + "\n"

    def as_csv(self) -> str:
        """Return the quantities, one row each, below a row of names."""
        text = io.StringIO()
        rows = csv.DictWriter(text, ("quantity", *_COLUMNS), lineterminator="\n")
        rows.writeheader()
        for name, found in self.quantities.items():
            rows.writerow({"quantity": name, **found.as_numbers()})
        return text.getvalue()


def angle_difference_deg(difference_tenths: int) -> float:
    """Wrap a difference of two directions, in tenths of a degree, to [-180, 180) degrees."""
    half = FULL_TURN_TENTHS // 2
    return ((difference_tenths + half) % FULL_TURN_TENTHS - half) / 10


class SimulatedBackend:
    """A simulated robot as a client backend. Deferred replies are dropped: the shadow does not wait for them."""

    greeting: Reply | None = None
    port = 1
    closed = False
    link = None

    def __init__(self, simulate: Answer, robot_id: int, model: Model) -> None:
        self.wire_state = tcp_wire_state(model)
        self._simulate = simulate
        self._context = ConnectionContext(self.wire_state, robot_id)

    def execute(self, call: Call) -> Reply:
        """Return the simulation's reply.

        Raises
        ------
        RobotRefused
            If the simulation refuses the call.
        """
        answer = self._simulate(call, self._context)
        if not isinstance(answer, Reply):
            return Reply("none")
        if answer.kind == "error":
            raise RobotRefused(call.name, answer.values[0])
        return answer

    def close(self) -> None:
        """Do nothing: the backend holds no resources."""


class ShadowSimulation:
    """Repeats a real robot's calls on the simulated robot and compares their states.

    The simulation's encoders start where the robot's are; its position in the map is the start pose of the simulation.

    Parameters
    ----------
    backend : the simulated robot as a backend.
    robot : returns the simulated robot.
    link : the link to the real robot.
    """

    def __init__(self, backend: Backend, robot: Callable[[], SimulatedRobot], link: Link) -> None:
        self.report = ShadowReport(link.model)
        self._backend = backend
        self._robot = robot
        self._link = link
        self._is_aligned = False

    def update(self, calls: Iterable[Call], state: Reply | None) -> None:
        """Make the calls that the robot made; compare with its state, if there is one."""
        for call in calls:
            try:
                self._backend.execute(call)
            except RobotRefused as error:
                log.warning("shadow: %s%s in the simulation: %s", call.name, call.args, error)
        if state is None:
            return
        real = whole_state(state, self._link)
        if not self._is_aligned:
            self._robot().define_position(real[_X] / 10, real[_Y] / 10)
            self._robot().define_angles(rad_from_tenths(real[_STEERING]), rad_from_tenths(real[_TURRET]))
            self._is_aligned = True
        self.report.compare(real, state_slots(self._robot(), _SIMULATION_SPEED))


# Calls that only the owner may make, or any connection while there is none.
_CHANGES: Final = MOTIONS | {
    "lp", "sp", "ac", "dp", "da", "place_robot", "tk", "special_request", "arm_ws",
    "conf_ir", "conf_sn", "conf_cp", "conf_ls", "conf_tm", "conf_sg", "conf_ser",
}  # fmt: skip

TIMEOUT_S: Final = 5
"""Watchdog time-out (conf_tm) of the real robot where no client sets one: it stops the robot if the gateway dies."""
POLL_S: Final = 0.05
"""Interval at which ws asks whether the axes still move."""
# The robot's clock is a 32-bit word of milliseconds.
_CLOCK_MODULUS_MS: Final = 2**32
REAL, SIMULATED = "real_robot", "simulated_robot"

WrapBackend = Callable[[Backend], Backend]
"""Puts wrappers, such as a speed limit, around a backend."""


def changes(call: Call) -> bool:
    """Return True if the call changes the robot.

    st does not count, and neither does an mv that leaves all axes alone, which programs use to ping.
    """
    if call.name == "mv":
        return any(call.args[::2])
    return call.name in _CHANGES


class Ownership:
    """Access of connections to one real robot.

    The owner gives the robot up by closing its connection or by lp. A read-only robot cannot be moved by any
    connection; stopping it is always allowed.
    """

    def __init__(self, *, read_only: bool = False) -> None:
        self.read_only = read_only
        self.owner: ConnectionContext | None = None

    def allows(self, call: Call, context: ConnectionContext) -> bool:
        """Return True if this connection may make the call now.

        An allowed motion makes the connection the owner; lp releases the robot.
        """
        if not changes(call):
            return True
        if self.read_only or not self.is_free_for(context):
            return False
        if call.name == "lp":
            self.owner = None
        elif moves(call):
            self.owner = context
        return True

    def is_free_for(self, context: ConnectionContext) -> bool:
        """Return True if no other connection owns the robot."""
        return self.owner is None or self.owner is context


class RealRobotProxy:
    """The real counterpart of one simulated robot: ownership, masks and watchdog of its connections.

    The watchdog (conf_tm) belongs to the owner: it must send something within its time-out, since requests of other
    connections do not count. Where no connection has set one, TIMEOUT_S applies, and the proxy refreshes the robot's
    watchdog while the robot is owned.

    Parameters
    ----------
    open_backend : opens the connection to the robot; raises where it cannot.
    clock : returns seconds, monotonic.
    read_only : refuse everything that changes the robot.
    feed_s : longest time without a request to an owned robot, in seconds.
    """

    def __init__(self, open_backend: Callable[[], Backend], clock: Callable[[], float], *, read_only: bool = False,
                 feed_s: float = TIMEOUT_S / 3) -> None:
        self.ownership = Ownership(read_only=read_only)
        self.active = True
        """True while connections drive this robot, False while they drive the simulated one."""
        self.last: Reply | None = None
        """The latest state."""
        self.shadow: ShadowSimulation | None = None
        self._clock = clock
        self._feed_s = feed_s
        self._last_sent_s = self._owner_seen_s = clock()
        self._is_stopped_by_timeout = False
        self._stamp_masks: dict[ConnectionContext, int] = {}
        self._stamp_mask = 0
        self._timeout: tuple[ConnectionContext, int] | None = None
        self.robot = RobotWorker(open_backend, self.opening_calls)

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """Return the reply to a connection's call, or a deferred reply."""
        self._note_owner_alive(context)
        # 1. Translate: the calls for the robot, and the reply that is made from its last answer.
        translated = real_robot.plan(call, context, self.robot.link)
        if isinstance(translated, int):
            return error_reply(translated)
        # 2. Check that this connection may do that.
        if not self.ownership.allows(call, context):
            return error_reply(REFUSED)
        # 3. Calls that depend on what other connections have set.
        match call.name:
            case "ws":
                return self._wait(call.args, context)
            case "ct":
                translated = translated._replace(calls=self._set_stamp_mask(context) or translated.calls)
            case "conf_tm":
                self._timeout = (context, translated.calls[0].args[0]) if call.args[0] > 0 else None
                translated = real_robot.TranslatedCall((self._timeout_call(),), translated.build_reply)
        # 4. Queue the calls. A request for the state shares the reply that others wait for.
        if translated.calls != (real_robot.REFRESH,):
            return self._defer(self._submit(translated.calls, call), translated.build_reply, context)
        if self.robot.current_command in SLOW and self.last is not None:  # the latest state; its clock shows its age
            return translated.build_reply(context, self.last, self.robot.link)
        return self._defer(self.refresh(), translated.build_reply, context)

    def on_disconnect(self, context: ConnectionContext) -> None:
        """Handle a closed connection: stop a robot that it owned, cancel a time-out that it set."""
        self._stamp_masks.pop(context, None)
        # The order matters: the stop is queued before the watchdog is set back.
        if self.ownership.owner is context:
            self.release()
        if self._timeout is not None and self._timeout[0] is context:
            self._timeout = None
            self._submit((self._timeout_call(),))

    def stop(self) -> None:
        """Stop the robot, whichever connection owns it."""
        self._submit((STOP,))

    def release(self) -> None:
        """Stop the robot and remove its owner."""
        self.ownership.owner = None
        if not self.ownership.read_only:
            self._submit((STOP,))

    def tick(self) -> None:
        """Process results; refresh the watchdog of an owned robot, or stop it if its owner is silent for too long."""
        self.process_results()
        if not self.active or self.ownership.owner is None:
            return
        # No client's time-out: the proxy itself refreshes the watchdog, by requests for the state.
        if self._timeout is None:
            if self._elapsed_s(self._last_sent_s) >= self._feed_s:
                self.refresh()
        elif self._elapsed_s(self._owner_seen_s) > self._timeout[1] and not self._is_stopped_by_timeout:
            log.warning("the real robot's owner sent nothing for %d s, its time-out: stopped", self._timeout[1])
            self._is_stopped_by_timeout = True
            self._submit((STOP,))

    def refresh(self) -> Job:
        """Request the state."""
        self._last_sent_s = self._clock()
        return self.robot.refresh()

    def process_results(self) -> None:
        """Take over the results of finished jobs and pass them to the shadow simulation."""
        while self.robot.finished:
            job = self.robot.finished.popleft()
            assert job.result is not None
            states = [reply for reply in job.result.replies if reply.kind == "state"]
            self.last = states[-1] if states else self.last
            is_slow = job.calls[0].name in SLOW  # the shadow began it when it was submitted
            self._update_shadow(() if is_slow else job.simulated_calls, states[-1] if states else None)

    def opening_calls(self, link: real_robot.Link, reconnected: bool) -> Iterable[Call]:
        """Yield the first calls after a (re)connection: stop where the robot was lost, watchdog, mask."""
        if not self.ownership.read_only:
            # While the robot was lost its clients may have wanted it to stop.
            yield from (STOP,) if reconnected else ()
            yield self._timeout_call()
        if link.masks:
            yield Call("ct", EVERYTHING.with_position(self._stamp_mask).smask)

    @property
    def shutdown_calls(self) -> tuple[Call, ...]:
        """The last calls at the end: a stop, unless the robot is read-only."""
        return () if self.ownership.read_only else (STOP,)

    def close(self) -> None:
        """Stop the robot and close its connection. May be called twice."""
        self.robot.close(*self.shutdown_calls)
        self.process_results()

    def _note_owner_alive(self, context: ConnectionContext) -> None:
        """Restart the owner's time-out; a connection that is about to become the owner counts as well."""
        if self.ownership.is_free_for(context):
            self._owner_seen_s = self._clock()
            self._is_stopped_by_timeout = False

    def _elapsed_s(self, since_s: float) -> float:
        """Return the seconds since then at the robot's pace: a simulation behind another Nserver may run faster."""
        # State[0] is ten times the pace.
        pace = real_robot.REAL_TIME if self.last is None else self.last.slots.get(SPEED_SLOT, real_robot.REAL_TIME)
        return (self._clock() - since_s) * pace / real_robot.REAL_TIME

    def _submit(self, calls: tuple[Call, ...], request: Call | None = None) -> Job:
        self._last_sent_s = self._clock()
        if calls[0].name in SLOW and not self.robot.is_silent:
            self._update_shadow(calls)
        return self.robot.submit(calls, moves=request is not None and moves(request), request=request)

    def _update_shadow(self, calls: Iterable[Call], state: Reply | None = None) -> None:
        """Let the shadow simulation make the calls that the robot made, or begins now and needs long for."""
        if self.shadow is not None and self.active:
            self.shadow.update(calls, state)

    def _defer(self, job: Job, build_reply: real_robot.ReplyBuilder, context: ConnectionContext) -> DeferredReply:
        def poll() -> Reply | None:
            self._note_owner_alive(context)
            self.process_results()
            return None if job.result is None else self._reply(job.result, build_reply, context)

        return poll

    def _reply(self, result: JobResult, build_reply: real_robot.ReplyBuilder, context: ConnectionContext) -> Reply:
        if result.code is not None:
            return error_reply(result.code)
        return build_reply(context, result.replies[-1], self.robot.link)

    def _wait(self, args: tuple[int, ...], context: ConnectionContext) -> DeferredReply:
        """Return the deferred reply of ws: the state is polled, so that other connections can stop the robot meanwhile.

        The time-out runs on the robot's own clock, which is simulated time where the robot is a simulation.
        """
        axes = sum(bool(flag) << axis for axis, flag in enumerate(args[:3]))
        timeout_ms = 1000 * max(0, args[3])
        start_ms: int | None = None
        job: Job | None = None
        last_poll_s = 0.0

        def poll() -> Reply | None:
            nonlocal start_ms, job, last_poll_s
            self._note_owner_alive(context)
            # 1. Request the state, at most once per POLL_S.
            if job is None:
                if start_ms is None or self._clock() - last_poll_s >= POLL_S:
                    job, last_poll_s = self.refresh(), self._clock()
                return None
            # 2. Wait for it.
            self.process_results()
            if job.result is None:
                return None
            result, job = job.result, None
            # 3. Done if no selected axis moves, or the time-out has passed.
            if result.code is None:
                state = result.replies[-1]
                now_ms = state.clock or 0
                start_ms = now_ms if start_ms is None else start_ms
                if real_robot.moving_axes(state) & axes and (now_ms - start_ms) % _CLOCK_MODULUS_MS < timeout_ms:
                    return None
            return self._reply(result, real_robot.state_for, context)

        return poll

    def _set_stamp_mask(self, context: ConnectionContext) -> tuple[Call, ...]:
        """Return the ct call that a connection's new mask requires; empty if it requires none.

        The robot sends all slots, with the position stamps that any of the connections wants.
        """
        self._stamp_masks[context] = context.wire_state.mask.position
        union = 0
        for mask in self._stamp_masks.values():
            union |= mask
        if union == self._stamp_mask:
            return ()
        self._stamp_mask = union
        return (Call("ct", EVERYTHING.with_position(union).smask),)

    def _timeout_call(self) -> Call:
        timeout_s = TIMEOUT_S if self._timeout is None else self._timeout[1]
        return Call("conf_tm", (min(timeout_s, real_robot.MAX_TIMEOUT_S),))


class Gateway:
    """An emulator in which some robots have a real counterpart.

    Switching between the real and the simulated robot is refused (ERROR 5) while another connection owns the robot;
    the one that is left is stopped.

    Parameters
    ----------
    emulator : answers everything that no real robot answers.
    proxies : the real robots by number.
    shadow : let the simulated robots repeat what the real ones do.
    wrap : wrappers around the simulated robots as backends, the same as around the real ones.

    Raises
    ------
    AddressError
        If a simulated robot is of another model than its real counterpart.
    """

    def __init__(self, emulator: Emulator, proxies: Mapping[int, RealRobotProxy], *, shadow: bool = False,
                 wrap: WrapBackend = lambda backend: backend) -> None:
        self.proxies = proxies
        self._emulator = emulator
        for robot_id, proxy in proxies.items():
            simulated, link = partial(self._simulated, robot_id), proxy.robot.link
            if simulated().model.family != link.model.name:
                raise AddressError(f"robot {robot_id} is a {simulated().model.family} in the simulation and really a "
                                   f"{link.model.name}; model= in the address and --robot must say the same")
            if shadow:
                backend = wrap(SimulatedBackend(emulator.answer, robot_id, link.model))
                proxy.shadow = ShadowSimulation(backend, simulated, link)
                proxy.refresh()

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """Return the reply to a call, or a deferred one: from the real robot where the connection's robot is one."""
        proxy = None if context.robot_id is None else self.proxies.get(context.robot_id)
        if proxy is None:
            return self._emulator.answer(call, context)
        if call.name in (REAL, SIMULATED):
            return self._switch(proxy, context, to_real=call.name == REAL)
        if not proxy.active or real_robot.stays_here(call.name):
            return self._emulator.answer(call, context)
        answer = self._emulator.estop.execute(call, context, proxy.answer)
        return answer if isinstance(answer, Reply) else self._emulator.estop.until_held(answer, call, context)

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot, the real one too where it is driven, and refuse motions until it is released."""
        self._emulator.hold(robot_id, by)
        proxy = self.proxies.get(robot_id)
        if proxy is not None and proxy.active:
            proxy.stop()

    def on_disconnect(self, context: ConnectionContext) -> None:
        """Handle a closed connection: stop what it drove, real or simulated."""
        self._emulator.on_disconnect(context)
        for proxy in self.proxies.values():
            proxy.on_disconnect(context)

    def tick(self) -> None:
        """Let all real robots process results and time-outs."""
        for proxy in self.proxies.values():
            proxy.tick()

    def _switch(self, proxy: RealRobotProxy, context: ConnectionContext, *, to_real: bool) -> Reply:
        if not proxy.ownership.is_free_for(context):
            return error_reply(REFUSED)
        if proxy.active != to_real:
            log.warning("robot %d is the %s one from now on", context.robot, "real" if to_real else "simulated")
            if to_real:
                self._simulated(context.robot).stop()
                self._emulator.invalidate_state_cache()
            else:
                proxy.release()
            proxy.active = to_real
        return done()

    def _simulated(self, robot_id: int) -> SimulatedRobot:
        return self._emulator.simulation.robots[robot_id]
