"""Take the screenshots of docs/window: `scripts/window-pictures [FOLDER [light|dark]]`. Takes about a minute."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from tests.integration.viewer.browsing import CHROMIUM, FLAGS, OpenPage, nserver, open_page

ROOM = ("several_walls", "--robot", "n200", "--robot", "scout", "--start", "8,8,0,0", "--start", "88,8,120,0",
        "--noisy", "--seed", "3", "--speed", "4")  # fmt: skip
WINDOWS = ("drive", "pose", "robot", "short", "long", "time", "world", "traffic")
LOCALIZE = "import sys; from nclient.cli.main import main; sys.exit(main())"


@contextmanager
def open_dense(browser: Browser, url: str, scheme: str, width: int, height: int) -> Iterator[OpenPage]:
    """Open the page with two pixels per CSS pixel."""
    viewport = {"width": width, "height": height}
    with open_page(browser, url, viewport=viewport, color_scheme=scheme, device_scale_factor=2) as page:
        yield page


def take_map_and_windows(browser: Browser, folder: Path, scheme: str) -> None:
    """Take the map after a robot has driven, drawn and touched a wall, then each window, then a phone."""
    with nserver(*ROOM) as program, open_dense(browser, program.url, scheme, 1280, 860) as page:
        page.page.click("#window-traffic > summary")
        with program.robot() as robot:
            robot.draw_arc(box_in=(60, 50, 20, 20), angles_rad=(0.0, 4.7), mode=12)
            robot.draw_line(points_in=((55, 75), (90, 85)), mode=6)
            for inches, radians in ((30, 0.9), (25, 0.8), (25, -1.2), (40, 0)):
                robot.move(translation_in=inches)
                robot.wait_until_still(timeout_s=20)
                robot.move(steering_rad=radians, turret_rad=radians)
                robot.wait_until_still(timeout_s=20)
            robot.move(turret_rad=1.9)
            robot.wait_until_still(timeout_s=20)
            page.page.fill("#corners", "70,62 80,62 84,72")
            page.page.press("#corners", "Enter")
            page.wait("nserver.scene.world.obstacles.length > 0")
            page.page.evaluate("(document.activeElement.blur(), document.querySelector('#windows').scrollTop = 0)")
            page.page.wait_for_timeout(700)
            page.page.screenshot(path=folder / "map.png")
            robot.drive(steering_rad_s=0.3, turret_rad_s=0.3)
            page.page.set_viewport_size({"width": 1280, "height": 3600})
            page.page.wait_for_timeout(700)
            for name in WINDOWS:
                page.page.locator(f"#window-{name}").screenshot(path=folder / f"{name}.png")
            robot.stop()
        with open_dense(browser, program.url, scheme, 390, 844) as phone:
            phone.page.wait_for_timeout(500)
            phone.page.screenshot(path=folder / "phone.png")


@contextmanager
def open_localized(
    browser: Browser, scheme: str, world: str, begin: tuple[str, ...], *options: str
) -> Iterator[OpenPage]:
    """Open the page of a server with a localizer running with the given options."""
    words = (world, "--noisy", "--seed", "1", *begin)
    with nserver(*words) as program, open_dense(browser, program.url, scheme, 1280, 900) as page:
        address = f"nserver://127.0.0.1:{program.port}/1"
        command = ["localize", address, "--map", world, *options, "--publish", program.url]
        with subprocess.Popen([sys.executable, "-c", LOCALIZE, *command], stdout=subprocess.DEVNULL) as localizer:
            yield page
            localizer.terminate()


def save_screenshot(page: OpenPage, file: Path) -> None:
    """Save a screenshot with the window Localization visible."""
    page.page.evaluate("document.querySelector('#window-localization').scrollIntoView()")
    page.page.wait_for_timeout(2500)
    page.page.screenshot(path=file)


def take_estimate(browser: Browser, folder: Path, scheme: str) -> None:
    """Take a localizer that drives a path, halfway along it."""
    with open_localized(browser, scheme, "several_walls", (), "--waypoints", "35,55", "90,55") as page:
        page.wait("(nserver.estimateOf('1')?.pose[1] ?? 0) > 25", 60.0)
        save_screenshot(page, folder / "localization.png")


def take_alternatives(browser: Browser, folder: Path, scheme: str) -> None:
    """Take a robot with unknown start in a room that looks the same from four poses."""
    begin = ("--start", "20,12,0,0")
    with open_localized(browser, scheme, "thesis_room", begin, "--start", "unknown", "--stay") as page:
        page.wait("(nserver.estimateOf('1')?.places ?? []).length > 1", 60.0)
        save_screenshot(page, folder / "lost.png")


def main() -> None:
    """Take all screenshots."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/window")
    scheme = sys.argv[2] if len(sys.argv) > 2 else "light"
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        take_map_and_windows(browser, folder, scheme)
        take_estimate(browser, folder, scheme)
        take_alternatives(browser, folder, scheme)
        browser.close()


if __name__ == "__main__":
    main()
