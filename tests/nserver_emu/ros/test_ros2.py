"""ROS 2 by DDS: topics, quality of service, driving and stopping, with Cyclone DDS as the other side."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import signal
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from cyclonedds.qos import Policy

from nserver_emu.ros.dds import running_node
from nserver_emu.ros.options import LOOPBACK, config_of
from nserver_emu.ros.topics import MAX_DELAY_S, Estimates, RobotClock
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S, parse_estimate
from tests.nserver_emu.ros.other_side import (
    BEST_EFFORT,
    LATCHED,
    RELIABLE,
    TYPES,
    OtherSide,
    free_domain,
    is_cdr,
    take_bytes,
    twist,
)
from tests.nserver_emu.ros.test_rosbridge import ESTIMATE
from tests.nserver_emu.server.wire_client import simulation
from worlds.world import World

TIMEOUT_S = 20.0
# A domain of this process: other tests publish at the same time.
DOMAIN = free_domain()
ODOMETRY, SCAN, RANGE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Range"
FRAMES, GRID = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/OccupancyGrid"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def decode(data: bytes, kind: str) -> Any:
    """Return a message as rosbags reads it."""
    return TYPES.store.deserialize_cdr(data, kind)


class Served(OtherSide):
    """A daemon in the test's event loop, and a participant beside it."""

    def __init__(self, daemon: Daemon, estimates: Estimates) -> None:
        super().__init__(DOMAIN)
        self.daemon, self.estimates = daemon, estimates
        self.robot = daemon.emulator.simulation.robots[1]

    async def until(self, is_right: Callable[[], Any]) -> Any:
        async with asyncio.timeout(TIMEOUT_S):
            while not (found := is_right()):
                await asyncio.sleep(0.01)
        return found

    async def next(self, name: str, kind: str, qos: Any = RELIABLE) -> Any:
        """Return the next message of a topic, decoded by rosbags, whose encoding of it is the same."""
        reader = self.reader(name, kind, qos)
        (data, *_) = await self.until(lambda: take_bytes(reader))
        message = decode(data, kind)
        # The same bytes as an independent encoder writes.
        assert is_cdr(data, bytes(TYPES.store.serialize_cdr(message, kind)))
        return message

    async def drive(self, writer: Any, speed_m_s: float, turn_rad_s: float = 0.0) -> None:
        """Publish velocities until the robot moves."""
        async with asyncio.timeout(TIMEOUT_S):
            while not any(self.robot.moving):
                writer.write(twist(speed_m_s, turn_rad_s))
                await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def serve(*, has_map: bool = False) -> AsyncIterator[Served]:
    daemon, estimates, stop = Daemon(Emulator(simulation())), Estimates(), asyncio.Event()
    await daemon.listen("127.0.0.1", 0)
    running = asyncio.create_task(daemon.serve(stop))
    try:
        async with running_node(daemon, "jazzy", DOMAIN, config_of(LOOPBACK), estimates, has_map=has_map):
            yield Served(daemon, estimates)
    finally:
        stop.set()
        await running


async def test_topics_have_units_and_frames() -> None:
    async with serve(has_map=True) as here:
        odometry = await here.next("/robot1/odom", ODOMETRY)
        assert (odometry.header.frame_id, odometry.child_frame_id) == ("robot1/odom", "robot1/base_link")
        scan = await here.next("/robot1/sonar", SCAN, BEST_EFFORT)
        ring_m = here.robot.model.body.sonar_ring_radius_in * 0.0254
        # Readings of 6 in and of 255 in are limits.
        limits = {6: -math.inf, 255: math.inf}
        readings = [round(one) for one in here.robot.sonar.readings_in]
        assert scan.ranges.tolist() == pytest.approx([limits.get(one, one * 0.0254 + ring_m) for one in readings])
        one = await here.next("/robot1/sonar/3", RANGE, BEST_EFFORT)
        assert (one.header.frame_id, one.range) == ("robot1/sonar_3", pytest.approx(scan.ranges[3] - ring_m))
        volts = await here.next("/robot1/battery", "sensor_msgs/msg/BatteryState")
        assert 10 < volts.voltage < 13
        # BatteryState has NaN for quantities that are not measured.
        assert math.isnan(volts.current)
        frames = (await here.next("/tf", FRAMES)).transforms
        assert [one.child_frame_id for one in frames] == ["robot1/base_link", "robot1/turret"]
        fixed = (await here.next("/tf_static", FRAMES, LATCHED)).transforms
        assert [one.child_frame_id for one in fixed] == [f"robot1/sonar_{k}" for k in range(16)]


