"""Event-loop turns bounded by cost and shared by processor time; costs are set by the test, not measured."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field

import pytest

from nclient.protocol.commands import Call
from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.server.connection import ITERATION_BUDGET_S, MAX_PREPARING_STEPS, MIN_WAIT_S, FairScheduler
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import PREPARING_S, ServerState
from nserver_emu.server.session import ConnectionContext
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.noise import MEASURED
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarRing
from tests.nserver_emu.server.running_server import running_server
from worlds.io import load_world


class Clock:
    """Stands for the event loop's clock and for the thread's processor time."""

    now_s = 0.0


@dataclass
class Load:
    """A connection with a backlog of equally expensive requests."""

    name: str
    cost_s: float
    backlog: int
    clock: Clock
    scheduler: FairScheduler
    order: list[str]
    is_queued: bool = False
    finish_tag_s: float = 0.0
    cpu_s: float = 0.0
    turns: list[int] = field(default_factory=list)

    def run_turn(self) -> None:
        self.clock.now_s += self.cost_s
        self.backlog -= 1
        self.order.append(self.name)
        self.turns.append(self.scheduler.iterations)
        if self.backlog:
            self.scheduler.submit(self)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    # `run_turn` of a load advances the clock by its cost, which the scheduler then measures.
    monkeypatch.setattr(time, "thread_time", lambda: clock.now_s)
    return clock


async def drained(scheduler: FairScheduler, clock: Clock, loads: list[Load]) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(asyncio.get_running_loop(), "time", lambda: clock.now_s)
        for load in loads:
            scheduler.submit(load)
        while any(load.backlog for load in loads):
            await asyncio.sleep(0)


async def test_a_turn_is_bounded_by_cost_not_by_count(clock: Clock) -> None:
    scheduler = FairScheduler()
    order: list[str] = []
    # Five requests fit into the budget; fifty loads compete for it.
    loads = [Load(str(number), ITERATION_BUDGET_S / 5, 4, clock, scheduler, order) for number in range(50)]
    await drained(scheduler, clock, loads)
    served = Counter(turn for load in loads for turn in load.turns)
    # Fifty floods: the last job of a turn may exceed the budget, no other.
    assert max(served.values()) <= 6
    # No load has two turns in one iteration.
    assert all(max(Counter(load.turns).values()) == 1 for load in loads)


async def test_time_is_shared_whatever_requests_cost(clock: Clock) -> None:
    scheduler = FairScheduler()
    order: list[str] = []
    dear = Load("dear", 0.010, 20, clock, scheduler, order)
    cheap = Load("cheap", 0.0001, 1000, clock, scheduler, order)
    await drained(scheduler, clock, [dear, cheap])
    # While both have a backlog, one request of the one takes as long as a hundred of the other.
    between = order.index("dear", order.index("dear") + 1)
    assert 90 <= order[between:].index("dear", 1) <= 101


async def test_a_rested_connection_is_next(clock: Clock) -> None:
    scheduler = FairScheduler()
    order: list[str] = []
    # Fifty loads have used processor time for some iterations before the new one comes.
    floods = [Load(f"flood {number}", ITERATION_BUDGET_S / 4, 40, clock, scheduler, order) for number in range(50)]
    draining = asyncio.create_task(drained(scheduler, clock, list(floods)))
    while len(order) < 300:
        await asyncio.sleep(0)
    rested, before = Load("rested", 0.00001, 1, clock, scheduler, order), len(order)
    scheduler.submit(rested)
    await draining
    assert order.index("rested") - before <= 4  # one turn


async def test_an_idle_loop_answers_at_once() -> None:
    scheduler = FairScheduler()
    # Processor time passes as the loop's time does: the loop never waits.
    assert scheduler.may_run_now(100.0, 1.0)
    # 1. Work of 0.9 of a budget leaves a tenth of it.
    scheduler.charge(0.9 * ITERATION_BUDGET_S)
    assert scheduler.may_run_now(100.0 + 0.9 * ITERATION_BUDGET_S, 1.0 + 0.9 * ITERATION_BUDGET_S)
    # 2. The next work exceeds it: later work must wait for the next iteration.
    scheduler.charge(2.0 * ITERATION_BUDGET_S)
    for budgets in (3.0, 3.9):
        assert not scheduler.may_run_now(100.0 + budgets * ITERATION_BUDGET_S, 1.0 + budgets * ITERATION_BUDGET_S)
    # 3. Nothing was done for a whole budget, so this is another iteration.
    assert scheduler.may_run_now(100.0 + 5.0 * ITERATION_BUDGET_S, 1.0 + 5.0 * ITERATION_BUDGET_S)


async def test_a_loop_that_has_waited_is_in_another_iteration() -> None:
    scheduler = FairScheduler()
    assert scheduler.may_run_now(100.0, 1.0)
    scheduler.charge(2.0 * ITERATION_BUDGET_S)
    # The budget is used up. A tenth of it later nothing has waited; then the loop waits twice as long as it must.
    later_s = 2.1 * ITERATION_BUDGET_S
    assert not scheduler.may_run_now(100.0 + later_s, 1.0 + later_s)
    assert scheduler.may_run_now(100.0 + later_s + 2.0 * MIN_WAIT_S, 1.0 + later_s)


@pytest.mark.parametrize("waits", [False, True])
async def test_one_client_rarely_waits_for_another_turn(clock: Clock, waits: bool) -> None:
    # Its requests take a tenth of a turn and come each half turn: the time in between is not charged.
    scheduler = FairScheduler()
    at_once, waited_s = 0, 0.0
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(asyncio.get_running_loop(), "time", lambda: clock.now_s)
        for _ in range(110):
            clock.now_s += 0.4 * ITERATION_BUDGET_S
            waited_s += 0.4 * ITERATION_BUDGET_S * waits
            if scheduler.may_run_now(clock.now_s, clock.now_s - waited_s):
                scheduler.charge(0.1 * ITERATION_BUDGET_S)
                at_once += 1
            else:
                one = Load("one", 0.1 * ITERATION_BUDGET_S, 1, clock, scheduler, [])
                scheduler.submit(one)
                while one.backlog:
                    await asyncio.sleep(0)
            clock.now_s += 0.1 * ITERATION_BUDGET_S
    # At most a tenth of the 110 requests may find the budget used up, and none after the loop has waited for it.
    assert at_once == 110 if waits else at_once >= 99


async def test_nothing_overtakes_queued_work(clock: Clock) -> None:
    scheduler = FairScheduler()
    withdrawn = Load("withdrawn", 1.0, 1, clock, scheduler, [])
    # A queued job blocks immediate work, even if it is withdrawn before its turn.
    scheduler.submit(withdrawn)
    assert not scheduler.may_run_now(100.0, 1.0)
    withdrawn.is_queued = False
    await asyncio.sleep(0)
    assert withdrawn.order == []
    assert len(scheduler) == 0


async def test_a_costly_reply_is_prepared_over_several_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(load_world("several_walls"))
    simulation.add_robot(1, setup=MEASURED)
    pings: dict[int, int] = {}

    async with running_server(speed=None, emulator=Emulator(simulation)) as server:
        scheduler, client = server.daemon.scheduler, await server.connect_client()
        compute = SonarRing._compute

        # Each ping uses up the time of one preparation turn, whatever the machine's speed.
        def costly(ring: SonarRing, model: Polaroid, sonar: int) -> None:
            pings[scheduler.iterations] = pings.get(scheduler.iterations, 0) + 1
            compute(ring, model, sonar)
            end_s = time.thread_time() + PREPARING_S
            while time.thread_time() < end_s:
                pass

        # Rate 1 (4 ms a sonar): after the setting all 16 sonars fire within 64 ms of simulated time.
        await client.ask("conf_sn", 1, *DEFAULT_ORDER)
        server.daemon.emulator.clock.paused = True
        monkeypatch.setattr(SonarRing, "_compute", costly)
        assert (await client.ask("gs")).kind == "state"
    assert sum(pings.values()) == 16
    assert max(pings.values()) == 1, "each uses up a turn"


# The preparation never completes: each step of simulated time brings new work.
async def test_preparing_ends_though_new_work_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    times_ps = set[int]()

    def prepare(state: ServerState, _context: ConnectionContext, _call: Call | None = None) -> bool:
        times_ps.add(state.simulation.time_ps)
        return False

    async with running_server() as server:
        client = await server.connect_client()
        monkeypatch.setattr(ServerState, "prepare_reply", prepare)
        assert (await client.ask("gs")).kind == "state"
    assert len(times_ps) == MAX_PREPARING_STEPS
