"""Estimates, and the one that a run saves: its validity when another run continues from it (--save, --resume).

    encoders unchanged                       the robot stood: the belief is unchanged
    encoders moved by a possible drive       the robot was driven on an unknown path: belief moved and widened
    encoders set, or robot switched off      rejected, unless the possible displacement is given (`displacement_std`)
    another map or robot                     rejected

The file is JSON; every key is checked when it is read:

    {"format": "nomad estimate 1", "world", "walls", "body", "clock_s", "encoders": [x_in, y_in, steering_rad],
     "turret_rad", "mean": [n numbers], "cov": [n rows of n numbers]}
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from math import cos, degrees, hypot, pi, sin
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from localization.filters.base import Place
from localization.filters.belief import HEADING, POSE, Belief, Floats, add, difference
from localization.filters.health import HEALTHY, FilterHealth
from localization.filters.odometry import MAX_STATE, OdometryNoise
from localization.filters.update import Refusal
from localization.live.sensor_input import EncoderPose
from nclient.common.files import read_text, write_atomic
from nclient.common.validation import InvalidValue, convert, decode_json, reported_as
from nclient.errors import EstimateFileError
from worlds.world import World

DETOUR_FACTOR: Final = 3.0
"""Assumed length of an unobserved drive, relative to its straight distance."""
EXTRA_TURN_RAD: Final = pi
"""Assumed turning of an unobserved drive in addition to the difference of the encoders."""
MAX_DISPLACEMENT_IN: Final = 60.0
"""After a longer unobserved drive the saved estimate is useless."""
MIN_DRIVEN_IN: Final = 24.0
"""Displacement that is assumed of a drive which may have led back."""
TOP_SPEED_IN_S: Final = 40.0
"""No robot drives faster: a faster change means that the encoders were set."""
STANDS_IN: Final = 0.15
STANDS_RAD: Final = 0.003
"""Encoders have a resolution of 0.1 in and 0.1 deg; within this the robot stood."""
_SLACK_IN: Final = 1.0
_REMEDY: Final = (
    "give the possible displacement (--displacement-std X,Y,HEADING; 0,0,0 if the robot stood), or omit --resume"
)

DisplacementStd = tuple[float, float, float]
"""Standard deviations in inches, inches, radians."""


class Echo(NamedTuple):
    """One reading and its outcome.

    Attributes
    ----------
    innovation_in
        Reading less expected range; 0 where nothing was expected.
    nis
        Squared innovation over its variance.
    outlier_probability
        0 or 1 where a gate decides.
    """

    sonar: int
    instant_s: float
    reading_in: float
    refusal: Refusal
    innovation_in: float
    nis: float = 0.0
    outlier_probability: float = 0.0


class Smoothed(NamedTuple):
    """The belief at `clock_s`, some time ago, by all readings until now."""

    clock_s: float
    belief: Belief


class Estimate(NamedTuple):
    """The belief at `clock_s` of the robot's clock, and the echoes since the last one.

    `smoothed` is of filters that smooth, `places` of filters that search: all poses at which the robot may be. Where
    these look alike, `informative_turn_rad` is the turn to the direction in which driving distinguishes them soonest.
    """

    clock_s: float
    belief: Belief
    echoes: tuple[Echo, ...]
    health: FilterHealth = HEALTHY
    smoothed: Smoothed | None = None
    places: tuple[Place, ...] = ()
    informative_turn_rad: float | None = None

    def _repr_html_(self) -> str:
        (x, y, heading), std = self.pose.tolist(), self.belief.std[:POSE].tolist()
        used = sum(echo.refusal is Refusal.NONE for echo in self.echoes)
        rows = {
            "pose": f"x {x:.2f} ± {std[0]:.2f} in, y {y:.2f} ± {std[1]:.2f} in, "
            f"heading {degrees(heading):.2f} ± {degrees(std[2]):.2f}°",
            "health": escape(f"{self.health.status.value} {self.health.reason}".strip()),
            "echoes": f"{len(self.echoes)} since the last estimate, {used} used",
            "clock": f"{self.clock_s:.2f} s",
        }
        cells = (f"<tr><th style='text-align:left'>{name}</th><td>{text}</td></tr>" for name, text in rows.items())
        return f"<table>{''.join(cells)}</table>"

    @property
    def pose(self) -> Floats:
        """x_in, y_in and the heading of the steering in radians, (3,)."""
        return self.belief.mean[:POSE]


class MapSignature(NamedTuple):
    """Identity of map and robot: name of the map, digest of its walls, name of the robot's body."""

    world: str
    walls: str
    body: str


@dataclass(frozen=True, slots=True)
class SavedEstimate:
    """A belief over states (n,), the map and robot it belongs to, and the encoders at its time."""

    signature: MapSignature
    encoders: EncoderPose
    belief: Belief


