"""A simulated robot on its own line, and the simulation itself beside it: what no robot knows is asked of that.

    sim_truth, sim_control ──> the simulation        all else ──> the line, which refuses what a robot's line has not

Rules: a wrapper; only the words of simulations of ours go another way.
"""

from __future__ import annotations

from typing import Final

from nclient.backends.backend import Backend
from nclient.backends.wrapper import Wrapper
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply

OF_SIMULATIONS: Final = frozenset({"sim_truth", "sim_control"})
"""Commands that only a simulation understands."""


class Beside(Wrapper):
    """The line's backend, with another one to the simulation behind it."""

    def __init__(self, line: Backend, simulation: Backend) -> None:
        super().__init__(line)
        self._simulation = simulation

    def execute(self, call: Call) -> Reply:
        """The answer of the one that understands it. Raises what that one raises."""
        if call.name in OF_SIMULATIONS and not self.closed:
            return self._simulation.execute(call)
        return super().execute(call)

    def close(self) -> None:
        """Close both."""
        super().close()
        self._simulation.close()