async def test_map_is_kept_for_late_subscribers_and_follows_the_world() -> None:
    async with serve(has_map=True) as here:
        grid = await here.next("/map", GRID, LATCHED)
        assert len(grid.data) == grid.info.width * grid.info.height
        assert set(grid.data.tolist()) == {-1, 0, 100}
        reader = here.reader("/map", GRID, LATCHED)
        await here.until(lambda: take_bytes(reader))
        simulated = here.daemon.emulator.simulation
        simulated.change_world(simulated.world.with_inner_wall(0, (20.0, 20.0, 30.0, 20.0)))
        (data, *_) = await here.until(lambda: take_bytes(reader))
        # A new wall has more occupied cells.
        assert sum(decode(data, GRID).data == 100) > sum(grid.data == 100)


async def test_world_without_walls_has_no_map(caplog: pytest.LogCaptureFixture) -> None:
    async with serve(has_map=True) as here:
        here.daemon.emulator.simulation.change_world(World("plain"))
        await here.until(lambda: "no walls" in caplog.text)
        await here.next("/robot1/odom", ODOMETRY)


async def test_quality_of_service_is_that_of_ros_2() -> None:
    """As the other side sees it; readers that ask for more do not match."""
    async with serve() as here:
        found = {}
        for name, kind in (("/robot1/odom", ODOMETRY), ("/robot1/sonar", SCAN), ("/robot1/sonar/0", RANGE),
                           ("/tf", FRAMES), ("/tf_static", FRAMES)):  # fmt: skip
            reader = here.reader(name, kind, BEST_EFFORT)
            (handle,) = await here.until(reader.get_matched_publications)
            found_writer = reader.get_matched_publication_data(handle)
            assert found_writer is not None
            policies = set(found_writer.qos)
            # The hash lets ROS 2 nodes check that both sides have the same message type.
            assert Policy.Userdata(f"typehash={TYPES.type_hash(kind)};".encode()) in policies
            found[name] = Policy.Reliability.BestEffort not in policies, Policy.Durability.TransientLocal in policies
        # Reliable or not, and stored for late subscribers or not.
        state, sensor = (True, False), (False, False)
        expected = [state, sensor, sensor, state, (True, True)]
        assert list(found.values()) == expected


async def test_robot_stops_when_its_publisher_leaves() -> None:
    async with serve() as here:
        writers = [here.writer("/robot1/cmd_vel")]
        odometry = here.reader("/robot1/odom", ODOMETRY)

        def velocities() -> list[Any]:
            writers[0].write(twist(0.127, 0.2))
            new = [decode(data, ODOMETRY).twist.twist for data in take_bytes(odometry)]
            return [one for one in new if one.linear.x]

        (found, *_) = await here.until(velocities)
        assert found.linear.x == pytest.approx(0.127)
        assert found.angular.z == pytest.approx(0.2, abs=0.002)
        # A last message, then the writer is deleted: its end must stop the robot before the timeout does.
        writers[0].write(twist(0.127))
        writers.clear()
        await here.until(lambda: not any(here.robot.moving))


@pytest.mark.parametrize("qos", [RELIABLE, BEST_EFFORT])
async def test_robot_stops_when_its_publisher_is_silent(qos: Any) -> None:
    async with serve() as here:
        writer = here.writer("/robot1/cmd_vel", qos=qos)
        await here.drive(writer, 0.127)
        silent_s = asyncio.get_running_loop().time()
        await here.until(lambda: not any(here.robot.moving))
        assert asyncio.get_running_loop().time() - silent_s < DRIVE_TIMEOUT_S + 1.0


async def test_second_publisher_does_not_stop_the_first() -> None:
    """One that leaves stops only what it moved, as with every client."""
    async with serve() as here:
        first, second = here.writer("/robot1/cmd_vel"), here.writer("/robot1/cmd_vel")
        odometry = here.reader("/robot1/odom", ODOMETRY)

        def is_fast() -> bool:
            first.write(twist(0.127))
            new = [decode(data, ODOMETRY) for data in take_bytes(odometry)]
            return any(one.twist.twist.linear.x > 0.1 for one in new)

        await here.drive(second, 0.05)
        await here.until(is_fast)
        del second
        for _ in range(10):
            first.write(twist(0.127))
            await asyncio.sleep(0.02)
        assert any(here.robot.moving)


async def test_wrong_velocities_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with serve() as here:
        writer = here.writer("/robot1/cmd_vel")
        for _ in range(10):
            await here.until(lambda: writer.write(twist(math.nan)) or "is nan" in caplog.text)
            await asyncio.sleep(0.02)
        # NaN is published ten times and logged once.
        assert caplog.text.count("is nan") == 1
        assert not any(here.robot.moving)
        here.daemon.hold([1], "a test")
        await here.until(lambda: writer.write(twist(1.0)) or "held" in caplog.text)


