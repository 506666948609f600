"""Draw docs/lost.gif: a robot that does not know where it is and finds itself, by the method `finder`.

    python -m docs.generate.lost_robot

Grey: the robot as it is. Colours: the poses that the filter holds possible, larger where they are more probable; one is
left when the robot has found itself. The run is that of `nomad localize ADDRESS --start unknown`.
"""

import math
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from localization.filters.base import LocalizationConfig, sonar_of
from localization.filters.belief import independent
from localization.filters.health import HealthStatus
from localization.filters.registry import finder
from localization.live.run import RunMoment
from localization.navigation.waypoints import Navigator, follow_waypoints, start_localizer
from nclient import connect
from worlds.io import load_world
from worlds.robots import N150

ADDRESS: Final = "sim:several_walls?setup=measured&seed=1&start=20,10,300,300"
FILE: Final = Path(__file__).parents[1] / "lost.gif"
GOAL: Final = (30.0, 55.0)
SIZE_PX, MARGIN_PX, CAPTION_PX = 420, 14, 30
EVERY: Final = 4
"""Periods of 0.1 s of the robot's time between two frames; while it is lost each period is a frame."""
FRAME_MS, LOST_MS, LAST_MS = 80, 160, 2500
MAX_AFTER_S: Final = 12.0
"""Time shown after the robot has found itself."""
WHITE, GREY, WALL, LOST, FOUND = (255, 255, 255), (170, 170, 170), (40, 40, 40), (214, 90, 40), (20, 120, 70)
Colour = tuple[int, int, int]


def record() -> list[RunMoment]:
    """Return the periods of a run that begins without a pose."""
    room = load_world("several_walls")
    config = LocalizationConfig(room.walls, N150, sonar=sonar_of(N150.ring, rays=False))
    moments: list[RunMoment] = []
    found_s = math.inf
    with connect(ADDRESS) as robot:
        # Without a belief of the start the search begins at once.
        belief = independent([0.0, 0.0, 0.0], [1e3, 1e3, 3.0])
        localizer = start_localizer(robot, config, belief, finder(config, None))
        for step in follow_waypoints(robot, localizer, Navigator([GOAL]), robot.sleep):
            truth, estimate = robot.truth(), step.estimate
            pose = (truth.x_in, truth.y_in, truth.steering_rad)
            moments.append(RunMoment(estimate, pose, pose, step.passed))
            if estimate.health.status is not HealthStatus.LOST:
                found_s = min(found_s, estimate.clock_s)
            if estimate.clock_s > found_s + MAX_AFTER_S:
                break
    return moments


class Frame:
    """One picture: walls, robots and a caption, in inches."""

    def __init__(self, walls: np.ndarray) -> None:
        points = walls.reshape(-1, 2)
        self._low, extent = points.min(axis=0), np.ptp(points, axis=0)
        self._scale = (SIZE_PX - 2 * MARGIN_PX) / float(extent.max())
        self._height_px = round(self._scale * float(extent[1])) + 2 * MARGIN_PX
        self.image = Image.new("RGB", (SIZE_PX, self._height_px + CAPTION_PX), WHITE)
        self._draw = ImageDraw.Draw(self.image)
        for x1, y1, x2, y2 in walls.tolist():
            self._draw.line([self._pixel(x1, y1), self._pixel(x2, y2)], fill=WALL, width=3)

    def _pixel(self, x_in: float, y_in: float) -> tuple[float, float]:
        # The y axis of a picture points down.
        x, y = self._scale * (np.array([x_in, y_in]) - self._low) + MARGIN_PX
        return float(x), self._height_px - float(y)

    def add_robot(self, x_in: float, y_in: float, heading_rad: float, colour: Colour, width: int, fill: bool) -> None:
        """Draw a robot with a line to its front."""
        x, y = self._pixel(x_in, y_in)
        radius = self._scale * N150.radius_in
        box = (x - radius, y - radius, x + radius, y + radius)
        self._draw.ellipse(box, outline=colour, width=width, fill=(225, 225, 225) if fill else None)
        front = (x + radius * math.cos(heading_rad), y - radius * math.sin(heading_rad))
        self._draw.line([(x, y), front], fill=colour, width=width)

    def add_caption(self, text: str, colour: Colour) -> None:
        """Write a line below the map."""
        self._draw.text((MARGIN_PX, self._height_px), text, fill=colour, font_size=16)


def draw(moment: RunMoment, begin_s: float, walls: np.ndarray) -> Image.Image:
    """Return the picture of one period."""
    frame, estimate = Frame(walls), moment.estimate
    assert moment.truth is not None
    frame.add_robot(*moment.truth, colour=GREY, width=2, fill=True)
    # 1. Poses that are possible, the most probable one drawn last.
    colour = LOST if moment.lost else FOUND
    for place in reversed(estimate.places):
        x, y, heading = place.belief.mean[:3].tolist()
        frame.add_robot(x, y, heading, colour, 1 + round(4 * place.probability), fill=False)
    if not moment.lost:
        x, y, heading = estimate.pose.tolist()
        frame.add_robot(x, y, heading, FOUND, 4, fill=False)
    # 2. What the filter reports.
    error = moment.error
    if error is None:
        text = f"LOST: {len(estimate.places)} possible poses" if len(estimate.places) > 1 else "LOST: measuring"
    else:
        text = f"found: {math.hypot(error[0], error[1]):.1f} in off"
    frame.add_caption(f"{estimate.clock_s - begin_s:4.0f} s   {text}", colour)
    return frame.image


def main() -> None:
    """Write the picture."""
    moments, walls = record(), np.asarray(load_world("several_walls").walls)
    begin_s = moments[0].estimate.clock_s
    shown = [moment for k, moment in enumerate(moments) if moment.lost or k % EVERY == 0]
    # One palette for all frames keeps the file small.
    frames = [draw(moment, begin_s, walls).quantize(32, dither=Image.Dither.NONE) for moment in shown]
    times = [*(LOST_MS if moment.lost else FRAME_MS for moment in shown[:-1]), LAST_MS]
    frames[0].save(FILE, save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=True)
    print(f"{FILE}: {len(frames)} frames, {FILE.stat().st_size} bytes, {moments[-1].estimate.clock_s - begin_s:.0f} s")


if __name__ == "__main__":
    main()
