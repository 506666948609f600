"""Record of a run, live or over a log: its results, the ground truth of simulated robots, its publication on a page.

A run is published to the page of an nserver (--publish URL), which returns waypoints set there.

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
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, NamedTuple
from urllib.parse import urlsplit

import msgspec
import numpy as np

from localization.filters.base import EncoderRow, Filter, NewEcho, Place
from localization.filters.belief import Floats, add, compose, difference, rigid_fit, wrap_angle
from localization.filters.odometry import relative_step
from localization.filters.update import REFUSALS, Refusal
from localization.live.assumptions import ASSUME_CONES, SonarAssumption, sonar_mismatch_hint
from localization.live.estimate import Echo, Estimate
from localization.live.sensor_input import MAX_GAP_S, LogRow, Pose, new_echoes
from nclient.errors import AddressError, ConnectionLost
from nclient.robot import Robot
from nclient.state import RobotState

MAX_MOMENTS = 36_000
"""Periods of a run in memory: an hour. Results of a longer run, which stays on a page, are those of its end."""
MIN_FITTED_IN: Final = 6.0
"""Least spread (RMS distance from the middle) of a true path that is fitted to estimates."""
MAX_PRINTED_HYPOTHESES = 4
"""Largest number of hypotheses in a line of output."""


class TruthSample(NamedTuple):
    """A true pose and the robot clock it belongs to."""

    clock_s: float
    pose: Pose

    def interpolate(self, later: TruthSample, clock_s: float) -> Pose:
        """Return the true pose at a clock between this sample and a later one, by linear interpolation.

        The truth is requested after the state, when the robot has already moved on; each estimate must be compared
        with the truth of its own time.
        """
        interval_s = later.clock_s - self.clock_s
        fraction = min(1.0, max(0.0, (clock_s - self.clock_s) / interval_s)) if interval_s > 0 else 1.0
        start = np.array(self.pose)
        x, y, heading = add(start, fraction * difference(np.array(later.pose), start))
        return float(x), float(y), float(heading)


class RunMoment(NamedTuple):
    """One period of a run: estimate, encoder pose, true pose if available, waypoints reached, turret angle."""

    estimate: Estimate
    odometry: Pose
    truth: Pose | None
    passed: int
    turret_rad: float = 0.0

    @property
    def lost(self) -> bool:
        """True if the estimate is LOST."""
        return self.estimate.health.is_lost

    @property
    def error(self) -> Floats | None:
        """Estimate minus truth (3,), in and rad; None without ground truth and when lost."""
        return None if self.truth is None or self.lost else difference(self.estimate.pose, np.array(self.truth))


@dataclass
class Run:
    """Record of a run.

    Attributes
    ----------
    waypoints
        Goals, inches.
    moments
        One entry per period.
    stopped
        Why the run was given up; "" if it was not.
    sonars
        Assumed sonar model.
    start
        Where the start pose comes from: resume, start, encoders or unknown.
    alike
        Poses (3,) that look like the start.
    has_own_frame
        True if the map has another frame than the simulated world, as a learned one has. Errors are known at the end
        (`fit_truth`).
    """

    waypoints: list[tuple[float, float]]
    moments: list[RunMoment] = field(default_factory=list)
    stopped: str = ""
    sonars: SonarAssumption = ASSUME_CONES
    start: str = ""
    alike: Sequence[Floats] = ()
    has_own_frame: bool = False

    def __post_init__(self) -> None:
        self._begin_s: float | None = None
        self._is_fitted = False

    def add(self, moment: RunMoment) -> None:
        """Append a period; after MAX_MOMENTS the oldest are forgotten."""
        if self._begin_s is None:
            self._begin_s = moment.estimate.clock_s
        self.moments.append(moment)
        if len(self.moments) > MAX_MOMENTS:
            del self.moments[: MAX_MOMENTS // 10]

    @property
    def reached(self) -> int:
        """Number of waypoints reached."""
        return self.moments[-1].passed if self.moments else 0

    @property
    def duration_s(self) -> float:
        """Duration in seconds of the robot's clock."""
        if not self.moments:
            return 0.0
        begin_s = self.moments[0].estimate.clock_s if self._begin_s is None else self._begin_s
        return self.moments[-1].estimate.clock_s - begin_s

    @property
    def longest_gap_s(self) -> float:
        """Longest time between two states; 0 for fewer than two."""
        clocks = [moment.estimate.clock_s for moment in self.moments]
        return max((after - before for before, after in pairwise(clocks)), default=0.0)

    def errors_in(self) -> Floats:
        """Return the position errors (k,) of the estimate in inches, of periods with ground truth."""
        found = [moment.error for moment in self.moments]
        return np.array([math.hypot(error[0], error[1]) for error in found if error is not None])

    def fit_truth(self) -> None:
        """Turn and shift the true path so that it fits the estimates best, on a map with a frame of its own.

        The path of a robot that has hardly moved fits anyhow, and one that was lost all the time has nothing to be
        fitted to: they are left out, and there are no errors.
        """
        self._is_fitted = True
        pairs = [(moment.estimate.pose[:2], moment.truth[:2]) for moment in self.moments
                 if moment.truth is not None and moment.error is not None]  # fmt: skip
        estimates, true = np.array(pairs).reshape(-1, 2, 2).swapaxes(0, 1)
        spread_in = float(np.hypot(*true.std(axis=0))) if pairs else 0.0
        if spread_in < MIN_FITTED_IN:
            self.moments = [moment._replace(truth=None) for moment in self.moments]
            return
        turn, shift = rigid_fit(true, estimates)
        frame = np.array((*shift, turn))
        for row, moment in enumerate(self.moments):
            if moment.truth is not None:
                x, y, heading = compose(frame, np.array(moment.truth)).tolist()
                self.moments[row] = moment._replace(truth=(x, y, wrap_angle(heading)))

    def odometry_errors_in(self) -> Floats:
        """Return the position errors (k,) of the encoders in inches, of periods with ground truth."""
        pairs = [(moment.odometry, moment.truth) for moment in self.moments if moment.truth]
        return np.array([math.hypot(pose[0] - true[0], pose[1] - true[1]) for pose, true in pairs])

    def line(self) -> str:
        """Return the last period as one line of text."""
        moment = self.moments[-1]
        # 1. A lost estimate has no meaning: only the health is shown.
        if moment.lost:
            return f"{self.duration_s:6.1f} s  {_format_health(moment.estimate)}"
        # 2. Estimate with standard deviations; inches and degrees.
        x, y, heading = moment.estimate.pose
        std = moment.estimate.belief.std
        text = (
            f"{self.duration_s:6.1f} s  estimate ({x:7.2f}, {y:7.2f}) in {math.degrees(heading):7.2f} deg"
            f"  ± {max(std[0], std[1]):.2f} in {math.degrees(std[2]):.2f} deg"
        )
        if moment.estimate.health.reason:
            text += f"  {_format_health(moment.estimate)}"
        elif len(moment.estimate.places) > 1:
            text += f"  looks like {_format_places(moment.estimate.places[1:])}"
        # 3. Its error, for a simulated robot.
        error = moment.error
        if error is None or moment.truth is None or (self.has_own_frame and not self._is_fitted):
            return text
        return (
            f"{text}  truth ({moment.truth[0]:7.2f}, {moment.truth[1]:7.2f})"
            f"  off {math.hypot(error[0], error[1]):.2f} in {math.degrees(error[2]):+.2f} deg"
        )

    def summary(self) -> dict[str, Any]:
        """Return the results of the run as plain data; errors are None without ground truth."""
        # Other programs read this object: its keys and units do not change.
        echoes = [echo for moment in self.moments for echo in moment.estimate.echoes]
        last = self.moments[-1]
        return {
            "pose_units": ["in", "in", "rad"],
            "waypoints": len(self.waypoints),
            "reached": self.reached,
            "duration_s": round(self.duration_s, 3),
            "stopped": self.stopped or None,
            "hint": self.hint() or None,
            "echoes_used": sum(echo.refusal is Refusal.NONE for echo in echoes),
            "echoes_refused": _count_refusals(echoes),
            "trust": last.estimate.health.status.value,
            "reason": last.estimate.health.reason,
            "lost_share": sum(moment.lost for moment in self.moments) / len(self.moments),
            "places": _places_as_json(last.estimate.places),
            "start": self.start or None,
            "alike": [pose.tolist() for pose in self.alike],
            "estimate": [float(value) for value in last.estimate.pose],
            "truth": list(last.truth) if last.truth else None,
            "truth_frame": None if last.truth is None else "fitted" if self.has_own_frame else "world",
            **self._errors(),
        }

    def _errors(self) -> dict[str, float | None]:
        """Return the position errors of the summary."""
        # Without ground truth the keys are present with null, so that readers need no special case.
        errors = self.errors_in()
        if not len(errors):
            return dict.fromkeys(("end_error_in", "rmse_position_in", "odometry_end_error_in"))
        return {
            "end_error_in": float(errors[-1]),
            "rmse_position_in": float(np.sqrt((errors**2).mean())),
            "odometry_end_error_in": float(self.odometry_errors_in()[-1]),
        }

    def hint(self) -> str:
        """Return a hint if the readings do not fit the assumed sonar model; else ""."""
        return sonar_mismatch_hint(self.sonars, (echo for moment in self.moments for echo in moment.estimate.echoes))

    def verdict(self) -> str:
        """Return the results of the run as a few lines of text."""
        # 1. Last period and totals.
        result = self.summary()
        lines = [
            f"{self.line().strip()}",
            f"{result['reached']} of {result['waypoints']} waypoints reached in {result['duration_s']:.1f} s; "
            f"{result['echoes_used']} echoes used, {sum(result['echoes_refused'].values())} refused",
        ]
        # 2. Errors, with odometry alone for comparison.
        if result["end_error_in"] is not None:
            lines.append(
                f"the estimate is {result['end_error_in']:.2f} in off at the end (RMSE {result['rmse_position_in']:.2f}"
                f" in); odometry alone is {result['odometry_end_error_in']:.2f} in off"
            )
            if self.has_own_frame:
                lines.append("these errors are from the true path as it fits best: the map has a frame of its own")
        # 3. What the user may have to change.
        if self.stopped:
            lines.append(f"stopped: {self.stopped}")
        if result["hint"]:
            lines.append(result["hint"])
        if self.longest_gap_s > MAX_GAP_S:
            lines.append(
                f"states came up to {self.longest_gap_s:.1f} s apart: the filter needs them within {MAX_GAP_S} s; "
                "run the simulation slower"
            )
        return "\n".join(lines)