async def test_publishers_are_limited(caplog: pytest.LogCaptureFixture) -> None:
    async with serve() as here:
        object.__setattr__(here.daemon.admission.limits, "viewers", 0)
        writer = here.writer("/robot1/cmd_vel")
        await here.until(lambda: writer.write(twist(0.1)) or "limit-viewers" in caplog.text)
        # Its next messages are not logged: those of another publisher come after them.
        writer.write(twist(0.1))
        other = here.writer("/robot1/cmd_vel")
        await here.until(lambda: other.write(twist(0.1)) or caplog.text.count("limit-viewers") > 1)
        for _ in range(5):
            writer.write(twist(0.1))
            other.write(twist(0.1))
            await asyncio.sleep(0.02)
        assert caplog.text.count("limit-viewers") == 2
        assert not any(here.robot.moving)


async def test_estimates_are_poses_in_the_map() -> None:
    async with serve() as here:
        poses, frames = here.reader("/robot1/pose", POSE), here.reader("/tf", FRAMES)
        await here.until(poses.get_matched_publications)
        await here.until(lambda: take_bytes(frames))
        here.estimates.add(1, parse_estimate(json.dumps(ESTIMATE)))
        # 10 in are 0.254 m.
        (data, *_) = await here.until(lambda: take_bytes(poses))
        found = decode(data, POSE)
        assert (found.header.frame_id, found.pose.covariance[35]) == ("map", 0.01)
        assert found.pose.pose.position.x == pytest.approx(0.254)

        def is_localized() -> bool:
            new = [decode(one, FRAMES) for one in take_bytes(frames)]
            return any(one.transforms[0].header.frame_id == "map" for one in new)

        await here.until(is_localized)


def test_times_follow_the_robots_clock() -> None:
    """Delays of the line do not move them; a clock that is set, or stands still, begins anew."""
    clock = RobotClock()
    delays_s = [0.2, 0.01, 0.3, 0.0, 0.5]
    # The clock of the robot advances by 0.1 s; messages arrive late by up to 0.5 s.
    times = [clock.time_ns(k * 0.1, 1000 + k * 0.1 + delay) / 1e9 for k, delay in enumerate(delays_s)]
    assert times == pytest.approx([1000.2, 1000.11, 1000.21, 1000.3, 1000.4], abs=1e-3)
    assert clock.past_time_ns(0.1, 1000.5) / 1e9 == pytest.approx(1000.1, abs=1e-3)
    assert clock.past_time_ns(99.0, 1000.5) == 1000.5e9
    assert clock.time_ns(0.0, 1001.0 + MAX_DELAY_S) / 1e9 == pytest.approx(1001.0 + MAX_DELAY_S)
    # A clock that is slow by 0.01 %.
    for k in range(2000):
        late_s = 2000 + k - clock.time_ns(k * 0.9999, 2000 + k) / 1e9
    assert late_s == pytest.approx(0.0, abs=1e-3)


SUBSCRIBER = """
import sys, time
from tests.nserver_emu.ros.other_side import *
here = OtherSide(int(sys.argv[1]), own_domain=True)
odometry, velocity = here.reader("/robot1/odom", "nav_msgs/msg/Odometry"), here.writer("/robot1/cmd_vel")
far = 0.0
while far < 0.02:
    velocity.write(twist(0.2))
    for data in take_bytes(odometry):
        message = TYPES.store.deserialize_cdr(data, "nav_msgs/msg/Odometry")
        assert is_cdr(data, bytes(TYPES.store.serialize_cdr(message, "nav_msgs/msg/Odometry")))
        far = message.pose.pose.position.x
    time.sleep(0.02)
print("moved", flush=True)
while True:
    velocity.write(twist(0.2))
    time.sleep(0.02)
"""


@pytest.mark.long
async def test_program_that_is_killed_stops_its_robot() -> None:
    async with serve() as here:
        program = [sys.executable, "-c", SUBSCRIBER, str(DOMAIN)]
        process = await asyncio.create_subprocess_exec(*program, stdout=asyncio.subprocess.PIPE)
        try:
            assert process.stdout is not None
            assert await asyncio.wait_for(process.stdout.readline(), 60) == b"moved\n"
            await here.until(lambda: any(here.robot.moving))
            process.send_signal(signal.SIGKILL)
            await here.until(lambda: not any(here.robot.moving))
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.communicate()
