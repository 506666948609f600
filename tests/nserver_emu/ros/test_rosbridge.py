"""rosbridge: protocol, topics, tokens, and roslibpy as the other side."""

from __future__ import annotations

import asyncio
import json
import math
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Any, cast

import aiohttp
import numpy as np
import pytest

from nclient.errors import ConnectionLost
from nserver_emu.cli import nserver_parser, read_options
from nserver_emu.ros import topics
from nserver_emu.ros.rosbridge import (
    MAX_MESSAGE,
    MAX_SUBSCRIPTIONS,
    RosbridgeClient,
    RosbridgeServer,
    Services,
    encode_published,
    serve_rosbridge,
)
from nserver_emu.ros.topics import MAP_CELL_IN, MAX_MAP_CELLS, Reading, map_cell_in
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.clients import ViewerClients
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S
from tests.nserver_emu.server.wire_client import simulation
from worlds.io import load_world
from worlds.rings import nomad_ring
from worlds.robots import N150
from worlds.world import World

HOST = "127.0.0.1"
TIMEOUT_S = 10.0
Message = dict[str, Any]


class Client:
    """A websocket of a rosbridge client."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket

    async def send(self, op: str, **message: Any) -> None:
        await self.socket.send_str(json.dumps({"op": op} | message))

    async def next(self, op: str) -> Message:
        """Return the next message of this operation."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                message: Message = json.loads(await self.socket.receive_str())
                if message["op"] == op:
                    return message

    async def topic(self, name: str, kind: str, **options: Any) -> Message:
        """Subscribe to a topic, and return its first message."""
        await self.send("subscribe", topic=name, type=kind, **options)
        while (message := await self.next("publish"))["topic"] != name:
            pass
        found: Message = message["msg"]
        return found

    async def drive(self, speed_m_s: float, turn_rad_s: float = 0.0) -> None:
        twist = {"linear": {"x": speed_m_s, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": turn_rad_s}}
        await self.send("publish", topic="/robot1/cmd_vel", msg=twist)


class Served:
    """A daemon with rosbridge in the test's event loop."""

    def __init__(self, daemon: Daemon, server: RosbridgeServer, port: int, web: aiohttp.ClientSession) -> None:
        self.daemon, self.server, self.port, self.web = daemon, server, port, web
        self.robot = daemon.emulator.simulation.robots[1]

    def url(self, token: str | None = None) -> str:
        return f"http://{HOST}:{self.port}/?token={self.server.tokens.act if token is None else token}"

    @asynccontextmanager
    async def client(self, token: str | None = None, **headers: str) -> AsyncIterator[Client]:
        async with self.web.ws_connect(self.url(token), headers=headers) as socket:
            yield Client(socket)

    async def until(self, is_right: Any) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            while not is_right():
                await asyncio.sleep(0.01)


@asynccontextmanager
async def serve(*, has_map: bool = True, origins: frozenset[str] = frozenset()) -> AsyncIterator[Served]:
    daemon = Daemon(Emulator(simulation()))
    await daemon.listen(HOST, 0)
    server, stop = RosbridgeServer(daemon, has_map=has_map, origins=origins), asyncio.Event()
    port = await server.open(HOST, 0)
    running = asyncio.create_task(daemon.serve(stop))
    try:
        async with aiohttp.ClientSession() as web:
            yield Served(daemon, server, port, web)
    finally:
        await server.close()
        stop.set()
        await running


async def test_topics_have_units_and_frames() -> None:
    async with serve() as here, here.client() as client:
        odometry = await client.topic("/robot1/odom", "nav_msgs/Odometry")
        assert odometry["header"]["frame_id"] == "robot1/odom"
        assert odometry["child_frame_id"] == "robot1/base_link"
        assert abs(odometry["header"]["stamp"]["nsecs"]) < 1e9
        scan = await client.topic("/robot1/sonar", "sensor_msgs/msg/LaserScan")
        readings = here.robot.sonar.readings_in
        ring_m = here.robot.model.body.sonar_ring_radius_in * 0.0254
        # From the axis, which is the frame of the message.
        expected = [round(one) * 0.0254 + ring_m if one < 255 else None for one in readings]
        assert scan["ranges"] == [one and pytest.approx(one) for one in expected]
        assert scan["range_max"] == pytest.approx(255 * 0.0254 + ring_m)
        assert scan["angle_increment"] == pytest.approx(math.tau / 16)
        one = await client.topic("/robot1/sonar/3", "sensor_msgs/Range")
        assert one["range"] == pytest.approx(scan["ranges"][3] - ring_m)
        assert one["header"]["frame_id"] == "robot1/sonar_3"
        assert (await client.topic("/robot1/bumpers", "std_msgs/UInt32"))["data"] == 0
        assert 10 < (await client.topic("/robot1/battery", "sensor_msgs/BatteryState"))["voltage"] < 13
        frames = (await client.topic("/tf", "tf2_msgs/TFMessage"))["transforms"]
        assert [(one["header"]["frame_id"], one["child_frame_id"]) for one in frames] == [
            ("robot1/odom", "robot1/base_link"), ("robot1/base_link", "robot1/turret")
        ]
        fixed = (await client.topic("/tf_static", "tf2_msgs/TFMessage"))["transforms"]
        assert [one["child_frame_id"] for one in fixed] == [f"robot1/sonar_{k}" for k in range(16)]
        fourth = fixed[4]["transform"]
        assert fourth["translation"]["y"] == pytest.approx(ring_m)
        # Sonar 4 is at 90 deg: the quaternion's z is sin(45 deg).
        assert fourth["rotation"]["z"] == pytest.approx(math.sin(math.pi / 4))
        grid = await client.topic("/map", "nav_msgs/OccupancyGrid")
        assert len(grid["data"]) == grid["info"]["width"] * grid["info"]["height"]
        assert set(grid["data"]) == {-1, 0, 100}


async def test_velocities_drive_and_must_be_repeated() -> None:
    async with serve() as here, here.client() as client:
        await client.send("advertise", topic="/robot1/cmd_vel", type="geometry_msgs/Twist")
        # 0.127 m/s are 5 in/s, an even number of tenths.
        await client.drive(0.127, 0.2)
        await here.until(lambda: any(here.robot.moving))
        twist = (await client.topic("/robot1/odom", "nav_msgs/Odometry"))["twist"]["twist"]
        assert (twist["linear"]["x"], twist["angular"]["z"]) == (pytest.approx(0.127), pytest.approx(0.2, abs=0.002))
        # From here on nothing is published: the robot stops by the drive timeout.
        silent_s = asyncio.get_running_loop().time()
        await here.until(lambda: not any(here.robot.moving))
        assert asyncio.get_running_loop().time() - silent_s < DRIVE_TIMEOUT_S + 1.0
        assert 0 < here.robot.encoder.steering_rad < math.pi


async def test_vanished_client_stops_its_robot() -> None:
    async with serve() as here:
        async with here.client() as client:
            await client.drive(0.127)
            await here.until(lambda: any(here.robot.moving))
            connection = client.socket._response.connection
            assert connection is not None
            assert connection.transport is not None
            # The TCP connection ends without a close frame.
            connection.transport.abort()
        await here.until(lambda: not any(here.robot.moving))


async def test_throttle_and_unsubscribe() -> None:
    async with serve() as here, here.client() as client:
        # At most one message in 200 ms.
        await client.send("subscribe", id="a", topic="/robot1/odom", throttle_rate=200)
        times = []
        for _ in range(4):
            message = await client.next("publish")
            times.append(message["msg"]["header"]["stamp"]["nsecs"] / 1e9 + message["msg"]["header"]["stamp"]["secs"])
        gaps = [later - earlier for earlier, later in pairwise(times)]
        assert sum(gaps) / len(gaps) > 0.15
        await client.send("unsubscribe", id="a", topic="/robot1/odom")
        await client.send("call_service", service="/rosapi/services", id="s")
        assert (await client.next("service_response"))["id"] == "s"
        # After the unsubscription nothing comes any more.
        with pytest.raises(asyncio.TimeoutError):
            async with asyncio.timeout(0.15):
                await client.socket.receive_str()


async def test_services() -> None:
    async with serve() as here, here.client() as client:
        await client.drive(0.127)
        await here.until(lambda: any(here.robot.moving))
        await client.send("call_service", service="/robot1/stop", id="1", type="std_srvs/Trigger")
        answer = await client.next("service_response")
        assert (answer["values"], answer["result"], answer["id"]) == ({"success": True, "message": ""}, True, "1")
        await here.until(lambda: not any(here.robot.moving))
        await client.send("call_service", service="/rosapi/topics")
        listed = (await client.next("service_response"))["values"]
        assert dict(zip(listed["topics"], listed["types"], strict=True))["/robot1/cmd_vel"] == "geometry_msgs/Twist"
        await client.send("call_service", service="/rosapi/topic_type", args={"topic": "/tf"})
        assert (await client.next("service_response"))["values"] == {"type": "tf2_msgs/TFMessage"}
        await client.send("call_service", service="/robot9/stop")
        assert (await client.next("service_response"))["result"] is False


TWIST = {"topic": "/robot1/cmd_vel"}


@pytest.mark.parametrize(("message", "text"), [
    ("hello", "JSON object"),
    # Deeper than Python's recursion limit.
    ("[" * 100_000, "JSON object"),
    ({"op": "fly"}, "no operation"),
    ({"op": "subscribe"}, "topic is missing"),
    ({"op": "subscribe", "topic": "/robot7/odom"}, "no topic"),
    ({"op": "subscribe", "topic": "/tf", "type": "std_msgs/String"}, "is of type tf2_msgs/TFMessage"),
    ({"op": "subscribe", "topic": "/tf", "compression": "png"}, "compression"),
    ({"op": "subscribe", "topic": "/tf", "throttle_rate": -1}, "throttle_rate"),
    ({"op": "unsubscribe", "topic": "/tf"}, "not subscribed"),
    ({"op": "advertise", "topic": "/tf"}, "takes messages"),
    ({"op": "set_level", "level": "loud"}, "level"),
    ({"op": "publish", **TWIST, "msg": {"linear": {"x": "fast"}}}, "linear.x"),
    # Numbers beyond a float, and an integer that no float can hold.
    ({"op": "publish", **TWIST, "msg": {"linear": {"x": 1e999}}}, "linear.x"),
    ({"op": "publish", **TWIST, "msg": {"linear": {"x": 10**400}}}, "linear.x"),
    ({"op": "publish", **TWIST, "msg": {"angular": 3}}, "angular.z"),
    ({"op": "call_service"}, "service is missing"),
    ({"op": "publish", **TWIST, "msg": None}, "linear.x"),
])  # fmt: skip
async def test_errors_are_status_messages(message: Any, text: str) -> None:
    async with serve() as here, here.client() as client:
        await client.socket.send_str(message if isinstance(message, str) else json.dumps(message | {"id": "x"}))
        status = await client.next("status")
        assert text in status["msg"]
        assert status["level"] == "error"
        assert status.get("id") == ("x" if isinstance(message, dict) else None)
        assert not any(here.robot.moving)


@pytest.mark.parametrize("number", [math.nan, ["x"], {"x": []}])
async def test_only_texts_are_ids(number: Any) -> None:
    async with serve() as here, here.client() as client:
        await client.send("call_service", service="/rosapi/services", id=number)
        status = await client.next("status")
        assert "id" in status["msg"]
        assert "id" not in status


async def test_long_message_closes_the_connection() -> None:
    async with serve() as here, here.client() as client:
        # The id alone is as long as the longest message.
        await client.send("call_service", service="/rosapi/services", id="x" * MAX_MESSAGE)
        assert (await client.socket.receive()).type is aiohttp.WSMsgType.CLOSE
        assert client.socket.close_code == aiohttp.WSCloseCode.MESSAGE_TOO_BIG


class DrivenRobots:
    """Records velocities in place of `ViewerClients`."""

    def __init__(self) -> None:
        self.driven: list[list[int]] = []

    def drive(self, _robot: int, args: list[int], _now: float, _on_answer: Any) -> None:
        self.driven.append(args)


def client_alone() -> tuple[RosbridgeClient, DrivenRobots]:
    """Return a client without a socket."""
    robots = DrivenRobots()
    published, commands = topics.topic_types({1: N150.ring}), topics.command_types([1])
    services = Services(published, commands, lambda _: False, lambda _: None)
    return RosbridgeClient(cast("ViewerClients", robots), services, may_act=True), robots


def test_subscriptions_are_limited_by_their_ids() -> None:
    client, _ = client_alone()
    # One more than allowed, each under its own id.
    for number in range(MAX_SUBSCRIPTIONS + 1):
        client.handle(json.dumps({"op": "subscribe", "topic": "/tf", "id": str(number)}), 0.0)
    assert len(client.subscriptions["/tf"].throttles_s) == MAX_SUBSCRIPTIONS
    assert "maximum" in client.unsent.pop()
    client.handle(json.dumps({"op": "subscribe", "topic": "/tf", "id": "0", "throttle_rate": 500}), 0.0)
    assert client.subscriptions["/tf"].throttles_s["0"] == 0.5


def test_late_velocities_only_stop() -> None:
    client, robots = client_alone()
    # A velocity that waited too long is refused; a stop is executed however late.
    for speed in (0.1, 0.0):
        message = {"op": "publish", **TWIST, "msg": {"linear": {"x": speed}}}
        client.handle(json.dumps(message), 0.0, is_late=True)
    assert robots.driven == [[0, 0, 0]]
    assert "late" in client.unsent.pop()


async def test_flood_of_velocities_ends_with_its_program() -> None:
    """A thousand velocities take five seconds at the rate of a client."""
    async with serve() as here, here.client() as client:
        for _ in range(1000):
            await client.drive(0.127)
        await here.until(lambda: any(here.robot.moving))
        begin_s = asyncio.get_running_loop().time()
        await here.until(lambda: not any(here.robot.moving))
        assert asyncio.get_running_loop().time() - begin_s < 2 * DRIVE_TIMEOUT_S + 1.0
        assert "late" in (await client.next("status"))["msg"]


async def test_topic_type_without_a_topic_is_empty() -> None:
    async with serve() as here, here.client() as client:
        wrong: list[Any] = [[], {}, None]
        for args in wrong:
            await client.send("call_service", service="/rosapi/topic_type", args=args)
            assert (await client.next("service_response"))["values"] == {"type": ""}


async def test_map_is_encoded_once_for_each_world() -> None:
    async with serve() as here:
        first = here.server._latched("/map")
        assert here.server._latched("/map") is first
        simulated = here.daemon.emulator.simulation
        simulated.change_world(simulated.world.with_inner_wall(0, (20.0, 20.0, 30.0, 20.0)))
        assert here.server._latched("/map") != first


def test_large_worlds_have_larger_cells() -> None:
    room = load_world("thesis_room")
    assert map_cell_in(room) == MAP_CELL_IN
    large = World("large", inner_walls=np.array([[0.0, 0.0, 1e5, 0.0], [0.0, 0.0, 0.0, 1e5]]))
    # Cells are larger in a large world, so that their number is bounded.
    assert (1e5 / map_cell_in(large)) ** 2 <= MAX_MAP_CELLS


async def test_world_without_walls_has_no_map() -> None:
    async with serve() as here, here.client() as client:
        here.daemon.emulator.simulation.change_world(World("plain"))
        await client.send("subscribe", topic="/map")
        assert "no walls" in (await client.next("status"))["msg"]


async def test_server_closes_twice() -> None:
    async with serve() as here:
        await here.server.close()


async def test_open_network_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    daemon = Daemon(Emulator(simulation()))
    async with serve_rosbridge(RosbridgeServer(daemon), "0.0.0.0", 0):
        assert "unencrypted" in caplog.text
    await daemon.close()


async def test_tokens_and_origins() -> None:
    async with serve(has_map=False) as here:
        for token, headers in (("", {}), ("wrong", {}), (None, {"Origin": "http://evil.example"})):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                async with here.client(token, **headers):
                    pass
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            async with here.client(None, Host="evil.example"):
                pass
        async with here.client(here.server.tokens.watch, Origin=f"http://{HOST}:{here.port}") as watcher:
            await watcher.topic("/robot1/odom", "nav_msgs/Odometry")
            await watcher.drive(1)
            assert "only watches" in (await watcher.next("status"))["msg"]
            await watcher.send("call_service", service="/robot1/stop")
            assert "only watches" in (await watcher.next("service_response"))["values"]
            await watcher.send("subscribe", topic="/map")
            assert "--map" in (await watcher.next("status"))["msg"]
        with pytest.raises(ConnectionLost, match="--rosbridge 0"):
            await RosbridgeServer(here.daemon).open(HOST, here.port)


async def test_pages_of_named_origins_connect() -> None:
    async with serve(origins=frozenset({"http://localhost:3000"})) as here:
        async with here.client(None, Origin="http://localhost:3000") as client:
            await client.topic("/robot1/odom", "nav_msgs/Odometry")
        for token, origin in (("wrong", "http://localhost:3000"), (None, "http://localhost:3001")):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                async with here.client(token, Origin=origin):
                    pass


@pytest.mark.parametrize(("words", "text"), [
    (["--rosbridge", "0", "--rosbridge-origin", "localhost:3000"], "scheme and host"),
    (["--rosbridge", "0", "--rosbridge-origin", "http://localhost:3000/page"], "scheme and host"),
    (["--rosbridge-origin", "http://localhost:3000"], "give --rosbridge too"),
])  # fmt: skip
def test_wrong_origins_are_usage_errors(words: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        read_options(nserver_parser(), words)
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(("text", "sent"), [
    ("HTTP://Localhost:3000/", "http://localhost:3000"),
    ("http://robots.example:80", "http://robots.example"),
    ("https://robots.example:443", "https://robots.example"),
    ("https://robots.example:80", "https://robots.example:80"),
])  # fmt: skip
def test_origins_are_as_browsers_send_them(text: str, sent: str) -> None:
    options = read_options(nserver_parser(), ["--rosbridge", "0", "--rosbridge-origin", text])
    assert options.rosbridge_origin == [sent]


async def test_limit_of_clients() -> None:
    async with serve() as here:
        limits = here.daemon.admission.limits
        object.__setattr__(limits, "viewers", 1)
        async with here.client():
            with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
                async with here.client():
                    pass


ESTIMATE = {
    "robot": 1, "clock_s": 1.0, "pose": [10.0, 20.0, 0.5], "turret": 0.0, "cov": [[1, 0, 0], [0, 4, 0], [0, 0, 0.01]],
    "odometry": [0.0, 0.0, 0.5], "truth": None, "echoes": [], "waypoints": [], "trust": "OK", "reason": "",
    "places": [], "passed": 0,
}  # fmt: skip


async def test_published_estimates_are_poses_in_the_map() -> None:
    async with serve() as here, here.client() as client:
        await client.send("subscribe", topic="/robot1/pose", type="geometry_msgs/PoseWithCovarianceStamped")
        await client.send("call_service", service="/rosapi/services")
        await client.next("service_response")
        address = here.url().replace("/?", "/publish?")
        async with here.web.post(address, json=ESTIMATE) as answer:
            assert answer.status == 200, await answer.text()
        found = (await client.next("publish"))["msg"]
        assert found["header"]["frame_id"] == "map"
        # 10 in; covariances in square metres. Index 7 is (y, y) and 35 (yaw, yaw) of the 6 x 6 matrix.
        assert found["pose"]["pose"]["position"]["x"] == pytest.approx(0.254)
        assert found["pose"]["covariance"][7] == pytest.approx(4 * 0.0254**2)
        assert found["pose"]["covariance"][35] == 0.01
        frames = (await client.topic("/tf", "tf2_msgs/TFMessage"))["transforms"]
        assert frames[0]["header"]["frame_id"] == "map"
        assert frames[0]["transform"]["translation"]["x"] == pytest.approx(0.254)
        async with here.web.post(address, json=ESTIMATE | {"trust": "LOST"}) as answer:
            assert answer.status == 200
        # A frame of before may be on its way.
        while frames[0]["header"]["frame_id"] == "map":
            frames = (await client.next("publish"))["msg"].get("transforms", frames)
        for wrong, status in ((ESTIMATE | {"robot": 5}, 400), ({}, 400)):
            async with here.web.post(address, json=wrong) as answer:
                assert answer.status == status
        async with here.web.post(address.replace(here.server.tokens.act, here.server.tokens.watch), json={}) as answer:
            assert answer.status == 403


def test_readings_at_the_limits() -> None:
    """REP-117: -inf nearer than a sonar measures, +inf without an echo; JSON has the least range, and null."""
    state = [255] * 45
    # 6 in or less, 7 in, and no echo up to 255 in.
    state[17:20] = 6, 7, 255
    found = dict(topics.messages_of(Reading(1, state, False, 0, ring=nomad_ring(0.25 / 0.0254))))
    scan = found["/robot1/sonar"]
    assert scan["ranges"][:3] == [-math.inf, pytest.approx(7 * 0.0254 + 0.25), math.inf]
    assert scan["range_min"] == pytest.approx(6 * 0.0254 + 0.25)
    assert [found[f"/robot1/sonar/{k}"]["range"] for k in (0, 2)] == [-math.inf, math.inf]
    sent = json.loads(encode_published("/robot1/sonar", scan))["msg"]
    assert sent["ranges"][:3] == [scan["range_min"], scan["ranges"][1], None]
    assert json.loads(encode_published("/a", found["/robot1/sonar/0"]))["msg"]["range"] == pytest.approx(6 * 0.0254)


def test_wheels_of_a_scout() -> None:
    """Its velocities are those of the wheels, in both directions."""
    # Both directions: velocities to wheels, and wheels back to velocities.
    args = topics.velocities({"linear": {"x": 0.127}, "angular": {"z": 0.5}}, True)
    state = [0] * 45
    state[38:40] = args[:2]
    speed, turn = Reading(1, state, True, 0).velocity
    assert speed == pytest.approx(0.127, abs=0.002)
    assert turn == pytest.approx(0.5, abs=0.02)
    # A left turn: the right wheel is faster.
    assert args[0] > args[1]
    assert topics.velocities({"linear": {"x": 1e9}}, False) == [32767, 0, 0]
    assert topics.velocities({"linear": {"x": -1e308}, "angular": {"z": 1e308}}, True)[1] == -32767


# An independent client library, which does not share this project's reading of the protocol.
ROSLIBPY = """
import sys, threading, roslibpy
ros = roslibpy.Ros(sys.argv[1])
ros.run(timeout=10)
moved, far = threading.Event(), []
odometry = roslibpy.Topic(ros, "/robot1/odom", "nav_msgs/Odometry", throttle_rate=50)
def look(message):
    far.append(message["pose"]["pose"]["position"]["x"])
    if far[-1] > 0.02:
        moved.set()
odometry.subscribe(look)
velocity = roslibpy.Topic(ros, "/robot1/cmd_vel", "geometry_msgs/Twist")
velocity.advertise()
for _ in range(100):
    velocity.publish(roslibpy.Message({"linear": {"x": 0.2, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}))
    if moved.wait(0.1):
        break
print("moved" if moved.is_set() else far)
print("/robot1/odom" in ros.get_topics(), ros.get_topic_type("/tf"))
print(roslibpy.Service(ros, "/robot1/stop", "std_srvs/Trigger").call(roslibpy.ServiceRequest())["success"])
ros.terminate()
"""


async def test_roslibpy_drives_the_robot() -> None:
    async with serve() as here:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", ROSLIBPY, here.url().replace("http", "ws"), stdout=asyncio.subprocess.PIPE)
        shown, _ = await asyncio.wait_for(process.communicate(), 60)
        assert shown.decode().split() == ["moved", "True", "tf2_msgs/TFMessage", "True"]
        await here.until(lambda: not any(here.robot.moving))