def _count_refusals(echoes: Sequence[Echo]) -> dict[str, int]:
    """Return the number of refused echoes by reason, in the order of the reasons; zeros are omitted."""
    counts = Counter(echo.refusal for echo in echoes)
    return {refusal.name.lower(): counts[refusal] for refusal in Refusal if refusal and refusal in counts}


def _format_health(estimate: Estimate) -> str:
    """Return health status, reason and alternative hypotheses of an estimate as text."""
    text = f"{estimate.health.status.value}: {estimate.health.reason}"
    # Several hypotheses: the most probable ones with their probabilities.
    if len(estimate.places) < 2:
        return text
    return f"{text}: {_format_places(estimate.places)}"


def _format_places(places: Sequence[Place]) -> str:
    """Return the first of some hypotheses as text."""
    poses = [(*place.belief.mean[:3].tolist(), place.probability) for place in places[:MAX_PRINTED_HYPOTHESES]]
    return ", ".join(f"({x:.1f}, {y:.1f}) in {math.degrees(turn):.0f} deg {share:.0%}" for x, y, turn, share in poses)


def _places_as_json(places: Sequence[Place]) -> list[dict[str, Any]]:
    return [{"pose": place.belief.mean[:3].tolist(), "share": place.probability} for place in places]


class GroundTruth:
    """True poses of a simulated robot, at the times of estimates; `robot_id` is 1 for a real robot.

    Filters never use it.

    Attributes
    ----------
    robot_id
        Number of the robot in its simulation.
    first
        Its true pose (in, in, rad) now, at the beginning; None for a real robot.
    """

    def __init__(self, robot: Robot, simulated: bool) -> None:
        self._robot = robot
        self._sample: TruthSample | None = None
        self.robot_id, self.first = 1, None
        if simulated:
            self.robot_id, self._sample = self._request()
            self.first = self._sample.pose

    def at(self, clock_s: float) -> Pose | None:
        """Return the true pose (in, in, rad) at a time since the last call; None for a real robot."""
        if self._sample is None:
            return None
        # The estimate's time lies between two queries: the true pose is interpolated between them.
        before, (_, self._sample) = self._sample, self._request()
        return before.interpolate(self._sample, clock_s)

    def moment(self, estimate: Estimate, state: RobotState, passed: int = 0) -> RunMoment:
        """Return a period of a run, with odometry and ground truth at the time of the estimate."""
        odometry = (state.x_in, state.y_in, state.steering_rad)
        return RunMoment(estimate, odometry, self.at(estimate.clock_s), passed, state.turret_rad)

    def _request(self) -> tuple[int, TruthSample]:
        truth = self._robot.truth()
        return truth.robot_id, TruthSample(truth.time_s, (truth.x_in, truth.y_in, truth.steering_rad))


