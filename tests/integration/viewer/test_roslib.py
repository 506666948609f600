"""The npm package roslib in Chromium, in a page of another server, as the other side of `nserver --rosbridge`."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
from playwright.sync_api import Browser

from nclient import connect
from tests.programs.forked import Forked
from tests.waiting import wait_until

ROSLIB = "roslib@1.4.1"
DRIVE = """async (url) => {
    const ros = new ROSLIB.Ros({ url });
    await new Promise((resolve, reject) => { ros.on('connection', resolve); ros.on('error', reject); });
    const odometry = new ROSLIB.Topic({ ros, name: '/robot1/odom', messageType: 'nav_msgs/Odometry' });
    const velocity = new ROSLIB.Topic({ ros, name: '/robot1/cmd_vel', messageType: 'geometry_msgs/Twist' });
    const ahead = (x) => new ROSLIB.Message({ linear: { x, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } });
    const frame = await new Promise((resolve) => odometry.subscribe((message) => {
        velocity.publish(ahead(0.2));
        if (message.pose.pose.position.x > 0.02) resolve(message.header.frame_id);
    }));
    odometry.unsubscribe();
    const { topics } = await new Promise((resolve, reject) => ros.getTopics(resolve, reject));
    const stop = new ROSLIB.Service({ ros, name: '/robot1/stop', serviceType: 'std_srvs/Trigger' });
    const request = new ROSLIB.ServiceRequest({});
    const { success } = await new Promise((resolve, reject) => stop.callService(request, resolve, reject));
    setInterval(() => velocity.publish(ahead(0.02)), 100);
    return [frame, topics.includes('/robot1/sonar'), success];
}"""


@pytest.fixture(scope="module")
def roslib(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the package and a page; npm fetches the package once, into its cache."""
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    folder = tmp_path_factory.mktemp("roslib")
    command = ["npm", "pack", "--prefer-offline", "--ignore-scripts", ROSLIB]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    if done.returncode:
        pytest.skip(f"npm cannot fetch {ROSLIB}: {done.stderr.strip().splitlines()[-1:]}")
    with tarfile.open(next(folder.glob("*.tgz"))) as package:
        package.extractall(folder, filter="data")
    (folder / "index.html").write_text("<script src=package/build/roslib.min.js></script>")
    return folder


@pytest.fixture
def origin(roslib: Path) -> Iterator[str]:
    """Serve the package, and return the origin of its page."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=roslib)) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.long
def test_roslib_drives_until_its_page_is_closed(browser: Browser, origin: str) -> None:
    words = ("thesis_room", "--port", "0", "--rosbridge", "0", "--rosbridge-origin", origin)
    with Forked("nserver", *words) as program:
        port, url = (program.stdout.readline().split()[2] for _ in range(2))
        with connect(f"nserver://{port}/1") as robot:
            with browser.new_context() as context:
                page = context.new_page()
                page.set_default_timeout(60_000)
                page.goto(f"{origin}/index.html")
                frame, has_sonar, success = page.evaluate(DRIVE, url)
                assert (frame, has_sonar, success) == ("robot1/odom", True, True)
                wait_until(lambda: robot.refresh().moving)
            wait_until(lambda: not robot.refresh().moving)
        program.terminate()
        assert program.wait(timeout=10) == 0
