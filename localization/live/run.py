"""What a live run leaves: its moments, and what they come to in words and numbers.

Rules: values and sums; no robot, no file, no drawing.

Where a simulated robot is in truth, at the instants of the estimates that are shown beside it.

Rules: asks the robot once a call; of a real robot nothing is known. No filter ever asks here.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from localization.filters.belief import Floats, add, difference
from localization.filters.health import HealthStatus
from localization.filters.update import Refusal
from localization.live.assumptions import AS_CONES, Taken, hint
from localization.live.localizer import Echo, Estimate
from localization.live.sensor_input import MAX_GAP_S
from nclient.robot import Robot

MOST_PLACES = 4
"""So many are told of in a line."""
Pose = tuple[float, float, float]
"""x_in, y_in, heading of the steering in radians."""


class TruthSample(NamedTuple):
    """The truth, and the clock it belongs to."""

    clock_s: float
    pose: Pose

    def towards(self, later: TruthSample, clock_s: float) -> Pose:
        """The truth between this sighting and a later one, at a clock between theirs: evenly on the way.

        The truth is asked for after the state, so that the robot has gone on by then; each estimate is to be
        compared with the truth of its own instant.
        """
        way_s = later.clock_s - self.clock_s
        share = min(1.0, max(0.0, (clock_s - self.clock_s) / way_s)) if way_s > 0 else 1.0
        start = np.array(self.pose)
        x, y, heading = add(start, share * difference(np.array(later.pose), start))
        return float(x), float(y), float(heading)


class RunMoment(NamedTuple):
    """One period of a run: estimate, what the encoders say (`turret_rad` apart), the truth at that clock if known,
    way-points behind."""

    estimate: Estimate
    odometry: Pose
    truth: Pose | None
    passed: int
    turret_rad: float = 0.0

    @property
    def lost(self) -> bool:
        """Whether no place is believed."""
        return self.estimate.health.status is HealthStatus.LOST

    @property
    def error(self) -> Floats | None:
        """Estimate less truth, (3,) in inches and radians; None where the truth is not known, or no place believed."""
        return None if self.truth is None or self.lost else difference(self.estimate.pose, np.array(self.truth))


@dataclass
class Run:
    """The moments of a run to `waypoints`; `stopped`: why it was given up before its time, "" where it was not;
    `sonars`: for what they are taken."""

    waypoints: list[tuple[float, float]]
    moments: list[RunMoment] = field(default_factory=list)
    stopped: str = ""
    sonars: Taken = AS_CONES

    def add(self, moment: RunMoment) -> None:
        """The next moment."""
        self.moments.append(moment)

    @property
    def reached(self) -> int:
        """How many way-points were reached."""
        return self.moments[-1].passed if self.moments else 0

    @property
    def duration_s(self) -> float:
        """Seconds of the robot's clock."""
        return self.moments[-1].estimate.clock_s - self.moments[0].estimate.clock_s if self.moments else 0.0

    @property
    def longest_gap_s(self) -> float:
        """The longest time between two states; 0 before there are two."""
        clocks = [moment.estimate.clock_s for moment in self.moments]
        return max((after - before for before, after in pairwise(clocks)), default=0.0)

    def errors_in(self) -> Floats:
        """Distance between estimate and truth, (k,) inches, of the moments whose truth is known."""
        found = [moment.error for moment in self.moments]
        return np.array([math.hypot(error[0], error[1]) for error in found if error is not None])

    def odometry_errors_in(self) -> Floats:
        """Distance between what the encoders say and the truth, (k,) inches, likewise."""
        pairs = [(moment.odometry, moment.truth) for moment in self.moments if moment.truth]
        return np.array([math.hypot(told[0] - true[0], told[1] - true[1]) for told, true in pairs])

    def line(self) -> str:
        """The last moment in one line."""
        moment = self.moments[-1]
        if moment.lost:
            return f"{self.duration_s:6.1f} s  {_told(moment.estimate)}"
        x, y, heading = moment.estimate.pose
        std = moment.estimate.belief.std
        text = (
            f"{self.duration_s:6.1f} s  estimate ({x:7.2f}, {y:7.2f}) in {math.degrees(heading):7.2f} deg"
            f"  ± {max(std[0], std[1]):.2f} in {math.degrees(std[2]):.2f} deg"
        )
        if moment.estimate.health.reason:
            text += f"  {_told(moment.estimate)}"
        error = moment.error
        if error is None or moment.truth is None:
            return text
        return (
            f"{text}  truth ({moment.truth[0]:7.2f}, {moment.truth[1]:7.2f})"
            f"  off {math.hypot(error[0], error[1]):.2f} in {math.degrees(error[2]):+.2f} deg"
        )

    def summary(self) -> dict[str, Any]:
        """The run in numbers; null where there is no truth to compare with."""
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
            "echoes_refused": _refused(echoes),
            "trust": last.estimate.health.status.value,
            "reason": last.estimate.health.reason,
            "lost_share": sum(moment.lost for moment in self.moments) / len(self.moments),
            "places": [
                {"pose": place.belief.mean[:3].tolist(), "share": place.probability} for place in last.estimate.places
            ],
            "estimate": [float(value) for value in last.estimate.pose],
            "truth": list(last.truth) if last.truth else None,
            **self._off(),
        }

    def _off(self) -> dict[str, float | None]:
        """How far the estimate and the encoders are off, as summary has it."""
        errors = self.errors_in()
        if not len(errors):
            return dict.fromkeys(("end_error_in", "rmse_position_in", "odometry_end_error_in"))
        return {
            "end_error_in": float(errors[-1]),
            "rmse_position_in": float(np.sqrt((errors**2).mean())),
            "odometry_end_error_in": float(self.odometry_errors_in()[-1]),
        }

    def hint(self) -> str:
        """What to say where readings do not fit what the sonars are taken for."""
        return hint(self.sonars, (echo for moment in self.moments for echo in moment.estimate.echoes))

    def verdict(self) -> str:
        """What became of it, in two or three lines."""
        result = self.summary()
        lines = [
            f"{self.line().strip()}",
            f"{result['reached']} of {result['waypoints']} way-points reached in {result['duration_s']:.1f} s; "
            f"{result['echoes_used']} echoes used, {sum(result['echoes_refused'].values())} refused",
        ]
        if result["end_error_in"] is not None:
            lines.append(
                f"the estimate is {result['end_error_in']:.2f} in off at the end (RMSE {result['rmse_position_in']:.2f}"
                f" in); odometry alone is {result['odometry_end_error_in']:.2f} in off"
            )
        if self.stopped:
            lines.append(f"stopped: {self.stopped}")
        if result["hint"]:
            lines.append(result["hint"])
        if self.longest_gap_s > MAX_GAP_S:
            lines.append(
                f"states came up to {self.longest_gap_s:.1f} s apart: the filter wants them within {MAX_GAP_S} s; "
                "let the time run slower"
            )
        return "\n".join(lines)


