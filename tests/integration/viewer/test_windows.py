"""The windows Robot, Short sensors and Long sensors in a browser: State as text, as numbers and over time."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, open_page

READ_TOGETHER = """(() => {
    const state = nserver.scene.robots['1'].state, words = document.querySelector('#window-robot').innerText;
    const rings = ['long', 'short'].map((name) => document.querySelector(`#window-${name} td`).innerText);
    window.read = [state, words, rings];
    return words.includes(state.join(' ')) && rings[0] === state.slice(17, 33).join(' '); })()"""
"""State and the texts of the windows, read together once they agree: a robot may move between two reads."""


def count_drawn_pixels(window: str, number: int = 0) -> str:
    """Return JavaScript that counts the drawn pixels of a window's canvas."""
    return f"""(() => {{ const canvas = document.querySelectorAll('#window-{window} canvas')[{number}];
        const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        let count = 0; for (let k = 3; k < data.length; k += 4) count += data[k] > 0; return count; }})()"""


def test_state_as_text_and_numbers(browser: Browser) -> None:
    with nserver("thesis_room", "--robot", "n200") as program, open_page(browser, program.url) as page:
        with program.robot() as robot:
            robot.drive(translation_in_s=-10)
            page.wait("document.querySelector('#window-robot').innerText.includes('touched: 10')")
            page.wait(READ_TOGETHER)
            slots, words, rings = page.value("window.read")
            assert "touched: 10" in words
            assert slots[33] == 1 << 10
            assert rings == [" ".join(map(str, slots[first : first + 16])) for first in (17, 1)]
        page.page.locator("#window-long").scroll_into_view_if_needed()
        before = page.value(count_drawn_pixels("long", 1))
        page.wait("nserver.scene.history['1'].length > 40")
        page.wait(f"{count_drawn_pixels('long', 1)} > {before}")
        page.wait(f"{count_drawn_pixels('long')} > 1000")
        page.wait(f"{count_drawn_pixels('short')} > 1000")


def test_scout_wheels_and_selecting_second_robot(browser: Browser) -> None:
    models = ("--model-file", str(Path(__file__).parents[2] / "worlds" / "models" / "corridor8.toml"))
    words = ("thesis_room", "--robot", "scout", "--robot", "n150", "--robot", "corridor8", *models)
    with nserver(*words) as program, open_page(browser, program.url) as page:
        page.wait("document.querySelector('#window-robot').innerText.includes('0.0 in/s right, 0.0 in/s left')")
        # It has no infrareds and no laser: nothing is shown of them.
        page.wait("document.querySelector('#window-short').innerText.includes('bumper bits')")
        assert "infrared" not in page.page.inner_text("#window-short")
        assert "laser" not in page.page.inner_text("#window-robot")
        page.page.select_option("#robot-choice", "2")
        page.wait("document.querySelector('#window-robot').innerText.includes('n150')")
        # A ring of another size replaces the readings of the ring before.
        page.page.select_option("#robot-choice", "3")
        page.wait("document.querySelector('#window-robot').innerText.includes('corridor8')")
        assert page.value("document.querySelectorAll('#window-long tr').length") == 2
        assert len(page.value("document.querySelector('#window-long td').innerText").split()) == 8


def test_laser_points_follow_clients_modes(browser: Browser) -> None:
    with nserver("thesis_room", "--robot", "n200") as program, open_page(browser, program.url) as page:
        page.wait("(nserver.scene.lasers['1'] ?? []).length > 100")
        x, y = page.value("nserver.scene.lasers['1'].slice(480, 482)")
        assert (x, y) == pytest.approx((102.2, 0), abs=0.2)
        page.wait("document.querySelector('#window-robot').innerText.includes('on, as at power-on')")
        laser_row = "document.querySelector('#window-robot').innerText.match(/laser\\s+(o.*)/)[1]"
        with program.robot() as first, program.robot() as second:
            first.configure_laser(mode=0)
            second.configure_laser(mode=50)
            page.wait("nserver.scene.lasers['1'] === undefined")
            page.wait(f"/off for .* \\(mode 0\\), .* \\(mode 50\\)/.test({laser_row})")
            second.configure_laser(mode=33)
            page.wait("nserver.scene.lasers['1']?.length > 100")
            page.wait(f"/^on for .* \\(mode 33\\); off for .* \\(mode 0\\)$/.test({laser_row})")
        page.page.click("[popovertarget=layers]")
        page.page.click("#layer-laser")
        page.wait("!nserver.map.shown.laser")


def test_scout_bumpers_turn_with_body(browser: Browser) -> None:
    with nserver("thesis_room", "--robot", "scout") as program, open_page(browser, program.url) as page:
        call = "nserver.link.request({ do: 'call', robot: 1, call: '%s', args: %s }).then((answer) => answer.ok)"
        assert page.value(call % ("place_robot", [300, 900, 900, 900]))
        assert page.value(call % ("vm", [100, 100, 0]))
        page.wait("nserver.scene.robots['1'].state[33] !== 0")
        page.page.locator("#window-short").scroll_into_view_if_needed()
        page.wait(
            """(() => { const canvas = document.querySelector('#window-short canvas'), { width, height } = canvas;
            const data = canvas.getContext('2d').getImageData(0, 0, width, height).data, found = [0, 0];
            for (let y = 0; y < height; y += 1) for (let x = 0; x < width; x += 1) {
              const k = 4 * (y * width + x), [red, green, blue] = data.subarray(k, k + 3);
              if (red > 180 && green < 60 && blue < 80) found[height / 2 - y > Math.abs(x - width / 2) ? 0 : 1] += 1;
            } const [above, beside] = found; return above > 10 && beside < above / 4; })()"""
        )
