"""Which plan of faults is in force in a daemon, and an injector for each of its lines. Pure: the clock is handed in.

    put(plan) ──> injector("serial:1")  injector("nserver")  ...        counts of all lines together

Rules: one injector a line, whoever talks over it and however often: its counts outlive connections. Without a plan
there are injectors without rules, so that who once asked goes on asking.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from nclient.errors import FaultPlanError
from nclient.faults.injector import Injector
from nclient.faults.plan import Plan

NOTHING = Plan()


class FaultDesk:
    """See the head of this file. `clock`: seconds that only grow."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._since_s = clock()
        self._injectors: dict[str, Injector] = {}
        self.plan = NOTHING

    def put(self, plan: Plan, lines: Iterable[str]) -> None:
        """This plan is in force from now on, all its counts at 0. `lines`: those that there are.

        Raises FaultPlanError where a rule names a line that is not there; the plan before it then stays.
        """
        lines = tuple(lines)
        for rule in plan.rules:
            for named in rule.lines:
                if not any(named in (line, line.partition(":")[0]) for line in lines):
                    raise FaultPlanError(f"rule {rule.name!r}: line: there is no {named} here, but {', '.join(lines)}")
        self.plan = plan
        self._since_s = self._clock()
        self._injectors = {line: Injector(plan, line, self._since_s) for line in lines}

    def clear(self) -> None:
        """No plan from now on."""
        self.put(NOTHING, ())

    def acts_on(self, line: str) -> bool:
        """Whether a rule in force is for that line."""
        return any(rule.acts_on(line) for rule in self.plan.rules)

    def injector(self, line: str) -> Injector:
        """What acts on that line at present."""
        if line not in self._injectors:
            self._injectors[line] = Injector(self.plan, line, self._since_s)
        return self._injectors[line]

    def counts(self) -> dict[str, dict[str, dict[str, int]]]:
        """What happened under this plan: by line, by rule, by kind (nclient.faults.injector.Injector.counts)."""
        return {line: injector.counts for line, injector in self._injectors.items() if injector.counts}

    def reset(self) -> None:
        """Count from 0 again."""
        for injector in self._injectors.values():
            injector.reset()
