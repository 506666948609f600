"""The npm package roslib in Chromium as the other side of `nserver --rosbridge`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.programs.forked import Forked

ROSLIB, FILE = "roslib@1.4.1", "roslib/build/roslib.min.js"
DRIVE = """async (url) => {
    const ros = new ROSLIB.Ros({ url });
    await new Promise((resolve, reject) => { ros.on('connection', resolve); ros.on('error', reject); });
    const odometry = new ROSLIB.Topic({ ros, name: '/robot1/odom', messageType: 'nav_msgs/Odometry' });
    const velocity = new ROSLIB.Topic({ ros, name: '/robot1/cmd_vel', messageType: 'geometry_msgs/Twist' });
    const ahead = new ROSLIB.Message({ linear: { x: 0.2, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } });
    const frame = await new Promise((resolve) => odometry.subscribe((message) => {
        velocity.publish(ahead);
        if (message.pose.pose.position.x > 0.02) resolve(message.header.frame_id);
    }));
    odometry.unsubscribe();
    const stop = new ROSLIB.Service({ ros, name: '/robot1/stop', serviceType: 'std_srvs/Trigger' });
    const request = new ROSLIB.ServiceRequest({});
    const { success } = await new Promise((resolve, reject) => stop.callService(request, resolve, reject));
    ros.close();
    return [frame, success];
}"""

@pytest.fixture(scope="module")
def roslib(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the package's file for browsers; it is fetched once and then kept in npm's cache."""
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    folder = tmp_path_factory.mktemp("roslib")
    command = ["npm", "install", "--prefer-offline", "--ignore-scripts", "--no-audit", "--no-fund", ROSLIB]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    if done.returncode:
        pytest.skip(f"npm cannot install {ROSLIB}: {done.stderr.strip().splitlines()[-1:]}")
    return folder / "node_modules" / FILE


@pytest.mark.long
def test_roslib_reads_odometry_drives_and_calls(browser: Browser, roslib: Path) -> None:
    with Forked("nserver", "thesis_room", "--port", "0", "--rosbridge", "0") as program:
        program.stdout.readline()
        url = program.stdout.readline().split()[2]
        origin = url.replace("ws://", "http://").partition("/?")[0]
        with browser.new_context() as context:
            page = context.new_page()
            page.set_default_timeout(60_000)
            # Any answer of the port, so that the page has its origin.
            page.goto(f"{origin}/?token=none")
            page.add_script_tag(path=roslib)
            frame, success = page.evaluate(DRIVE, url)
            assert (frame.endswith("odom"), success) == (True, True)
        program.terminate()
        assert program.wait(timeout=10) == 0
