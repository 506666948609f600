"""Shadow simulation: the simulated robot repeats the real one's calls, and the two states are compared.

    calls that the real robot made ──> the same calls to the simulation ──> both State vectors ──> ShadowReport

The differences are real minus simulated, per quantity, in inches, degrees and seconds. A sonar is compared where both
robots have an echo; cases in which only one has an echo are counted. 255 is no echo, 0 a defective sonar.
"""

import csv
import io
import json
import logging
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from nclient.backends.base import Backend
from nclient.common.files import write_errors_as
from nclient.errors import RecordingError, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, FULL_TURN_TENTHS, Model, rad_from_tenths
from nclient.protocol.wire_state import tcp_wire_state
from nserver_emu.gateway.translate import Link, whole_state
from nserver_emu.server.server_state import state_slots
from nserver_emu.server.session import Answer, ConnectionContext
from nserver_emu.simulation.robot import SimulatedRobot

log = logging.getLogger(__name__)

# Slots of State
_X, _Y, _STEERING, _TURRET = 34, 35, 36, 37
_POSE: Final = slice(34, 38)
_VELOCITIES: Final = range(38, 41)
_INFRAREDS: Final = range(1, 17)
_SONARS: Final = range(17, 33)

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
        lengths = [(_X, "x_in"), (_Y, "y_in"), *zip(_VELOCITIES, self._axes, strict=False)]
        for slot, name in lengths:
            self.quantities[name].add((real[slot] - simulated[slot]) / 10)
        # 2. Angles.
        for slot, name in ((_STEERING, "steering_deg"), (_TURRET, "turret_deg"), (COMPASS_SLOT, "compass_deg")):
            self.quantities[name].add(angle_difference_deg(real[slot] - simulated[slot]))
        # 3. Bumpers (number of differing bits) and range sensors.
        self.quantities["bumpers"].add((real[BUMPER_SLOT] ^ simulated[BUMPER_SLOT]).bit_count())
        for slot, name in zip(_INFRAREDS, self._infrareds, strict=False):
            self.quantities[name].add(real[slot] - simulated[slot])
        for slot, name in zip(_SONARS, self._sonars, strict=True):
            self._compare_sonar(name, real[slot], simulated[slot])

    def summary(self) -> str:
        """Return one line: mean and standard deviation of the main quantities, and the number of one-sided echoes."""
        parts = [
            f"{name} {found.mean:+.2f} ± {found.std:.2f}"
            for name, found in self.quantities.items()
            if name in ("x_in", "y_in", "steering_deg", ALL_SONARS)
        ]
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
            "robot": address,
            "model": self.model.name,
            "states": self.states,
            "difference": "real less simulated",
            "quantities": {name: found.as_numbers() for name, found in self.quantities.items()},
        }
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
            self._align(real)
        self.report.compare(real, state_slots(self._robot(), _SIMULATION_SPEED))

    def _align(self, real: list[int]) -> None:
        x, y, steering, turret = real[_POSE]
        self._robot().define_position(x / 10, y / 10)
        self._robot().define_angles(rad_from_tenths(steering), rad_from_tenths(turret))
        self._is_aligned = True