def map_signature(world: World, body: str) -> MapSignature:
    """Return the signature of a map and a body; order of walls and differences below 1e-6 in are ignored."""
    # Adding 0.0 turns -0.0 into 0.0, which has another repr. 16 hex digits identify a map well enough.
    ends = np.round(world.walls.reshape(-1, 2, 2), 6) + 0.0
    walls = sorted(sorted(wall) for wall in ends.tolist())
    return MapSignature(world.name, sha256(repr(walls).encode()).hexdigest()[:16], body)


def resume_belief(saved: SavedEstimate, signature: MapSignature, now: EncoderPose, noise: OdometryNoise,
                  displacement_std: DisplacementStd | None = None) -> Belief:  # fmt: skip
    """Return the belief of a robot after a pause.

    Parameters
    ----------
    saved : SavedEstimate
    signature : MapSignature
        Current map and robot.
    now : EncoderPose
        Current encoders.
    noise : OdometryNoise
    displacement_std : (in, in, rad), optional
        Standard deviations of a displacement that the encoders did not measure.

    Raises
    ------
    EstimateFileError
        If the saved estimate does not apply; the message states why and what to do.
    """
    # 1. An estimate on other walls has no meaning.
    _require_same_map(saved.signature, signature)
    # 2. No displacement stated: the encoders must have measured all motion.
    if displacement_std is None:
        _require_continuous(saved.encoders, now)
        return _predict_unobserved(saved, now, noise)
    # 3. Displacement stated: use the encoders if they are continuous, and add its variance.
    belief = _predict_unobserved(saved, now, noise) if _is_continuous(saved.encoders, now) else saved.belief
    cov = belief.cov.copy()
    cov[:POSE, :POSE] += np.diag(np.square(displacement_std))
    return Belief(belief.mean, cov)


def _require_same_map(old: MapSignature, current: MapSignature) -> None:
    if old.walls != current.walls:
        raise EstimateFileError(
            f"the estimate is of the map {old.world!r}, whose walls are not those of {current.world!r}: "
            f"use the original --map {old.world}, or omit --resume"
        )
    if old.body != current.body:
        raise EstimateFileError(
            f"the estimate is of a {old.body}, not of a {current.body}: use --body {old.body}, or omit --resume"
        )


def _require_continuous(before: EncoderPose, now: EncoderPose) -> None:
    """Raise EstimateFileError unless the encoders have counted continuously since the estimate was saved."""
    if now.clock_s < before.clock_s:
        raise EstimateFileError(
            f"the robot's clock went back from {before.clock_s:.1f} to {now.clock_s:.1f} s: it was switched off "
            f"and on, and its encoders did not measure that time; {_REMEDY}"
        )
    if not _is_continuous(before, now):
        x, y, _ = now.pose
        raise EstimateFileError(
            f"the encoders were set meanwhile: they read ({x:.1f}, {y:.1f}) in, and read "
            f"({before.pose[0]:.1f}, {before.pose[1]:.1f}) when the estimate was saved; {_REMEDY}"
        )
    distance_in = _distance_in(before, now)
    if distance_in > MAX_DISPLACEMENT_IN:
        raise EstimateFileError(
            f"the robot was driven {distance_in:.0f} in away without a filter; beyond "
            f"{MAX_DISPLACEMENT_IN:.0f} in the estimate is useless: omit --resume"
        )


def _is_continuous(before: EncoderPose, now: EncoderPose) -> bool:
    """Return True if the change of the encoders can be the result of driving."""
    # A switched-on robot starts at (0, 0, 0), so a pose of zeros after motion means a restart.
    passed_s = now.clock_s - before.clock_s
    zeroed = not now.pose.any() and not _has_stood(before, now)
    return passed_s >= 0.0 and not zeroed and _distance_in(before, now) <= TOP_SPEED_IN_S * passed_s + _SLACK_IN


def _predict_unobserved(saved: SavedEstimate, now: EncoderPose, noise: OdometryNoise) -> Belief:
    """Return the belief moved by the difference of the encoders along an unknown path.

    P' = F P F' + Q with an isotropic Q: the heading is uncertain by turns and distance, the position by the distance
    and, along it, by that heading.
    """
    belief = saved.belief
    if _has_stood(saved.encoders, now):
        return belief
    # 1. Difference of the encoders, rotated into the frame of the belief.
    change = difference(now.pose, saved.encoders.pose)
    apart = float(belief.mean[HEADING] - saved.encoders.pose[HEADING])
    dx = cos(apart) * change[0] - sin(apart) * change[1]
    dy = sin(apart) * change[0] + cos(apart) * change[1]
    # 2. Covariance.
    jacobian = np.eye(len(belief.mean))
    jacobian[0, HEADING], jacobian[1, HEADING] = -dy, dx
    cov = jacobian @ belief.cov @ jacobian.T
    cov[:POSE, :POSE] += np.diag(_unobserved_variance(hypot(dx, dy), abs(float(change[HEADING])), noise))
    # 3. Mean.
    mean = belief.mean.copy()
    mean[:POSE] = add(belief.mean[:POSE], np.array([dx, dy, change[HEADING]]))
    return Belief(mean, cov)


