"""Tells the page of an nserver what the filter thinks, and brings back where to go (--publish URL of
`nomad localize`, go and mission).

    moment ──> POST URL/publish ──> {"waypoints": ..., "set": n} ──> new way-points, once they were set anew

Rules: the page's address is the one that nserver printed, its token in it. Inches and radians. A page that cannot be
reached at the beginning is an error; one that is lost on the way is told of and tried again now and then, and the robot
drives on: nothing waits for a page longer than a fraction of a second. What it missed last it is told at the end.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import logging
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, Final
from urllib.parse import urlsplit

from localization.live.run import RunMoment
from nclient.errors import AddressError, ConnectionLost

log = logging.getLogger(__name__)

FIRST_TIMEOUT_S: Final = 5.0
TIMEOUT_S: Final = 0.25
"""On the way: the robot stops by itself when nothing is said to it for 2 s."""
LAST_TIMEOUT_S: Final = 1.0
"""At the end, when the robot stands."""
AGAIN_S: Final = 3.0
"""From a loss to the next try."""
MOST_PLACES: Final = 20
"""So many of the places where the robot may be, the likeliest first."""
Points = list[tuple[float, float]]


def message(
    robot: int, moment: RunMoment, turret_rad: float, waypoints: Sequence[tuple[float, float]]
) -> dict[str, Any]:
    """What is published of a moment; `turret_rad`: the turret's direction against the steering's."""
    estimate = moment.estimate
    return {
        "robot": robot, "clock_s": estimate.clock_s, "pose": estimate.pose.tolist(),
        "turret": float(estimate.pose[2]) + turret_rad, "cov": estimate.belief.cov[:3, :3].tolist(),
        "odometry": list(moment.odometry), "truth": None if moment.truth is None else list(moment.truth),
        "echoes": [
            {"sonar": echo.sonar, "reading_in": echo.reading_in, "refusal": echo.refusal.name.lower(),
             "innovation_in": echo.innovation_in, "nis": echo.nis}
            for echo in estimate.echoes
        ],
        "waypoints": [list(point) for point in waypoints], "passed": moment.passed,
        "trust": estimate.health.status.value, "reason": estimate.health.reason,
        "places": [
            {"pose": place.belief.mean[:3].tolist(), "share": place.probability}
            for place in estimate.places[:MOST_PLACES]
        ],
    }  # fmt: skip


def parse_answer(answer: bytes) -> tuple[Points, int]:
    """The way-points that a page answers, none where they were cleared, and how often they were set.

    Raises ValueError for whatever is no such answer.
    """
    try:
        said = json.loads(answer)
        wanted = [(float(x), float(y)) for x, y in said["waypoints"] or ()]
        if not all(map(math.isfinite, (number for point in wanted for number in point))):
            raise ValueError("a way-point that is no number")
        return wanted, int(said["set"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(f"no answer of a page: {type(error).__name__}: {error}") from None


class Publisher:
    """The way to one page; `clock`: seconds that only grow. Raises AddressError for a URL that is none of a page's."""

    def __init__(self, url: str, clock: Callable[[], float] = time.monotonic) -> None:
        parts = urlsplit(url)
        try:
            port = parts.port
        except ValueError:
            port = None
        if parts.scheme != "http" or not parts.hostname or not port or not parts.query.startswith("token="):
            raise AddressError(f"{url!r} is no page: take the address that nserver --viewer printed, "
                               "such as http://127.0.0.1:7080/?token=...")
        self._place = f"{parts.hostname}:{port}"
        self._path = f"/publish?{parts.query}"
        self._connection = http.client.HTTPConnection(parts.hostname, port, timeout=FIRST_TIMEOUT_S)
        self._clock = clock
        self._set: int | None = None
        self._lost_s: float | None = None
        self._unsaid: dict[str, Any] | None = None

    def tell(self, said: dict[str, Any]) -> Points | None:
        """Publish; way-points that were set at the page since, none where they were cleared. Raises ConnectionLost at
        the first time only."""
        first, self._unsaid = self._set is None, said
        if self._lost_s is not None and self._clock() - self._lost_s < AGAIN_S:
            return None
        try:
            wanted, number = parse_answer(self._post(json.dumps(said | {"began": True} if first else said)))
            before, self._set = self._set, number
        except (OSError, http.client.HTTPException, ValueError) as error:
            self._lose(error)
            return None
        self._unsaid = None
        if self._lost_s is not None:
            log.warning("%s is there again", self._place)
            self._lost_s = None
        return None if first or before == self._set else wanted

    def _lose(self, error: Exception) -> None:
        self._connection.close()
        if self._set is None:
            raise ConnectionLost(f"cannot publish to {self._place}: {error}") from error
        if self._lost_s is None:
            log.warning("%s is lost, tried again now and then: %s", self._place, error)
        self._lost_s = self._clock()

    def close(self) -> None:
        """Tell the page what it missed last, if it is there again, and let go of the connection. Twice is fine."""
        unsaid, self._unsaid = self._unsaid, None
        if unsaid is not None and self._set is not None:
            self._connection.timeout = LAST_TIMEOUT_S
            with contextlib.suppress(OSError, http.client.HTTPException, ValueError):
                self._post(json.dumps(unsaid))
        self._connection.close()

    def _post(self, text: str) -> bytes:
        self._connection.request("POST", self._path, text, {"Content-Type": "application/json"})
        response = self._connection.getresponse()
        body = response.read()
        self._connection.timeout = TIMEOUT_S
        if self._connection.sock is not None:
            self._connection.sock.settimeout(TIMEOUT_S)
        if response.status != http.client.OK:
            raise ValueError(body.decode(errors="replace").strip() or str(response.status))
        return body
