"""How far a simulation that got the same commands differs from the real robot: real less simulated, by quantity.

    Running      one quantity: count, mean, standard deviation, largest, last (Welford's recurrence)
    Shadow       all of them, in inches, degrees and seconds; `compare` takes two State vectors of one moment

Rules: pure; no robot, no clock. Angles differ by the short way. A sonar counts where both heard something; where only
one did is counted beside it. 255 is no range, and 0 a dead sonar.

The report of a shadow as a file: JSON, or CSV where the file is called so; a row a quantity.

The simulation in the shadow of a real robot: it does what the robot did, and is compared with it.

    what the robot carried out ──> the same calls to the simulation ──> its State beside the robot's ──> Shadow

To the calls it is a backend as the robot is, so that what is put around the one (speed caps) goes around the other.
Rules: no clock and no thread; whoever calls decides when. The simulation's encoders begin where the robot's are; where
the simulated robot stands in the map is where it was started.
"""

from __future__ import annotations

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
from nclient.common.files import unwritable
from nclient.errors import RecordingError, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, FULL_TURN_TENTHS, Model, rad_from_tenths
from nclient.protocol.wire_state import tcp_terms
from nserver_emu.gateway.translate import Link, whole_state
from nserver_emu.server.session import Answer, Visit
from nserver_emu.server.state_encoder import state_slots
from nserver_emu.simulation.robot import SimulatedRobot

_X, _Y, _STEERING, _TURRET = 34, 35, 36, 37
_VELOCITIES: Final = range(38, 41)
_INFRAREDS: Final = range(1, 17)
_SONARS: Final = range(17, 33)
_NO_ECHO: Final = (0, 255)
ALL_SONARS: Final = "sonars_in"
TURNING: Final = ("translation_in_s", "steering_deg_s", "turret_deg_s")
WHEELS: Final = ("right_wheel_in_s", "left_wheel_in_s")


@dataclass(slots=True)
class Running:
    """A quantity's differences so far: none is kept but the last."""

    count: int = 0
    mean: float = 0.0
    largest: float = 0.0
    """The one farthest from 0, with its sign."""
    last: float = 0.0
    one_sided: int = 0
    """Times that only one of the two had a reading."""
    _squares: float = 0.0

    def add(self, difference: float) -> None:
        """One more. Welford 1962: M2 += (d - old mean) (d - new mean)."""
        self.count += 1
        off = difference - self.mean
        self.mean += off / self.count
        self._squares += off * (difference - self.mean)
        self.last = difference
        if abs(difference) > abs(self.largest):
            self.largest = difference

    @property
    def std(self) -> float:
        """Standard deviation of the sample; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0

    def as_numbers(self) -> dict[str, Any]:
        """For a report."""
        return {"count": self.count, "mean": self.mean, "std": self.std, "max": self.largest, "last": self.last,
                "one_sided": self.one_sided}  # fmt: skip


class Shadow:
    """The differences of one robot. `quantities` by name, in the order of State."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.states = 0
        self._axes = TURNING if model.has_turret else WHEELS
        self._infrareds = [f"infrared_{number}" for number in range(16)] if model.has_infrared else []
        self._sonars = [f"sonar_{number}_in" for number in range(16)]
        names = ("x_in", "y_in", "steering_deg", "turret_deg", *self._axes, "compass_deg", "bumpers", *self._infrareds,
                 ALL_SONARS, *self._sonars)  # fmt: skip
        self.quantities = {name: Running() for name in names}

    def compare(self, real: Sequence[int], simulated: Sequence[int]) -> None:
        """Two whole State vectors, 45 numbers in wire units, bumpers clean."""
        self.states += 1
        lengths = [(_X, "x_in"), (_Y, "y_in"), *zip(_VELOCITIES, self._axes, strict=False)]
        for slot, name in lengths:
            self.quantities[name].add((real[slot] - simulated[slot]) / 10)
        for slot, name in ((_STEERING, "steering_deg"), (_TURRET, "turret_deg"), (COMPASS_SLOT, "compass_deg")):
            self.quantities[name].add(short_way_deg(real[slot] - simulated[slot]))
        self.quantities["bumpers"].add((real[BUMPER_SLOT] ^ simulated[BUMPER_SLOT]).bit_count())
        for slot, name in zip(_INFRAREDS, self._infrareds, strict=False):
            self.quantities[name].add(real[slot] - simulated[slot])
        for slot, name in zip(_SONARS, self._sonars, strict=True):
            self._compare_sonar(name, real[slot], simulated[slot])

    def summary(self) -> str:
        """One line: mean and standard deviation of what matters most, and how often sonars disagreed."""
        parts = [
            f"{name} {found.mean:+.2f} ± {found.std:.2f}"
            for name, found in self.quantities.items()
            if name in ("x_in", "y_in", "steering_deg", ALL_SONARS)
        ]
        one_sided = self.quantities[ALL_SONARS].one_sided
        return f"{self.states} states: {', '.join(parts)}; {one_sided} echoes heard by one alone"

    def _compare_sonar(self, name: str, real: int, simulated: int) -> None:
        heard = (real not in _NO_ECHO) + (simulated not in _NO_ECHO)
        for found in (self.quantities[name], self.quantities[ALL_SONARS]):
            if heard == 2:
                found.add(real - simulated)
            else:
                found.one_sided += heard


