"""Publish a run to the page of an nserver (--publish URL) and receive waypoints set there.

    period ──> POST URL/publish ──> {"waypoints": ..., "set": n} ──> new waypoints, if n has changed

Inches and radians. A page that cannot be reached at the beginning is an error. A connection lost later is logged and
retried at intervals while the robot drives on: no request takes longer than a fraction of a second. The last message
that could not be sent is sent at the end.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import logging
import time
from collections.abc import Callable, Sequence
from typing import Any, Final
from urllib.parse import urlsplit

import msgspec

from localization.live.run import RunMoment
from nclient.errors import AddressError, ConnectionLost

log = logging.getLogger(__name__)

# Before the run the robot stands, so that a slow page may take its time.
FIRST_TIMEOUT_S: Final = 5.0
TIMEOUT_S: Final = 0.25
"""During a run: the robot stops by itself after 2 s without a command."""
LAST_TIMEOUT_S: Final = 1.0
"""At the end of a run, when the robot stands."""
RETRY_S: Final = 3.0
"""Time from a lost connection to the next attempt."""
MAX_HYPOTHESES: Final = 20
"""Largest number of published hypotheses, the most probable first."""
Points = list[tuple[float, float]]


def build_message(robot: int, moment: RunMoment, waypoints: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Return the published message of a period."""
    # Inches and radians; the page converts them for display.
    estimate = moment.estimate
    return {
        "robot": robot, "clock_s": estimate.clock_s, "pose": estimate.pose.tolist(),
        "turret": float(estimate.pose[2]) + (moment.turret_rad - moment.odometry[2]),
        "cov": estimate.belief.cov[:3, :3].tolist(),
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
            for place in estimate.places[:MAX_HYPOTHESES]
        ],
    }  # fmt: skip


class _Answer(msgspec.Struct):
    waypoints: Points | None
    set: int


def parse_answer(answer: bytes) -> tuple[Points, int]:
    """Return the waypoints in the page's answer, empty if they were cleared, and how often they have been set.

    Raises
    ------
    ValueError
        If the answer is invalid.
    """
    try:
        found = msgspec.json.decode(answer, type=_Answer)
    # All that a foreign server at this address may send.
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise ValueError(f"invalid answer of the page: {error}") from None
    # They are null if they were cleared.
    return found.waypoints or [], found.set


class Publisher:
    """Connection to one page.

    Parameters
    ----------
    url : str
        The address that nserver printed, with its token.
    clock : callable
        Monotonic clock in seconds.

    Raises
    ------
    AddressError
        If the URL is not that of a page.
    """

    def __init__(self, url: str, clock: Callable[[], float] = time.monotonic) -> None:
        parts = urlsplit(url)
        try:
            port = parts.port
        except ValueError:
            port = None
        if parts.scheme != "http" or not parts.hostname or not port or not parts.query.startswith("token="):
            raise AddressError(
                f"{url!r} is not the address of a page: use the one that nserver --viewer printed, "
                "such as http://127.0.0.1:7080/?token=..."
            )
        self._address = f"{parts.hostname}:{port}"
        self._path = f"/publish?{parts.query}"
        self._connection = http.client.HTTPConnection(parts.hostname, port, timeout=FIRST_TIMEOUT_S)
        self._clock = clock
        self._set: int | None = None
        self._lost_s: float | None = None
        self._unsent: dict[str, Any] | None = None

    def publish(self, message: dict[str, Any]) -> Points | None:
        """Publish a message and return waypoints set on the page since the last one, None if there are no new ones.

        Raises ConnectionLost at the first message only; a connection lost later is logged and retried.
        """
        # 1. After a lost connection wait RETRY_S, and remember only the newest message.
        first, self._unsent = self._set is None, message
        if self._lost_s is not None and self._clock() - self._lost_s < RETRY_S:
            return None
        try:
            # 2. Send; the first message of a run says so, which starts a new run on the page.
            waypoints, number = parse_answer(self._post(json.dumps(message | {"began": True} if first else message)))
            before, self._set = self._set, number
        except (OSError, http.client.HTTPException, ValueError) as error:
            self._lose(error)
            return None
        # 3. Waypoints are new if their number has changed since the last answer.
        self._unsent = None
        if self._lost_s is not None:
            log.warning("%s is connected again", self._address)
            self._lost_s = None
        if first:
            # Those that wait on the page are for a run without waypoints of its own.
            return (waypoints or None) if message.get("waypoints") == [] else None
        return None if before == self._set else waypoints

    def _lose(self, error: Exception) -> None:
        self._connection.close()
        # No answer yet: the address is probably wrong, which the user should know before the robot drives.
        if self._set is None:
            raise ConnectionLost(f"cannot publish to {self._address}: {error}") from error
        if self._lost_s is None:
            log.warning("%s is lost, retrying: %s", self._address, error)
        self._lost_s = self._clock()

    def close(self) -> None:
        """Send the last unsent message if possible, and close the connection; may be called twice."""
        unsent, self._unsent = self._unsent, None
        if unsent is not None and self._set is not None:
            self._connection.timeout = LAST_TIMEOUT_S
            with contextlib.suppress(OSError, http.client.HTTPException, ValueError):
                self._post(json.dumps(unsent))
        self._connection.close()

    def _post(self, text: str) -> bytes:
        self._connection.request("POST", self._path, text, {"Content-Type": "application/json"})
        response = self._connection.getresponse()
        body = response.read()
        # Both the next connection and the open socket get the short timeout.
        self._connection.timeout = TIMEOUT_S
        if self._connection.sock is not None:
            self._connection.sock.settimeout(TIMEOUT_S)
        if response.status != http.client.OK:
            raise ValueError(body.decode(errors="replace").strip() or str(response.status))
        return body
