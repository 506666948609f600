"""What the commands act upon: the simulation with all that a server adds to it. No wire units, no command by name.

    Stage    simulation | pace | graphics | traces | transcript | arms | who drives which robot | what the setup allows

Rules: handlers change it, the daemon and the viewer read it. Connections come and go; everything else is what a
snapshot keeps, but for what people at a window do: waiting clicks, holds.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from nclient.protocol.models import model_named
from nclient.protocol.replies import Reply
from nclient.protocol.terms import Terms, line_terms
from nserver_emu.server.admission.limits import Limits
from nserver_emu.server.conversation.session import Later, Told, Visit
from nserver_emu.server.stage.arm import Arm
from nserver_emu.server.stage.clicks import Clicks
from nserver_emu.server.stage.drivers import ALL_AXES, Drivers
from nserver_emu.server.stage.graphics import Graphics
from nserver_emu.server.stage.holds import Holds
from nserver_emu.server.stage.layers import layers
from nserver_emu.server.stage.pace import Pace
from nserver_emu.server.stage.promises import Promises
from nserver_emu.server.stage.state_reply import Look, clock_ms, state_reply
from nserver_emu.server.stage.traces import Traces
from nserver_emu.server.stage.transcript import Transcript
from nserver_emu.simulation.instants import PS_PER_S, to_ps, to_s
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from worlds.world import World

_LIMITS: Final = Limits()
PIECE_PS: Final = PS_PER_S // 10
"""The longest time that passes before those who wait for it are asked, a tenth of a second."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """What clients may do beyond driving robots: end the server (`quit`), change the time (`control`); and the limits
    that decide answers (limits.py)."""

    quit: bool = False
    control: bool = False
    obstacles: int = _LIMITS.obstacles
    graphics: int = _LIMITS.graphics
    frame: int = _LIMITS.frame


class Stage:
    """See the head of this file. `port` is what CONNECT answers; `quitting` is set once a client ended the server."""

    def __init__(
        self, simulation: Simulation, *, port: int = 1, pace: Pace | None = None, allowed: Allowed | None = None
    ) -> None:
        self.simulation = simulation
        self.port = port
        self.pace = pace or Pace()
        self.allowed = allowed or Allowed()
        self.quitting = False
        self.graphics = Graphics()
        self.traces = Traces()
        self.traces.note(simulation)
        self.transcript = Transcript()
        self.arms: dict[int, Arm] = {}
        self.drivers = Drivers()
        self.holds = Holds()
        self.shown: dict[str, World] = {}
        """Worlds whose text was told to somebody, who may want to have them back (switches.py)."""
        self._line_terms: dict[int, Terms] = {}
        self.clicks = Clicks()
        self._looked: dict[int, tuple[float, Look]] = {}
        self._promises = Promises()

    def leave(self, visit: Visit) -> None:
        """A connection is gone: what moves by its commands stops."""
        self.look_anew()
        self._promises.drop(visit)
        self.clicks.forget(visit)
        self.drivers.leave(visit, self.simulation.robots)
        for robot_id in self.drivers.leave_arms(visit):
            self.stop_arm(robot_id)

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot, and let nobody move it until it is released (holds.py). Raises KeyError for no robot."""
        self.simulation.robots[robot_id].stop()
        self.stop_arm(robot_id)
        self.look_anew()
        self.holds.put(robot_id, by)

    def pass_time(self, seconds: float) -> None:
        """Let simulated time pass, for whatever reason; who waits for it is answered as of the moment it is due."""
        left_ps = to_ps(seconds)
        while left_ps:
            piece_ps = min(left_ps, PIECE_PS)
            self.simulation.step(to_s(piece_ps))
            self.traces.note(self.simulation)
            for robot_id in self.arms:
                self._arm(robot_id)
            self._promises.ask()
            left_ps -= piece_ps

    def promise(self, visit: Visit, later: Later) -> Later:
        """The same answer, made at the moment it is there even if nobody asks for it then."""
        return self._promises.make(visit, later)

    def break_promises(self, visit: Visit) -> None:
        """This connection is told no more of what it waited for."""
        self._promises.drop(visit)

    def look_anew(self) -> None:
        """Something changed other than by time: no look at a robot is still good."""
        self._looked.clear()

    def robot_of(self, visit: Visit) -> SimulatedRobot:
        """The robot that this connection talks to."""
        assert visit.robot_id is not None
        return self.simulation.robots[visit.robot_id]

    def feed(self, visit: Visit) -> None:
        """A connection asks something, or waits: the time-out of its robot begins anew, unless only others drive it."""
        assert visit.robot_id is not None
        robot = self.robot_of(visit)
        if self.drivers.may_feed(visit, visit.robot_id, robot):
            robot.feed()

    def drive(self, visit: Visit, axes: Iterable[int] = ALL_AXES) -> SimulatedRobot:
        """The robot, these axes of it from now on obeying this connection."""
        assert visit.robot_id is not None
        self.drivers.take(visit, visit.robot_id, axes)
        return self.robot_of(visit)

    def line_terms(self, robot_id: int) -> Terms:
        """Mask and laser mode in force on a robot's own lines: the robot's, whoever asks by which of them, and after
        he has left. As at power-on in a simulation that is restored."""
        if robot_id not in self._line_terms:
            self._line_terms[robot_id] = line_terms(model_named(self.simulation.robots[robot_id].model.family))
        return self._line_terms[robot_id]

    def arm_of(self, visit: Visit) -> Arm:
        """The arm of the connection's robot, as it is now."""
        assert visit.robot_id is not None
        self.arms.setdefault(visit.robot_id, Arm())
        return self._arm(visit.robot_id)

    def stop_arm(self, robot_id: int) -> None:
        """An arm stops, where that robot has one that was ever moved."""
        if robot_id in self.arms:
            self._arm(robot_id).stop()

    def _arm(self, robot_id: int) -> Arm:
        """An arm as it is now; the robot's time-out has stopped it when it struck."""
        arm, struck_s = self.arms[robot_id], self.simulation.robots[robot_id].timed_out_s
        if struck_s is not None and arm.time_s < struck_s:
            arm.advance_to(struck_s)
            arm.stop()
        arm.advance_to(self.simulation.time_s)
        return arm

    def state(self, visit: Visit) -> Reply:
        """The state reply that most commands answer with.

        Between two steps a robot changes by commands only, so many who ask cost one look at it; on a line they get
        the same reply.
        """
        assert visit.robot_id is not None
        robot, now_s = self.simulation.robots[visit.robot_id], self.simulation.time_s
        looked_s, look = self._looked.get(visit.robot_id, (None, None))
        if look is None or looked_s != now_s:
            look = Look(robot, self.pace.speed_tenths)
            self._looked[visit.robot_id] = (now_s, look)
        if not visit.terms.line:
            return state_reply(robot, visit, now_s, look)
        told, mask, mode = visit.told, visit.terms.mask, visit.terms.laser_mode
        if told is None or told.look is not look or told.mask is not mask or told.laser_mode != mode:
            told = visit.told = Told(look, mask, mode, state_reply(robot, visit, now_s, look))
        return told.reply

    def layers(self, robot_id: int) -> dict[str, Any]:
        """What the window of a robot shows now, as plain data (layers.py). Raises KeyError for no robot."""
        return layers(robot_id, self.simulation.robots[robot_id], self.traces, self.graphics)

    @property
    def clock_ms(self) -> int:
        """Simulated milliseconds since the start."""
        return clock_ms(self.simulation.time_s)
