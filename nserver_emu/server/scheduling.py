"""Fair scheduling of connections: event-loop turns bounded by cost, and shared by the processor time that each used.

    bytes from a port -> may_run_now()?  yes -> the request is answered at once
                                         no  -> submit() -> a later turn of the event loop, in order of virtual time

While the event loop is idle nothing is queued and nothing is measured. Otherwise start-time fair queueing decides
(`FairScheduler`), so that the delay a client sees does not depend on how many requests others send, nor on what they
cost; only a single request is indivisible.

References
----------
Goyal, Vin and Cheng, Start-time fair queueing, SIGCOMM 1996.
"""

from __future__ import annotations

import asyncio
import time
from heapq import heappop, heappush
from math import inf
from typing import Final, Protocol

# Time that all connections together may use in one turn of the event loop. Between two turns the loop polls its
# sockets, which takes some 15 us: 3 % of this.
TURN_BUDGET_S: Final = 0.0005


class Job(Protocol):
    """A connection, or anything else that shares the event loop."""

    # True while it waits in the queue; set to False to withdraw it.
    is_queued: bool
    # Processor time that it had used in virtual time when it was last served.
    finish_tag_s: float

    def run_turn(self) -> None:
        """Do the work of one turn; submit itself again if some is left."""
        ...


class FairScheduler:
    """Start-time fair queueing of jobs by processor time.

    A job gets a start tag, the later of the virtual time and the end of its own last service. The job with the
    earliest tag runs, its tag becomes the virtual time, and what it costs moves its own next tag. So a job that rested
    is next in line, and those with a backlog share equally, whatever their requests cost.

    Attributes
    ----------
    turns, served
        Number of turns that had queued work, and of jobs that were run in them.
    """

    def __init__(self) -> None:
        self.turns = 0
        self.served = 0
        self._virtual_s = 0.0
        # Queued jobs by start tag; the number decides between equal tags: first come, first served.
        self._queue: list[tuple[float, int, Job]] = []
        self._number = 0
        # Jobs submitted while a turn runs: they wait for the next one, since the loop must poll its sockets first.
        self._submitted: list[Job] = []
        self._is_turn_scheduled = False
        # End of the period in which work may be done at once.
        self._end_s = 0.0

    def __len__(self) -> int:
        return len(self._queue)

    def may_run_now(self, now_s: float) -> bool:
        """Return True if work that has just arrived may be done at once; otherwise `submit` it."""
        if self._is_turn_scheduled:
            return False
        if now_s >= self._end_s + TURN_BUDGET_S:
            # Nothing was done for so long that this is another turn.
            self._end_s = now_s + TURN_BUDGET_S
        return now_s < self._end_s

    def submit(self, job: Job) -> None:
        """Queue a job for a later turn of the event loop."""
        job.is_queued = True
        self._submitted.append(job)
        if not self._is_turn_scheduled:
            self._is_turn_scheduled = True
            asyncio.get_running_loop().call_soon(self._run_turn)

    def _run_turn(self) -> None:
        """Run queued jobs until the time of this turn is used up, each at most once."""
        # 1. What was submitted since the last turn joins the queue.
        for job in self._submitted:
            self._number += 1
            heappush(self._queue, (max(self._virtual_s, job.finish_tag_s), self._number, job))
        self._submitted.clear()
        # 2. Jobs by their tags, until one that has run and has more to do is before all others.
        self.turns += 1
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        self._end_s, first_again_s = now_s + TURN_BUDGET_S, inf
        while self._queue and now_s < self._end_s and self._queue[0][0] <= first_again_s:
            self._virtual_s, _, job = heappop(self._queue)
            if job.is_queued:
                self._run(job)
                now_s = loop.time()
                if job.is_queued:
                    first_again_s = min(first_again_s, job.finish_tag_s)
        # 3. The rest follows in the next turn.
        self._is_turn_scheduled = bool(self._queue or self._submitted)
        if self._is_turn_scheduled:
            loop.call_soon(self._run_turn)

    def _run(self, job: Job) -> None:
        """Run a job and charge it for its processor time."""
        self.served += 1
        job.is_queued = False
        start_s = time.thread_time()
        job.run_turn()
        job.finish_tag_s = self._virtual_s + time.thread_time() - start_s