# A filter over a recorded drive.


def run_log(rows: Sequence[LogRow], period_s: float, localizer: Filter) -> Run:
    """Return the record of a filter over a whole log, see `localize_log`."""
    echoes = new_echoes([row.sonars_in for row in rows], [row.clock_s for row in rows], period_s)
    run = Run([])
    for moment in localize_log(rows, echoes, localizer):
        run.add(moment)
    return run


def localize_log(rows: Sequence[LogRow], echoes: Sequence[Sequence[int]], localizer: Filter) -> Iterator[RunMoment]:
    """Yield the estimate after each row of a log: predict by its odometry, then update by its new readings.

    Parameters
    ----------
    echoes
        For each row the sonars whose reading is new, see `new_echoes`.
    localizer
        The filter; its belief is over the pose at the first row.
    """
    before = _encoders(rows[0])
    for row, sonars in zip(rows, echoes, strict=True):
        now = _encoders(row)
        new: list[NewEcho] = [(row.clock_s, sonar, row.sonars_in[sonar]) for sonar in sonars]
        poses = [before, now]
        outcomes = localizer.process(before, poses, new)
        if not new:
            localizer.predict(*relative_step(*before[1:4], *now[1:4]))
        before = now
        found = tuple(
            Echo(sonar, instant_s, reading, REFUSALS[code], innovation_in, nis, outlier)
            for (instant_s, sonar, reading), (code, innovation_in, nis, outlier, *_) in zip(new, outcomes, strict=True)
        )
        estimate = Estimate(row.clock_s, localizer.belief, found, localizer.health, places=localizer.places)
        yield RunMoment(estimate, row.odometry, row.truth, 0, row.turret_rad)


def _encoders(row: LogRow) -> EncoderRow:
    return (row.clock_s, *row.odometry, row.turret_rad)


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
        "places": _places_as_json(estimate.places[:MAX_HYPOTHESES]),
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
