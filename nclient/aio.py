"""AsyncRobot: the methods of Robot as coroutines, executed by one thread per robot.

    state = await robot.refresh()

Each method is derived from that of Robot by `_awaitable`, which preserves its signature. If an awaiting task is
cancelled, its exchange still ends by its own deadline; the next call is sent after it, and the robot stays usable.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial, update_wrapper, wraps
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from nclient.backends.base import LinkStatistics
from nclient.errors import ConnectionLost
from nclient.protocol.types import Model
from nclient.robot import Robot
from nclient.state import RobotState

P = ParamSpec("P")
R = TypeVar("R")


def _awaitable(method: Callable[Concatenate[Robot, P], R]
               ) -> Callable[Concatenate[AsyncRobot, P], Coroutine[Any, Any, R]]:
    """Return the method as a coroutine function."""

    @wraps(method)
    async def call(self: AsyncRobot, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return await self._run(partial(method, self._robot, *args, **kwargs))

    return call


class AsyncRobot:
    """A connected robot for asyncio, made by `nclient.connect_async`.

    Leaving its `async with` block stops the robot and disconnects.
    """

    def __init__(self, robot: Robot, thread: ThreadPoolExecutor) -> None:
        self._robot = robot
        self._thread = thread
        self._disconnected = False

    @classmethod
    async def open(cls, open_robot: Callable[[], Robot]) -> AsyncRobot:
        """Connect in a new thread, which then executes all methods of the robot."""
        thread = ThreadPoolExecutor(1, "nomad-robot")
        connecting = thread.submit(open_robot)
        try:
            return cls(await asyncio.wrap_future(connecting), thread)
        except BaseException:
            # The caller was cancelled: the thread may still connect, and the robot then has no owner.
            connecting.add_done_callback(_disconnect_unowned)
            thread.shutdown(wait=False)
            raise

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None,
                        trace: TracebackType | None) -> None:
        await self._finish(partial(self._robot.__exit__, kind, error, trace))

    async def disconnect(self) -> None:
        """Close the connection; the robot is not stopped. May be called twice. C: disconnect_robot."""
        await self._finish(self._robot.disconnect)

    async def _finish(self, disconnect: Callable[[], None]) -> None:
        """Disconnect after all submitted calls, cancelled or not, and end the thread."""
        # The executor has one thread and a queue: this runs after all calls before it. A forked child has no thread.
        if not self._disconnected and not self._robot._is_inherited:
            self._disconnected = True
            disconnecting = self._thread.submit(disconnect)
            self._thread.shutdown(wait=False)
            await asyncio.shield(asyncio.wrap_future(disconnecting))

    async def _run(self, call: Callable[[], R]) -> R:
        if self._disconnected:
            raise ConnectionLost("this robot was disconnected; connect again")
        return await asyncio.wrap_future(self._thread.submit(call))

    async def sleep(self, seconds: float) -> None:
        """Let time of the robot pass."""
        # The thread is free during a pause, so that other tasks can stop the robot.
        pauses = self._robot._pauses(seconds)
        while (pause_s := await self._run(lambda: next(pauses, None))) is not None:
            await asyncio.sleep(pause_s)

    update_wrapper(sleep, Robot.sleep)

    @property
    def state(self) -> RobotState:
        """The state after the last exchange; sends nothing and never waits."""
        return self._robot.state

    @property
    def model(self) -> Model:
        """The robot's model."""
        return self._robot.model

    @property
    def closed(self) -> bool:
        """True if the connection is over."""
        return self._robot.closed

    @property
    def link(self) -> LinkStatistics | None:
        """Statistics of the link. None over TCP without `reconnect=` in the address."""
        return self._robot.link

    drive = _awaitable(Robot.drive)
    move = _awaitable(Robot.move)
    move_to = _awaitable(Robot.move_to)
    drive_axes = _awaitable(Robot.drive_axes)
    drive_wheels = _awaitable(Robot.drive_wheels)
    move_wheels = _awaitable(Robot.move_wheels)
    stop = _awaitable(Robot.stop)
    release = _awaitable(Robot.release)
    zero = _awaitable(Robot.zero)
    wait_until_still = _awaitable(Robot.wait_until_still)
    set_speeds = _awaitable(Robot.set_speeds)
    set_accelerations = _awaitable(Robot.set_accelerations)
    set_position = _awaitable(Robot.set_position)
    set_angles = _awaitable(Robot.set_angles)
    set_timeout = _awaitable(Robot.set_timeout)
    select_sensors = _awaitable(Robot.select_sensors)
    position_data = _awaitable(Robot.position_data)
    configure_sonars = _awaitable(Robot.configure_sonars)
    configure_infrareds = _awaitable(Robot.configure_infrareds)
    configure_compass = _awaitable(Robot.configure_compass)
    configure_laser = _awaitable(Robot.configure_laser)
    configure_segments = _awaitable(Robot.configure_segments)
    configure_serial_port = _awaitable(Robot.configure_serial_port)
    refresh = _awaitable(Robot.refresh)
    read_infrareds = _awaitable(Robot.read_infrareds)
    read_sonars = _awaitable(Robot.read_sonars)
    read_pose = _awaitable(Robot.read_pose)
    read_velocities = _awaitable(Robot.read_velocities)
    read_accelerations = _awaitable(Robot.read_accelerations)
    read_compass = _awaitable(Robot.read_compass)
    read_laser = _awaitable(Robot.read_laser)
    read_bumpers = _awaitable(Robot.read_bumpers)
    read_segments = _awaitable(Robot.read_segments)
    say = _awaitable(Robot.say)
    send_packet = _awaitable(Robot.send_packet)
    read_ring = _awaitable(Robot.read_ring)
    watch_ring = _awaitable(Robot.watch_ring)
    arm_zero = _awaitable(Robot.arm_zero)
    arm_wait = _awaitable(Robot.arm_wait)
    arm_move = _awaitable(Robot.arm_move)
    execute = _awaitable(Robot.execute)
    connect_robot = _awaitable(Robot.connect_robot)
    create_robot = _awaitable(Robot.create_robot)
    place = _awaitable(Robot.place)
    read_robots = _awaitable(Robot.read_robots)
    ask_pose = _awaitable(Robot.ask_pose)
    add_obstacle = _awaitable(Robot.add_obstacle)
    delete_obstacle = _awaitable(Robot.delete_obstacle)
    move_obstacle = _awaitable(Robot.move_obstacle)
    clear_world = _awaitable(Robot.clear_world)
    predict_sensors = _awaitable(Robot.predict_sensors)
    check_motion = _awaitable(Robot.check_motion)
    draw_robot = _awaitable(Robot.draw_robot)
    draw_line = _awaitable(Robot.draw_line)
    draw_arc = _awaitable(Robot.draw_arc)
    redraw_all = _awaitable(Robot.redraw_all)
    redraw_all_traces = _awaitable(Robot.redraw_all_traces)
    redraw_actual_trace = _awaitable(Robot.redraw_actual_trace)
    redraw_encoder_trace = _awaitable(Robot.redraw_encoder_trace)
    redraw_all_sensors = _awaitable(Robot.redraw_all_sensors)
    redraw_bumper_sensor = _awaitable(Robot.redraw_bumper_sensor)
    redraw_infrared_sensor = _awaitable(Robot.redraw_infrared_sensor)
    redraw_sonar_sensor = _awaitable(Robot.redraw_sonar_sensor)
    redraw_laser_sensor = _awaitable(Robot.redraw_laser_sensor)
    redraw_client_graphics = _awaitable(Robot.redraw_client_graphics)
    use_real_robot = _awaitable(Robot.use_real_robot)
    use_simulated_robot = _awaitable(Robot.use_simulated_robot)
    quit_server = _awaitable(Robot.quit_server)
    truth = _awaitable(Robot.truth)
    is_simulated = _awaitable(Robot.is_simulated)
    held_by = _awaitable(Robot.held_by)
    wait_until_released = _awaitable(Robot.wait_until_released)
    control_time = _awaitable(Robot.control_time)


def _disconnect_unowned(connecting: Future[Robot]) -> None:
    """Disconnect a robot whose caller was cancelled while it was being connected."""
    if not connecting.cancelled() and connecting.exception() is None:
        connecting.result().disconnect()