def _refused(echoes: Sequence[Echo]) -> dict[str, int]:
    """How many were refused by what, in the order of the reasons; only those that came up."""
    counts = Counter(echo.refusal for echo in echoes)
    return {refusal.name.lower(): counts[refusal] for refusal in Refusal if refusal and refusal in counts}


def _told(estimate: Estimate) -> str:
    """How far an estimate can be believed and why, and where else the robot may be."""
    text = f"{estimate.health.status.value}: {estimate.health.reason}"
    if len(estimate.places) < 2:
        return text
    places = [(*place.belief.mean[:3].tolist(), place.probability) for place in estimate.places[:MOST_PLACES]]
    return f"{text}: " + ", ".join(
        f"({x:.1f}, {y:.1f}) in {math.degrees(heading):.0f} deg {share:.0%}" for x, y, heading, share in places
    )


class GroundTruth:
    """Of one robot; `robot_id` is 1 where nobody tells."""

    def __init__(self, robot: Robot, simulated: bool) -> None:
        self._robot = robot
        self._seen: TruthSample | None = None
        self.robot_id = 1
        if simulated:
            self.robot_id, self._seen = self._look()

    def at(self, clock_s: float) -> tuple[float, float, float] | None:
        """Truth (x in, y in, heading rad) at an instant since the last call; None of a real robot."""
        if self._seen is None:
            return None
        before, (_, self._seen) = self._seen, self._look()
        return before.towards(self._seen, clock_s)

    def _look(self) -> tuple[int, TruthSample]:
        truth = self._robot.truth()
        return truth.robot_id, TruthSample(truth.time_s, (truth.x_in, truth.y_in, truth.steering_rad))
