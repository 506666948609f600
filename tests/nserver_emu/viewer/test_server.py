"""Access to the page and its websocket messages, on loopback sockets without a browser."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import threading
import zlib

import aiohttp
import pytest

from nclient.errors import ConnectionLost
from nclient.transports.listener import Allowlist
from nserver_emu.server.admission import Limits
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.runtime_settings import read_world_file
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer import http_port
from nserver_emu.viewer.http_port import HTTP_LOG, PERIOD_S, is_known_host, is_same_origin, next_due
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S
from nserver_emu.viewer.server import ViewerServer
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import HOST, elsewhere, serve_viewer
from worlds.world import World


def an_emulator() -> Emulator:
    return Emulator(simulation())


async def test_the_page_needs_a_token_and_loads_nothing_external() -> None:
    async with serve_viewer(an_emulator()) as here:
        # No token, a wrong one, and the right one without its last character.
        for token in ("", "wrong", here.viewer_server.token[:-1]):
            async with here.web.get(here.origin, params={"token": token}) as answer:
                assert answer.status == 403
                assert "use the whole address" in await answer.text()
        for token in (here.viewer_server.token, here.viewer_server.watch_token):
            async with here.web.get(here.origin, params={"token": token}) as answer:
                assert answer.status == 200
                assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
                # No address of another machine: the page must work in a laboratory without internet.
                text = await answer.text()
                assert "http:" not in text
                assert "https:" not in text
        async with here.web.get(here.origin) as answer:  # a reload: the tab has its token to itself
            assert (answer.status, await answer.text()) == (200, text)
        # The websocket does need the token, although the page itself is sent again.
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await here.web.ws_connect(f"{here.origin}/ws", headers={"Origin": here.origin})
        async with here.web.get(f"{here.origin}/page/main.js") as answer:
            assert answer.status == 200
        async with here.web.get(f"{here.origin}/page/../web.py") as answer:
            assert answer.status == 404


async def test_files_are_compressed_for_those_that_accept_it() -> None:
    # The client must not decompress: the size of the body on the wire is compared.
    bodies, sizes = [], []
    async with serve_viewer(an_emulator()) as here, aiohttp.ClientSession(auto_decompress=False) as web:
        for encoding in ("identity", "deflate"):
            async with web.get(f"{here.origin}/page/main.js", headers={"Accept-Encoding": encoding}) as answer:
                assert answer.headers.get("Content-Encoding", "identity") == encoding
                body = await answer.read()
                sizes.append(len(body))
                bodies.append(zlib.decompress(body) if encoding == "deflate" else body)
    assert bodies[0] == bodies[1]
    assert sizes[1] < sizes[0] / 2


# No Origin (no browser), another site, another port, a sandboxed page, and one that cannot be parsed.
@pytest.mark.parametrize("origin", ["", "http://evil.example", "http://127.0.0.1:1", "null", "http://["])
async def test_a_page_from_elsewhere_gets_no_websocket(origin: str) -> None:
    async with serve_viewer(an_emulator()) as here:
        headers = {"Origin": origin} if origin else {}
        token = {"token": here.viewer_server.token}
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            await here.web.ws_connect(f"{here.origin}/ws", params=token, headers=headers)
        assert refusal.value.status == 403
        assert not here.viewer_server.broadcaster.viewers


async def test_an_unknown_host_name_is_refused() -> None:
    async with serve_viewer(an_emulator()) as here:
        # DNS rebinding: another site's name that resolves to this machine must not get the page.
        name = f"evil.example:{here.port}"
        headers = {"Host": name, "Origin": f"http://{name}"}
        for params in ({"token": here.viewer_server.token}, {}):
            async with here.web.get(here.origin, params=params, headers=headers) as answer:
                assert answer.status == 403
                assert "use its numeric address" in await answer.text()


@pytest.mark.parametrize(
    ("host", "ours"),
    [("127.0.0.1:7080", True), ("localhost:1", True), ("[::1]:7080", True), ("10.0.0.2:80", True),
     ("evil.example", False), ("", False)],
)  # fmt: skip
def test_hosts_are_numbers_or_loopback(host: str, ours: bool) -> None:
    assert is_known_host(host) is ours


async def test_a_port_in_use_is_an_error_with_a_remedy() -> None:
    viewer_server = ViewerServer(Daemon(an_emulator()))
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        with pytest.raises(ConnectionLost, match="--viewer 0 takes"):
            await viewer_server.open(HOST, taken.getsockname()[1])
    await viewer_server.close()


async def test_a_viewer_gets_pictures_until_it_leaves() -> None:
    async with serve_viewer(an_emulator()) as here:
        async with here.page() as page:
            hello = await page.until(lambda message: message["type"] == "hello")
            assert (hello["may_act"], hello["watch_token"]) == (True, here.viewer_server.watch_token)
            # The first picture is whole (since 0); later ones are the difference to the one before.
            first = await page.until(lambda message: message["type"] == "picture")
            later = await page.until(lambda message: message.get("frame", 0) >= first["frame"] + 5)
            assert first["since"] == 0
            assert later["since"] == later["frame"] - 1
            assert later["time_s"] > first["time_s"]
        async with asyncio.timeout(5):
            while here.viewer_server.broadcaster.viewers:
                await asyncio.sleep(0.01)


@pytest.mark.long
async def test_a_slow_viewer_gets_pictures_again_after_catching_up() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        (viewer,) = here.viewer_server.broadcaster.viewers
        async with asyncio.timeout(5):
            # No picture is acknowledged here, so after some of them the viewer counts as behind.
            while not viewer.is_behind:
                await asyncio.sleep(0.02)
        # While it is behind, no further picture is sent.
        held = viewer.latest
        await asyncio.sleep(0.3)
        assert viewer.latest == held
        await page.until(lambda message: message["type"] == "picture" and message["frame"] > held)


async def test_a_watcher_may_do_nothing_else() -> None:
    async with serve_viewer(an_emulator()) as here, here.page(here.viewer_server.watch_token) as page:
        hello = await page.until(lambda message: message["type"] == "hello")
        assert (hello["may_act"], hello["watch_token"]) == (False, None)
        await page.send_message(do="call", id=4, robot=1, call="vm", args=[100, 0, 0])
        assert "only looks" in (await page.answer(4))["error"]
        # The refused vm must not have moved the robot.
        assert here.daemon.emulator.simulation.robots[1].is_still((0, 1, 2))
        assert not here.daemon.emulator.pose_requests.open
        await page.socket.send_str("nonsense")
        assert "JSON" in (await page.until(lambda message: message["type"] == "answer"))["error"]
        await page.socket.ping()
        # Watching is the one thing that this link may do.
        await page.send_message(do="watch", traffic=True, laser=True)
        viewers = here.viewer_server.broadcaster
        await page.until(lambda message: message["type"] == "picture" and viewers.watch_traffic)


async def test_a_call_of_a_page_acts_as_a_clients() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        robots = here.daemon.emulator.simulation.robots
        await page.send_message(do="call", id=1, robot=1, call="place_robot", args=[300, 200, 900, 0])
        assert (await page.answer(1))["ok"]
        shown = await page.until(lambda message: message["type"] == "picture")
        # x 30 in, y 20 in, steering 90 deg: the units of State are tenths.
        assert shown["robots"]["1"]["state"][34:37] == [300, 200, 900]
        # Inside a wall: the reply has the error code of the protocol, 2.
        await page.send_message(do="call", id=2, robot=1, call="place_robot", args=[-120, 0, 0, 0])
        refused = await page.answer(2)
        assert (refused["ok"], refused["code"]) == (False, 2)
        await page.send_message(do="call", id=3, robot=7, call="st", args=[])
        assert "no robot 7" in (await page.answer(3))["error"]
        # vm needs three numbers.
        await page.send_message(do="call", id=4, robot=1, call="vm", args=[1])
        assert "vm" in (await page.answer(4))["error"]
        await page.send_message(do="call", id=5, robot=1, call="vm", args=[50, 0, 0])
        assert (await page.answer(5))["ok"]
        assert not robots[1].is_still((0,))
    # Closing the page is like closing a client's connection: the motion stops.
    async with asyncio.timeout(5):
        while not robots[1].is_still((0,)):
            await asyncio.sleep(0.01)


@pytest.mark.long
async def test_driving_stops_without_repeated_messages() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        robot = here.daemon.emulator.simulation.robots[1]
        clock = asyncio.get_running_loop().time
        await page.send_message(do="drive", id=1, robot=1, args=[50, 0, 0])
        await page.answer(1)
        began = clock()
        # Without a repeated drive message the robot stops after DRIVE_TIMEOUT_S; the rest is for a busy machine.
        await page.until(lambda _: robot.is_still((0,)))
        assert DRIVE_TIMEOUT_S * 0.9 <= clock() - began < DRIVE_TIMEOUT_S + 1.0
        await page.send_message(do="drive", id=2, robot=1, args=[0, 0, 0])
        assert (await page.answer(2))["ok"]


async def test_the_owner_controls_time() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        await page.send_message(do="control", id=1, command="pause")
        assert (await page.answer(1))["said"]["paused"]
        before = here.daemon.emulator.simulation.time_s
        await page.send_message(do="control", id=2, command="step", argument=0.5)
        await page.answer(2)
        assert here.daemon.emulator.simulation.time_s == pytest.approx(before + 0.5)
        await page.send_message(do="control", id=3, command="speed", argument="fast")
        assert "speed" in (await page.answer(3))["error"]


async def test_what_is_no_message_is_answered_and_costs_nothing() -> None:
    async with serve_viewer(an_emulator()) as here, here.page(here.viewer_server.watch_token) as page:
        # An integer of 400 digits, beyond any float, and text that is no JSON.
        for text in ('{"do":"waypoints","robot":1,"points":[[1' + "0" * 400 + ',0]]}', "{"):
            await page.socket.send_str(text)
            assert not (await page.until(lambda message: message["type"] == "answer"))["ok"]
        await page.socket.send_bytes(b"\xff\x00")
        assert "text, not bytes" in (await page.until(lambda message: message["type"] == "answer"))["error"]
        await page.socket.send_str('{"do": "drive", "id": 5, "robot": 1, "args": [1.5, 0, 0]}')
        assert "args[0]: expected a whole number" in (await page.answer(5))["error"]


async def test_a_new_page_gets_the_waypoints() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        await page.send_message(do="waypoints", robot=1, points=[[10, 20]])
        await page.until(lambda message: message["type"] == "waypoints")
        async with here.page() as late:
            hello = await late.until(lambda message: message["type"] == "hello")
            assert hello["waypoints"] == {"1": [[10, 20]]}


async def test_a_driver_learns_of_other_drivers() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as one, here.page() as other:
        await one.send_message(do="drive", id=1, robot=1, args=[10, 0, 0])
        assert (await one.answer(1))["others"] == []
        # The page is informed which other pages drive the same robot.
        await other.send_message(do="drive", id=1, robot=1, args=[-10, 0, 0])
        assert (await other.answer(1))["others"] == ["viewer 1"]
        # After a stop the first page drives no more.
        await one.send_message(do="call", id=2, robot=1, call="st", args=[])
        await one.answer(2)
        await other.send_message(do="drive", id=2, robot=1, args=[-10, 0, 0])
        assert (await other.answer(2))["others"] == []


@pytest.mark.long
async def test_answers_do_not_wait_for_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = asyncio.get_running_loop()
    # Pictures so rare that a busy machine answers 40 calls in the time of 20.
    monkeypatch.setattr(http_port, "PERIOD_S", 0.5)
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        await page.send_message(do="call", id=0, robot=1, call="st", args=[])
        await page.answer(0)
        begin = loop.time()
        for number in range(1, 41):
            await page.send_message(do="call", id=number, robot=1, call="st", args=[])
            await page.answer(number)
        assert loop.time() - begin < 20 * 0.5
        begin = loop.time()
        await here.viewer_server.close()
        assert loop.time() - begin < 1.5
        assert not here.viewer_server.broadcaster.viewers


def test_the_name_that_the_page_is_served_on_is_known() -> None:
    assert is_known_host("robots.example:7080", "robots.example")
    assert not is_known_host("evil.example:7080", "robots.example")


@pytest.mark.parametrize(("host", "remedy"), [("192.0.2.1", "take an address of this machine")])
async def test_where_it_cannot_be_served_the_remedy_fits(host: str, remedy: str) -> None:
    with pytest.raises(ConnectionLost, match=remedy):
        await ViewerServer(Daemon(an_emulator())).open(host, 0)
    assert HTTP_LOG.filters == []


def test_a_host_that_is_none_is_refused() -> None:
    assert not is_known_host("[")
    assert not is_known_host("")
    assert is_same_origin("http://LOCALHOST:7080", "http", "localhost:7080")
    assert not is_same_origin("https://localhost:7080", "http", "localhost:7080")


async def test_noise_is_switched_and_a_world_put_by_a_page_that_may() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        wanted = {"robot": 1, "sensors": "measured", "motion": "noisy"}
        await page.send_message(do="control", id=1, command="noise", argument=wanted)
        assert (await page.answer(1))["said"] == {"noise": {"1": {"sensors": "measured", "motion": "noisy"}}}
        await page.send_message(do="control", id=2, command="world show")
        text = (await page.answer(2))["said"]["text"]
        await page.send_message(do="control", id=3, command="world set", argument={"text": text, "file": "it.toml"})
        assert (await page.answer(3))["said"] == {"world": "thesis_room"}
        async with here.page(here.viewer_server.watch_token) as looking:
            await looking.send_message(do="control", id=4, command="noise", argument=wanted)
            assert (await looking.answer(4))["error"] == "this link only looks"


async def test_a_world_of_a_page_is_read_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    # The world is parsed in a thread, which waits here until the test lets it continue.
    may_go_on = threading.Event()

    def read_slowly(text: str, file: str) -> World:
        assert may_go_on.wait(30.0)
        return read_world_file(text, file)

    monkeypatch.setattr("nserver_emu.server.handlers.runtime_settings.read_world_file", read_slowly)
    text = "[[room]]\ncorners_in = [[-50, -50], [90, -50], [90, 90], [-50, 90]]"
    message = {"do": "control", "command": "world set", "argument": {"text": text, "file": "new.toml"}}
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        # The event loop runs meanwhile; a second world waits for the first.
        await page.send_message(id=1, **message)
        await page.send_message(id=2, **message)
        assert "still being read" in (await page.answer(2))["error"]
        await page.send_message(do="control", id=3, command="status")
        assert (await page.answer(3))["said"]["world"] == "thesis_room"
        may_go_on.set()
        assert (await page.answer(1))["said"] == {"world": "new"}
        await page.send_message(id=4, **message | {"argument": {"text": "[[room", "file": "bad.toml"}})
        assert "bad.toml" in (await page.answer(4))["error"]


async def test_a_world_that_is_read_at_the_end_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    # The page closes while its world is still being parsed.
    may_go_on, emulator = threading.Event(), an_emulator()

    def read_slowly(text: str, file: str) -> World:
        assert may_go_on.wait(30.0)
        return read_world_file(text, file)

    monkeypatch.setattr("nserver_emu.server.handlers.runtime_settings.read_world_file", read_slowly)
    async with serve_viewer(emulator) as here, here.page() as page:
        argument = {"text": "[[room]]\ncorners_in = [[-50, -50], [90, -50], [90, 90], [-50, 90]]", "file": "new.toml"}
        await page.send_message(do="control", id=1, command="world set", argument=argument)
        await page.send_message(do="control", id=2, command="status")
        assert (await page.answer(2))["ok"]
    # The result arrives after the end and must not replace the world.
    may_go_on.set()
    await asyncio.sleep(0.1)
    assert emulator.simulation.world.name == "thesis_room"


async def test_a_click_is_taken_where_a_client_waits_for_it() -> None:
    async with serve_viewer(an_emulator()) as here, here.page() as page:
        await page.send_message(do="click", robot=1, pose=[1, 2, 3, 4])
        assert "no client asks" in (await page.until(lambda message: message["type"] == "answer"))["error"]
        await page.send_message(do="waypoints", robot=1, points=[[10, 20]])
        assert (await page.until(lambda message: message["type"] == "waypoints"))["points"] == [[10, 20]]
        assert here.viewer_server.controller.waypoints == {1: [[10, 20]]}


def test_pictures_come_evenly_at_twenty_a_second() -> None:
    # 20 pictures a second on average, although each is 12 ms late.
    due = now = 100.0
    for _ in range(200):
        due = next_due(due, now)
        # The loop wakes late, and the picture takes its time.
        now = max(now, due) + 0.012
    assert (now - 100.0) / 200 == pytest.approx(PERIOD_S, rel=0.01)
    # After a gap of 3 s no pictures are made up for.
    now += 3.0
    due = next_due(due, now)
    assert due == now
    assert next_due(due, now) == now + PERIOD_S


async def test_a_page_beyond_the_limit_is_refused() -> None:
    async with serve_viewer(an_emulator()) as here:
        here.daemon.admission.limits = Limits(viewers=1)
        query, headers = {"token": here.viewer_server.token}, {"Origin": here.origin}
        async with here.page() as page:
            with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
                await here.web.ws_connect(f"{here.origin}/ws", params=query, headers=headers)
            assert refusal.value.status == 503
            await page.until(lambda message: message["type"] == "picture")
        # The place is free once the server has handled the close.
        while here.viewer_server.broadcaster.viewers:
            await asyncio.sleep(0.005)
        async with here.page() as page:
            await page.until(lambda message: message["type"] == "picture")


async def test_a_failed_websocket_handshake_frees_its_place() -> None:
    async with serve_viewer(an_emulator()) as here:
        here.daemon.admission.limits = Limits(viewers=1)
        query, headers = {"token": here.viewer_server.token}, {"Origin": here.origin}
        for _ in range(2):
            async with here.web.get(f"{here.origin}/ws", params=query, headers=headers) as answer:
                # No upgrade was asked for.
                assert answer.status == 400


async def test_an_address_that_is_not_let_in_gets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nclient.transports.listener.is_loopback", lambda _host: False)

    async with serve_viewer(an_emulator()) as here, elsewhere() as outsider:
        here.daemon.admission.access = Allowlist((ipaddress.ip_network("192.0.2.0/24"),))
        for path in ("/", "/ws", "/page/main.js", "/health"):
            async with outsider.get(f"{here.origin}{path}", params={"token": here.viewer_server.token}) as answer:
                assert (answer.status, await answer.text()) == (403, "this address is not allowed\n")
        assert here.daemon.admission.rejected == 4
        async with here.web.get(f"{here.origin}/", params={"token": here.viewer_server.token}) as answer:
            # From this machine by its own address.
            assert answer.status == 200