def short_way_deg(difference_tenths: int) -> float:
    """The difference of two directions in degrees, -180 to below 180."""
    half = FULL_TURN_TENTHS // 2
    return ((difference_tenths + half) % FULL_TURN_TENTHS - half) / 10


_COLUMNS: Final = ("count", "mean", "std", "max", "last", "one_sided")


def write(shadow: Shadow, address: str, path: Path) -> None:
    """Write the report. Raises RecordingError where the file cannot be written."""
    text = as_csv(shadow) if path.suffix.lower() == ".csv" else as_json(shadow, address)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordingError(unwritable(path, error, "the report of the shadow")) from error


def as_json(shadow: Shadow, address: str) -> str:
    """Address, model, how many states were compared, and the quantities by name."""
    whole = {
        "robot": address,
        "model": shadow.model.name,
        "states": shadow.states,
        "difference": "real less simulated",
        "quantities": {name: found.as_numbers() for name, found in shadow.quantities.items()},
    }
    return json.dumps(whole, indent=2) + "\n"


def as_csv(shadow: Shadow) -> str:
    """The quantities, a row each, under a row of names."""
    text = io.StringIO()
    rows = csv.DictWriter(text, ("quantity", *_COLUMNS), lineterminator="\n")
    rows.writeheader()
    for name, found in shadow.quantities.items():
        rows.writerow({"quantity": name, **found.as_numbers()})
    return text.getvalue()


log = logging.getLogger(__name__)

_POSE = slice(34, 38)
_SPEED = 0


class Simulated:
    """A simulated robot as a backend. An answer that only time can bring is none: nobody waits for it."""

    greeting: Reply | None = None
    port = 1
    closed = False
    link = None

    def __init__(self, simulate: Answer, robot_id: int, model: Model) -> None:
        self.terms = tcp_terms(model)
        self._simulate = simulate
        self._visit = Visit(self.terms, robot_id)

    def execute(self, call: Call) -> Reply:
        """What the simulation answers. Raises RobotRefused."""
        answer = self._simulate(call, self._visit)
        if not isinstance(answer, Reply):
            return Reply("none")
        if answer.kind == "error":
            raise RobotRefused(call.name, answer.values[0])
        return answer

    def close(self) -> None:
        """Nothing is to be let go."""


class Follower:
    """`simulated`: the robot that follows, as a backend and as it is; `link` is how the real one is reached."""

    def __init__(self, simulated: Backend, robot: Callable[[], SimulatedRobot], link: Link) -> None:
        self.shadow = Shadow(link.model)
        self._simulated = simulated
        self._robot = robot
        self._link = link
        self._aligned = False

    def follow(self, calls: Iterable[Call], state: Reply | None) -> None:
        """Do what the robot did; `state` is what it said then, if it said anything."""
        for call in calls:
            try:
                self._simulated.execute(call)
            except RobotRefused as error:
                log.warning("shadow: %s%s in the simulation: %s", call.name, call.args, error)
        if state is None:
            return
        real = whole_state(state, self._link)
        if not self._aligned:
            self._align(real)
        self.shadow.compare(real, state_slots(self._robot(), _SPEED))

    def _align(self, real: list[int]) -> None:
        x, y, steering, turret = real[_POSE]
        self._robot().define_position(x / 10, y / 10)
        self._robot().define_angles(rad_from_tenths(steering), rad_from_tenths(turret))
        self._aligned = True
