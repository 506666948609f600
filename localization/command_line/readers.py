"""What commands that drive a robot read from their command line: numbers, places, the robot of an address.

Rules: readers for argparse, which says what it wanted; shared by the commands, none of which is known here.
"""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path
from typing import Final

from localization.filters.odometry import LARGEST, POSE, OdometryNoise
from nclient import ReplyTimeout, Robot, connect
from nclient.errors import OutputFileError
from nclient.unwritable import unwritable

MOST_NOISE: Final = 10
"""More noise than this is a slip of the keyboard."""
UNKNOWN: Final = "unknown"


def opened(address: str | None) -> tuple[Robot, bool]:
    """The robot, and whether it can be asked for the truth: an Nserver of old leaves unknown messages unanswered."""
    robot = connect(address)
    try:
        return robot, robot.is_simulated()
    except ReplyTimeout:
        return connect(address), False


def make_folder(folder: Path) -> None:
    """Before anything is run: the folder for what comes of it. Raises OutputFileError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputFileError(unwritable(folder, error)) from error


def check_writable(*files: Path | None) -> None:
    """Before anything is driven: whether files can be written at its end, in folders that are made where they are not
    there. Raises OutputFileError."""
    for file in filter(None, files):
        make_folder(file.parent)
        real = Path(os.path.realpath(file))
        if real.is_dir() or not os.access(real if real.exists() else real.parent, os.W_OK):
            raise OutputFileError(f"{str(file)!r}: cannot be written there: name a file in a folder that may be "
                                  "written to")


def numbers(text: str, count: int, told: str = "") -> list[float]:
    """So many finite numbers with commas between them; `told`: of what they are, where that is not plain."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        wanted = "a number" if count == 1 else f"{count} numbers with commas between them"
        raise argparse.ArgumentTypeError(f"{wanted}{told}, not {text!r}")
    return numbers


def point(text: str) -> tuple[float, float]:
    """A place, inches."""
    x, y = numbers(text, 2, ", inches, such as 20,40")
    return x, y


def pose(text: str, told: str = "") -> tuple[float, float, float]:
    """A place in inches, and a direction in degrees that becomes radians."""
    x, y, heading_deg = numbers(text, 3, f", inches, inches and degrees{told}")
    return x, y, math.radians(heading_deg)


def start(text: str) -> tuple[float, float, float] | str:
    """A pose, or UNKNOWN."""
    return UNKNOWN if text.strip().lower() == UNKNOWN else pose(text, f", or {UNKNOWN}")


def stds(text: str) -> tuple[float, float, float]:
    """Standard deviations of a pose, likewise."""
    x, y, heading_rad = pose(text)
    if min(x, y, heading_rad) < 0:
        raise argparse.ArgumentTypeError("a standard deviation is not negative")
    return x, y, heading_rad


def noise(text: str) -> OdometryNoise:
    """Three standard deviations of the odometry's noise."""
    found = numbers(text, 3)
    if not all(0 <= number <= MOST_NOISE for number in found):
        raise argparse.ArgumentTypeError(f"three numbers from 0 to {MOST_NOISE}, not {text!r}")
    return OdometryNoise(*found)


def constants(text: str) -> tuple[float, ...]:
    """Standard deviations of the encoders' own errors."""
    stds = tuple(numbers(text, text.count(",") + 1))
    if len(stds) > LARGEST - POSE or min(stds) < 0:
        raise argparse.ArgumentTypeError(f"one to {LARGEST - POSE} numbers of 0 or more, not {text!r}")
    return stds


def seconds(text: str) -> float:
    """A time of 0 s or more."""
    (number,) = numbers(text, 1)
    if number < 0:
        raise argparse.ArgumentTypeError("seconds are 0 or more")
    return number


def positive(text: str) -> float:
    """A number above 0."""
    (number,) = numbers(text, 1)
    if number <= 0:
        raise argparse.ArgumentTypeError("a number above 0")
    return number
