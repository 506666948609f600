"""Shares of the event loop: which connection works when, and how many requests per second it may make.

    work arrives -> may_run_now()?  yes -> it is done at once, then charge()
                                    no  -> submit() -> run_turn() in a later turn of the event loop

Rule: a turn of the event loop works for at most `TURN_BUDGET_S`. While that is not used up and nothing is queued, work
is done as soon as it arrives; all else is queued and ordered by start-time fair queueing, with processor time as cost.

Guarantee: the delay that a client sees does not depend on how many requests others send, nor on what they cost.

Limit: one call of `run_turn` is indivisible, so that a turn may last longer by one such call.

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

# Time that all jobs together may use in one turn of the event loop. Between two turns the loop polls its sockets, which
# takes some 15 us: 5 % of this.
TURN_BUDGET_S: Final = 0.0003
# Seconds of unused rate that an idle client accumulates.
BURST_S: Final = 0.1


class Job(Protocol):
    """A connection, or anything else that shares the event loop. All attributes begin with False or 0."""

    # True while it waits in the queue; set to False to withdraw it.
    is_queued: bool
    # Virtual time at which its last service ended; its next start tag is not before this.
    finish_tag_s: float
    # Processor time that its work has taken so far.
    cpu_s: float

    def run_turn(self) -> None:
        """Do the work of one turn, and submit the job again if some is left.

        An exception is logged by the event loop. It delays the other queued jobs to the next turn and loses none.
        """


class FairScheduler:
    """Start-time fair queueing of jobs by processor time.

    A job gets a start tag, the later of the virtual time and its finish tag. The job with the earliest start tag runs:
    its tag becomes the virtual time, and its finish tag is that plus what the work cost. So a job that rested is next
    in line, and jobs with a backlog share equally, whatever their requests cost.

    Attributes
    ----------
    turns, served
        Number of turns that had queued work, and of jobs that were run in them.
    """

    def __init__(self) -> None:
        self.turns = 0
        self.served = 0
        # Start tag of the job that runs or ran last.
        self._virtual_s = 0.0
        # Queued jobs by start tag. Of equal ones the job that rested longest is first, then the one that came first.
        self._queue: list[tuple[float, float, int, Job]] = []
        # Number of jobs queued so far, the last criterion of that order.
        self._number = 0
        # Jobs submitted since the last turn began: they wait for the next one, since the loop must poll its sockets
        # first.
        self._submitted: list[Job] = []
        self._is_turn_scheduled = False
        # Processor time left in this turn for work that is done at once, and when such work last ended.
        self._left_s = TURN_BUDGET_S
        self._worked_s = 0.0

    def __len__(self) -> int:
        return len(self._queue)

    def may_run_now(self, now_s: float) -> bool:
        """Return True if work that has just arrived may be done at once.

        The caller must then do it and `charge` what it took; otherwise it must `submit` the job.

        Parameters
        ----------
        now_s
            The event loop's time.
        """
        if self._is_turn_scheduled:
            return False
        if now_s >= self._worked_s + TURN_BUDGET_S:
            # Nothing was done for so long that this is another turn.
            self._left_s = TURN_BUDGET_S
        self._worked_s = now_s
        return self._left_s > 0.0

    def charge(self, taken_s: float) -> None:
        """Charge this turn for the processor time of work that was done at once."""
        self._left_s -= taken_s
        self._worked_s += taken_s

    def submit(self, job: Job) -> None:
        """Queue a job for a later turn of the event loop. It must not be queued already (`Job.is_queued`)."""
        job.is_queued = True
        self._submitted.append(job)
        if not self._is_turn_scheduled:
            self._schedule_turn()

    def _run_turn(self) -> None:
        """Run queued jobs until the time of this turn is used up, each at most once."""
        # 1. Jobs submitted since the last turn join the queue.
        for job in self._submitted:
            self._number += 1
            heappush(self._queue, (max(self._virtual_s, job.finish_tag_s), job.finish_tag_s, self._number, job))
        self._submitted.clear()
        # 2. Run jobs by their tags, until one that has run and has more to do is before all others.
        self.turns += 1
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        end_s, first_again_s = now_s + TURN_BUDGET_S, inf
        try:
            while self._queue and now_s < end_s and self._queue[0][0] <= first_again_s:
                self._virtual_s, _, _, job = heappop(self._queue)
                if job.is_queued:
                    self._run(job)
                    now_s = loop.time()
                    if job.is_queued:
                        first_again_s = min(first_again_s, job.finish_tag_s)
        finally:
            # 3. The rest follows in the next turn, also after an exception, which the event loop logs.
            self._is_turn_scheduled = False
            self._left_s, self._worked_s = end_s - now_s, now_s
            if self._queue or self._submitted:
                self._schedule_turn()

    def _schedule_turn(self) -> None:
        """Run a turn in the next iteration of the event loop, after the sockets are read.

        asyncio runs timers that are due after what it read, and callbacks of `call_soon` before: with those a request
        would wait for one more turn.
        """
        loop = asyncio.get_running_loop()
        self._is_turn_scheduled = True
        loop.call_at(loop.time(), self._run_turn)

    def _run(self, job: Job) -> None:
        """Run a job and charge it for its processor time."""
        self.served += 1
        job.is_queued = False
        start_s = time.thread_time()
        job.run_turn()
        taken_s = time.thread_time() - start_s
        job.cpu_s += taken_s
        job.finish_tag_s = self._virtual_s + taken_s


class TokenBucket:
    """A limit on requests per second.

    The bucket holds up to `BURST_S` of the rate, at least one turn. It may become negative by the last turn, which is
    then waited for before the next. Times are seconds of a monotonic clock.

    Parameters
    ----------
    rate
        Requests per second, above 0.
    turn
        Maximum number of requests in one turn.
    now_s
        Current time.
    """

    def __init__(self, rate: float, turn: int, now_s: float) -> None:
        self._rate = rate
        self._capacity = max(rate * BURST_S, turn)
        # Requests that may be answered now, when the bucket was last updated.
        self._tokens = self._capacity
        self._updated_s = now_s

    def consume(self, count: int, now_s: float) -> None:
        """Take tokens for `count` answered requests."""
        self._tokens = min(self._capacity, self._tokens + self._rate * (now_s - self._updated_s)) - count
        self._updated_s = now_s

    def wait_s(self, now_s: float) -> float:
        """Return the seconds until a request may be answered, 0 for now."""
        return max(0.0, -self._tokens / self._rate - (now_s - self._updated_s))
