"""Asks a robot what a doctor needs to know, and never moves it: gs many times, then every question its model has.

Rules: gs and get_ only. Time is handed in: `clock` gives seconds, `sleep` lets them pass. A connection that a missing
answer closed is opened anew. Who has no clock of its own (State[0] is 0: lockstep) is not waited for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from nclient.backends.backend import Backend
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import COMMANDS, Call, Command, on_line
from nclient.robot import Robot
from nclient.robot_state import RobotState

EXCHANGES: Final = 100
INTERVAL_S: Final = 0.03
"""Between two questions, so that a hundred of them see a ring of sonars go round three times."""
MOST_LOSSES: Final = 10
"""Answers missing in a row after which nobody is there."""
_QUESTIONS: Final = tuple(row for row in COMMANDS if row.name.startswith("get_"))
_NOT_THE_ROBOTS: Final = frozenset({"get_rpx", "get_robot_conf"})
_TROUBLES: Final = (ConnectionLost, ReplyTimeout, RobotRefused, WireError)


@dataclass(slots=True)
class Chart:
    """What was found out.

    states      after each gs that was answered
    latencies   seconds that each of those took
    losses      what went wrong with the others, as it was told
    elapsed_s   from the first gs to the last
    answers     by C name of each question: "" for a good answer, else what went wrong
    link        the link's own counts, where it keeps any
    """

    model: str = ""
    on_line: bool = False
    states: list[RobotState] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)
    elapsed_s: float = 0.0
    answers: dict[str, str] = field(default_factory=dict)
    link: dict[str, int] = field(default_factory=dict)

    @property
    def asked(self) -> int:
        """How often gs went out."""
        return len(self.states) + len(self.losses)


class Examination:
    """One robot. `opens`: a new conversation with it. Raises ConnectionLost where nobody is there from the start."""

    def __init__(
        self, opens: Callable[[], Backend], clock: Callable[[], float], sleep: Callable[[float], None]
    ) -> None:
        self._opens = opens
        self._clock, self._sleep = clock, sleep
        self._backend = opens()
        self._robot = Robot(self._backend)

    def run(self, exchanges: int = EXCHANGES, interval_s: float = INTERVAL_S) -> Chart:
        """Ask all there is to ask."""
        chart = Chart(self._robot.model.name, self._backend.terms.line)
        try:
            self._measure(chart, exchanges, interval_s)
            if chart.states:
                self._question(chart)
            self._count(chart)
        finally:
            self._robot.disconnect()
        return chart

    def _measure(self, chart: Chart, exchanges: int, interval_s: float) -> None:
        start_s, missing = self._clock(), 0
        for _ in range(exchanges):
            asked_s = self._clock()
            try:
                state = self._connected().refresh()
            except _TROUBLES as error:
                chart.losses.append(str(error))
                missing += 1
                if missing >= MOST_LOSSES:
                    break
                continue
            missing = 0
            now_s = self._clock()
            chart.states.append(state)
            chart.latencies.append(now_s - asked_s)
            chart.elapsed_s = now_s - start_s
            if chart.on_line or state.raw[0]:
                self._sleep(max(0.0, interval_s - (now_s - asked_s)))

    def _question(self, chart: Chart) -> None:
        for row in _QUESTIONS:
            if row.name not in _NOT_THE_ROBOTS and self._has(row, chart.on_line):
                chart.answers[row.name] = self._answer(row)

    def _answer(self, row: Command) -> str:
        """What is wrong with the answer, asked twice where it was none."""
        told = ""
        for _ in range(2):
            try:
                self._connected().execute(Call(row.name))
                return ""
            except _TROUBLES as error:
                told = str(error)
        return told

    def _has(self, row: Command, line: bool) -> bool:
        """Whether this model has what the question asks for. Nserver answers for the compass of a N150, too."""
        model = self._robot.model
        if line:
            return on_line(row, model)
        lacks = {"get_ir": not model.has_infrared, "get_cp": not model.has_turret,
                 "get_ls": not model.has_laser, "get_sg": not model.has_laser}
        return not lacks.get(row.name, False)

    def _connected(self) -> Robot:
        if self._robot.closed:
            self._backend = self._opens()
            self._robot = Robot(self._backend)
        return self._robot

    def _count(self, chart: Chart) -> None:
        link = getattr(self._backend, "link", None)
        if link is not None:
            chart.link = link.counts()