def _unobserved_variance(straight_in: float, turned_rad: float, noise: OdometryNoise) -> Floats:
    """Return variances (3,) of a drive with this net displacement, assumed longer and more winding than that."""
    # Variances grow linearly with distance and turn; the position also moves by the heading error.
    distance, turn = DETOUR_FACTOR * straight_in, DETOUR_FACTOR * turned_rad + EXTRA_TURN_RAD
    heading = noise.rotation_std**2 * turn + noise.drift_std**2 * distance
    position = noise.translation_std**2 * distance + heading * distance * distance
    return np.array([position, position, heading])


def encoder_std(now: Floats, starts: Floats, std: Floats, noise: OdometryNoise) -> tuple[Floats, float]:
    """Return standard deviations (3,) of the pose of encoders that were last right at one of some starts.

    The protocol reports neither a distance driven nor when the encoders were set: the displacement from the nearest of
    the poses stands for both, as of a saved estimate, and MIN_DRIVEN_IN for a drive that ended beside it.

    Parameters
    ----------
    now : (3,) array
        Encoders, inches and radians.
    starts : (n, 3) array
        Poses at which a robot is switched on or placed.
    std : (3,) array
        Standard deviations where the robot has not driven.
    noise : OdometryNoise

    Returns
    -------
    std : (3,) array
    driven_in : float
        Displacement; 0 at one of the poses.
    """
    offset = difference(np.broadcast_to(now, starts.shape), starts)
    far = np.hypot(offset[:, 0], offset[:, 1])
    if ((far <= STANDS_IN) & (np.abs(offset[:, HEADING]) <= STANDS_RAD)).any():
        return std, 0.0
    nearest = int(far.argmin())
    driven_in = max(MIN_DRIVEN_IN, float(far[nearest]))
    variance = _unobserved_variance(driven_in, abs(float(offset[nearest, HEADING])), noise)
    return np.sqrt(np.square(std) + variance), driven_in


def _has_stood(before: EncoderPose, now: EncoderPose) -> bool:
    turned = abs(float(difference(now.pose, before.pose)[HEADING]))
    return _distance_in(before, now) <= STANDS_IN and turned <= STANDS_RAD


def _distance_in(before: EncoderPose, now: EncoderPose) -> float:
    return hypot(*(now.pose - before.pose)[:HEADING])


FORMAT: Final = "nomad estimate 1"
MAX_BYTES: Final = 1 << 16
"""Twenty times the size of the largest state."""
MAX_NUMBER: Final = 1e12
"""No time, length or angle of a run, and no square of one, is larger."""
MIN_EIGENVALUE: Final = -1e-9
"""Rounding may make a singular covariance slightly negative."""


Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]


class _EstimateFile(Struct, forbid_unknown_fields=True):
    format: str
    world: str
    walls: str
    body: str
    clock_s: Number
    encoders: Annotated[list[Number], Meta(min_length=POSE, max_length=POSE, title=f"{POSE} numbers")]
    turret_rad: Number
    mean: Annotated[list[Number], Meta(min_length=POSE, max_length=MAX_STATE)]
    cov: list[list[Number]]


def save(path: Path, saved: SavedEstimate) -> None:
    """Write a saved estimate; the file is replaced as a whole. Raises EstimateFileError."""
    values = {
        "format": FORMAT,
        **saved.signature._asdict(),
        "clock_s": saved.encoders.clock_s,
        "encoders": saved.encoders.pose.tolist(),
        "turret_rad": saved.encoders.turret_rad,
        "mean": saved.belief.mean.tolist(),
        "cov": saved.belief.cov.tolist(),
    }
    write_atomic(path, json.dumps(values, indent=1) + "\n", EstimateFileError)


def load(path: Path) -> SavedEstimate:
    """Read a saved estimate and check every key. Raises EstimateFileError."""
    text = read_text(path, MAX_BYTES, EstimateFileError)
    with reported_as(EstimateFileError, str(path)):
        # The format first: for any other file the message is about the file, not about a key.
        values = decode_json(text)
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise InvalidValue(f"expected {FORMAT!r}: a file that `nomad localize --save` wrote", "format")
        found = convert(values, _EstimateFile)
        encoders = EncoderPose.of(found.clock_s, np.array(found.encoders), found.turret_rad)
        return SavedEstimate(MapSignature(found.world, found.walls, found.body), encoders, _belief(found))


def _belief(found: _EstimateFile) -> Belief:
    # The state is the pose and possibly odometry parameters.
    mean, size = np.array(found.mean), len(found.mean)
    if [len(row) for row in found.cov] != [size] * size:
        raise InvalidValue(f"expected {size} by {size} numbers", "cov")
    cov = np.array(found.cov)
    if not np.allclose(cov, cov.T) or np.linalg.eigvalsh(cov)[0] < MIN_EIGENVALUE:
        raise InvalidValue("is not a covariance: expected a symmetric, positive semidefinite matrix", "cov")
    return Belief(mean, 0.5 * (cov + cov.T))
