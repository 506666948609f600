"""AsyncRobot has every method of Robot, executed in a thread of its own; cancelled calls end by themselves."""

from __future__ import annotations

import asyncio
import inspect
import threading

import pytest

from nclient import AsyncRobot, ConnectionLost, Robot, RobotRefused, WireError
from nclient.protocol.commands import Call
from tests.nclient.scripted_server import ScriptedServer, error, robot_on


def names_of(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind) if not name.startswith("_")}


def test_async_robot_has_every_method_of_robot() -> None:
    assert names_of(Robot) - names_of(AsyncRobot) == set()


@pytest.mark.parametrize("name", sorted(names_of(Robot)))
def test_methods_have_robots_signature_and_docstring(name: str) -> None:
    plain, awaited = inspect.getattr_static(Robot, name), inspect.getattr_static(AsyncRobot, name)
    if isinstance(plain, property):
        assert isinstance(awaited, property)
    else:
        assert inspect.iscoroutinefunction(awaited)
        assert inspect.signature(awaited).parameters == inspect.signature(plain).parameters
        assert awaited.__doc__ == plain.__doc__


async def on(server: ScriptedServer) -> AsyncRobot:
    return await AsyncRobot.open(lambda: robot_on(server))


async def test_calls_run_in_one_thread_besides_the_loop() -> None:
    server, threads = ScriptedServer(), set()
    answer = server.send

    def send(data: bytes) -> None:
        threads.add(threading.current_thread().name)
        answer(data)

    # The names of the threads that send are recorded.
    server.send = send  # type: ignore[method-assign]  # a scripted server is made to answer late

    async with await on(server) as robot:
        server.slots = {0: 10, 17: 9}
        # Five calls at once: they must be queued, as one connection has one exchange at a time.
        states = await asyncio.gather(*[robot.refresh() for _ in range(5)])
        assert [state.sonars_in[0] for state in states] == [9] * 5
        assert robot.state == states[-1]
        assert robot.model.name == "n150"
        closed = [robot.closed]
    assert [*closed, robot.closed] == [False, True]
    assert server.names() == ["gs"] * 5 + ["st", "disconnect_robot"]
    assert len(threads) == 1
    assert threading.current_thread().name not in threads


async def test_errors_are_raised_by_await() -> None:
    async with await on(ScriptedServer({"zr": error(4)})) as robot:
        with pytest.raises(RobotRefused, match="zr"):
            await robot.zero()
        with pytest.raises(WireError):
            await robot.execute(Call("nonsense"))
        with pytest.raises(TypeError):
            await robot.drive(translation_in_s=1, translation_m_s=1)


class DelayedServer:
    """Delay the reply to gs until the test sets `go`."""

    def __init__(self, server: ScriptedServer) -> None:
        self.received, self.go = threading.Event(), threading.Event()
        answer = server.send

        def send(data: bytes) -> None:
            # The bytes of gs: type 15, no words.
            if data == bytes.fromhex("000f0000"):
                self.received.set()
                assert self.go.wait(10)
            answer(data)

        server.send = send  # type: ignore[method-assign]  # a scripted server is made to answer late


async def test_a_cancelled_call_leaves_the_robot_usable() -> None:
    server = ScriptedServer()
    delay = DelayedServer(server)

    async with await on(server) as robot:
        asking = asyncio.ensure_future(robot.refresh())
        # The task is cancelled after its request was sent, and before the reply.
        await asyncio.to_thread(delay.received.wait, 10)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        delay.go.set()
        await robot.stop()
    # The reply to gs was received after all, before st was sent; the second st is that of the end of the block.
    assert server.names() == ["gs", "st", "st", "disconnect_robot"]


async def test_a_program_that_is_cancelled_still_stops_its_robot() -> None:
    server = ScriptedServer()
    delay = DelayedServer(server)

    async def program() -> None:
        async with await on(server) as robot:
            await robot.refresh()

    running = asyncio.ensure_future(program())
    await asyncio.to_thread(delay.received.wait, 10)
    # Cancelled while gs waits for its reply: the robot must be stopped nevertheless.
    running.cancel()
    delay.go.set()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert server.names() == ["gs", "st", "disconnect_robot"]


async def test_robot_is_stopped_while_another_task_sleeps() -> None:
    server = ScriptedServer()
    async with await on(server) as robot:
        sleeping = asyncio.ensure_future(robot.sleep(60))
        # The sleeping task begins first.
        await asyncio.sleep(0)
        await asyncio.wait_for(robot.stop(), 10)
        assert not sleeping.done()
        sleeping.cancel()
    assert server.names() == ["st", "st", "disconnect_robot"]


async def test_nothing_is_sent_after_disconnecting() -> None:
    server = ScriptedServer()

    robot = await on(server)
    await robot.disconnect()
    await robot.disconnect()
    with pytest.raises(ConnectionLost, match="connect again"):
        await robot.refresh()
    assert server.names() == ["disconnect_robot"]


async def test_a_failed_connection_raises() -> None:
    def refuse() -> Robot:
        raise ConnectionLost("no answer")

    with pytest.raises(ConnectionLost, match="no answer"):
        await AsyncRobot.open(refuse)


async def test_a_cancelled_connection_is_closed() -> None:
    server = ScriptedServer()
    begun, go = threading.Event(), threading.Event()

    def slowly() -> Robot:
        begun.set()
        assert go.wait(10)
        robot: Robot = robot_on(server)
        return robot

    opening = asyncio.ensure_future(AsyncRobot.open(slowly))
    await asyncio.to_thread(begun.wait, 10)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    # The thread that connects cannot be cancelled: it must close the connection that it gets.
    thread = next(thread for thread in threading.enumerate() if thread.name.startswith("nomad-robot"))
    go.set()
    await asyncio.to_thread(thread.join, 10)
    assert server.names() == ["disconnect_robot"]


