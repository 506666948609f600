"""AsyncRobot: every name of Robot, on a thread of its own; what is cancelled ends by itself and hurts nothing."""

from __future__ import annotations

import asyncio
import inspect
import threading

import pytest

from nclient import AsyncRobot, ConnectionLost, Robot, RobotRefused, WireError
from nclient.protocol.commands import Call
from tests.nclient.answering import ScriptedServer, error, robot_on


def names_of(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind) if not name.startswith("_")}


def test_every_name_of_robot_is_there() -> None:
    assert names_of(Robot) - names_of(AsyncRobot) == set()


@pytest.mark.parametrize("name", sorted(names_of(Robot)))
def test_methods_are_awaited_with_the_same_signature_and_docstring(name: str) -> None:
    plain, awaited = inspect.getattr_static(Robot, name), inspect.getattr_static(AsyncRobot, name)
    if isinstance(plain, property):
        assert isinstance(awaited, property)
    else:
        assert inspect.iscoroutinefunction(awaited)
        assert inspect.signature(awaited).parameters == inspect.signature(plain).parameters
        assert awaited.__doc__ == plain.__doc__


async def on(server: ScriptedServer) -> AsyncRobot:
    return await AsyncRobot.open(lambda: robot_on(server))


def test_calls_run_on_one_thread_that_is_not_the_loops() -> None:
    server, threads = ScriptedServer(), set()
    answer = server.send

    def send(data: bytes) -> None:
        threads.add(threading.current_thread().name)
        answer(data)

    server.send = send  # type: ignore[method-assign]  # a scripted server is made to answer late

    async def several() -> None:
        async with await on(server) as robot:
            server.slots = {0: 10, 17: 9}
            states = await asyncio.gather(*[robot.refresh() for _ in range(5)])
            assert [state.sonars_in[0] for state in states] == [9] * 5
            assert robot.state == states[-1]
            assert robot.model.name == "n150"
            assert not robot.closed
        assert robot.closed

    asyncio.run(several())
    assert server.names() == ["gs"] * 5 + ["st", "disconnect_robot"]
    assert len(threads) == 1
    assert threading.current_thread().name not in threads


def test_errors_are_raised_where_it_is_awaited() -> None:
    async def refused() -> None:
        async with await on(ScriptedServer({"zr": error(4)})) as robot:
            with pytest.raises(RobotRefused, match="zr"):
                await robot.zero()
            with pytest.raises(WireError):
                await robot.execute(Call("nonsense"))
            with pytest.raises(TypeError):
                await robot.drive(translation_in_s=1, translation_m_s=1)

    asyncio.run(refused())


class Held:
    """A server that keeps its answer to gs back until the test lets it go."""

    def __init__(self, server: ScriptedServer) -> None:
        self.asked, self.go = threading.Event(), threading.Event()
        answer = server.send

        def send(data: bytes) -> None:
            if data == bytes.fromhex("000f0000"):
                self.asked.set()
                assert self.go.wait(10)
            answer(data)

        server.send = send  # type: ignore[method-assign]  # a scripted server is made to answer late


def test_a_cancelled_wait_leaves_the_robot_usable() -> None:
    server = ScriptedServer()
    held = Held(server)

    async def cancelled() -> None:
        async with await on(server) as robot:
            asking = asyncio.ensure_future(robot.refresh())
            await asyncio.to_thread(held.asked.wait, 10)
            asking.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asking
            held.go.set()
            await robot.stop()

    asyncio.run(cancelled())
    assert server.names() == ["gs", "st", "st", "disconnect_robot"]


def test_a_program_that_is_cancelled_still_stops_its_robot() -> None:
    server = ScriptedServer()
    held = Held(server)

    async def program() -> None:
        async with await on(server) as robot:
            await robot.refresh()

    async def cancel_it() -> None:
        running = asyncio.ensure_future(program())
        await asyncio.to_thread(held.asked.wait, 10)
        running.cancel()
        held.go.set()
        with pytest.raises(asyncio.CancelledError):
            await running

    asyncio.run(cancel_it())
    assert server.names() == ["gs", "st", "disconnect_robot"]


def test_after_leaving_nothing_is_asked_and_leaving_again_is_fine() -> None:
    server = ScriptedServer()

    async def leave() -> None:
        robot = await on(server)
        await robot.disconnect()
        await robot.disconnect()
        with pytest.raises(ConnectionLost, match="connect again"):
            await robot.refresh()

    asyncio.run(leave())
    assert server.names() == ["disconnect_robot"]


def test_a_connection_that_fails_is_told() -> None:
    async def fails() -> None:
        with pytest.raises(ConnectionLost, match="nobody"):
            await AsyncRobot.open(nobody)

    def nobody() -> Robot:
        raise ConnectionLost("nobody")

    asyncio.run(fails())


def test_a_connection_nobody_waits_for_any_more_is_given_up() -> None:
    server = ScriptedServer()
    begun, go = threading.Event(), threading.Event()

    def slowly() -> Robot:
        begun.set()
        assert go.wait(10)
        robot: Robot = robot_on(server)
        return robot

    async def give_up() -> None:
        opening = asyncio.ensure_future(AsyncRobot.open(slowly))
        await asyncio.to_thread(begun.wait, 10)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        thread = next(thread for thread in threading.enumerate() if thread.name.startswith("nomad-robot"))
        go.set()
        await asyncio.to_thread(thread.join, 10)

    asyncio.run(give_up())
    assert server.names() == ["disconnect_robot"]


