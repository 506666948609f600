"""Estimates published by a localizer: POST /publish, one JSON object per update; the reply contains way-points.

    robot       number of the robot                     clock_s    the robot's clock
    pose        x, y, heading of the steering           turret     its estimated direction
    cov         3 x 3 covariance of the pose            odometry, truth    poses; truth is null where unknown
    echoes      [{"sonar", "reading_in", "refusal", "innovation_in", "nis"} ...] since the previous update
    trust       OK, DEGRADED, LOST    reason    in words, "" for OK
    places      [{"pose", "share"} ...] candidate poses, the most probable first; with LOST pose and cov are undefined
    waypoints   [[x, y] ...], and the number passed     began      true: the localizer starts with its own way-points

    reply       {"waypoints": [[x, y] ...] or null, "set": how often they were set}

Units are inches and radians. Anything else raises InvalidMessage.
"""

from typing import Annotated, Any, Final, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct

from nclient.common.validation import InvalidValue, convert, decode_json, reported_as
from nserver_emu.viewer.messages import MAX_POINTS, Id, InvalidMessage, Number, Point
from worlds.robots import SONARS

Refusal = Literal["none", "limit", "no_wall", "ambiguous_wall", "grazing", "gate"]
Trust = Literal["OK", "DEGRADED", "LOST"]
REFUSALS: Final = get_args(Refusal)
TRUSTS: Final = get_args(Trust)
MAX_ECHOES: Final = 64
MAX_PLACES: Final = 20
MAX_REASON: Final = 200
"""Characters of a reason."""
MAX_READING_IN: Final = 1000.0
"""More than any sonar measures."""
_ROUNDING: Final = 1e-6

Pose = Annotated[list[Number], Meta(min_length=3, max_length=3, title="three numbers")]


class Echo(Struct):
    """An echo since the previous update."""

    sonar: Annotated[int, Meta(ge=0, le=SONARS - 1)]
    reading_in: Annotated[float, Meta(ge=0.0, le=MAX_READING_IN)]
    refusal: Refusal
    innovation_in: Number
    nis: Annotated[float, Meta(ge=0.0, le=1e9)]


class Place(Struct):
    """A candidate pose and its probability."""

    pose: Pose
    share: Annotated[float, Meta(ge=0.0, le=1.0)]


class Estimate(Struct):
    """A published estimate, in inches and radians."""

    robot: Id
    clock_s: Number
    pose: Pose
    turret: Number
    cov: Annotated[list[Pose], Meta(min_length=3, max_length=3, title="three rows of three numbers")]
    odometry: Pose
    truth: Pose | None
    echoes: Annotated[list[Echo], Meta(title="a list of echoes")]
    waypoints: Annotated[list[Point], Meta(title="a list of points [[x, y], ...]")]
    trust: Trust
    reason: str
    places: Annotated[list[Place], Meta(title="a list of places")]
    passed: Id
    began: bool = False

    def __post_init__(self) -> None:
        matrix = np.array(self.cov)
        largest = float(np.abs(matrix).max())
        is_symmetric = np.abs(matrix - matrix.T).max() <= _ROUNDING * largest
        if not is_symmetric or np.linalg.eigvalsh(matrix)[0] < -_ROUNDING * largest:
            raise InvalidValue("is no covariance: not symmetric, or not positive semidefinite", "cov")
        if sum(place.share for place in self.places[:MAX_PLACES]) > 1.0 + _ROUNDING:
            raise InvalidValue("the shares sum to more than 1", "places")


def parse_estimate(text: str) -> dict[str, Any]:
    """Parse and check a published estimate; long lists and reasons are truncated, and the covariance is flattened.

    Raises
    ------
    InvalidMessage
        If a field is missing or wrong.
    """
    with reported_as(InvalidMessage, "published estimate"):
        estimate = convert(decode_json(text), Estimate)
    fields: dict[str, Any] = msgspec.to_builtins(estimate)
    return fields | {
        "cov": [number for row in estimate.cov for number in row],
        "echoes": fields["echoes"][:MAX_ECHOES], "waypoints": estimate.waypoints[:MAX_POINTS],
        "places": fields["places"][:MAX_PLACES], "reason": estimate.reason[:MAX_REASON],
    }  # fmt: skip
