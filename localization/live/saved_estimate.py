"""What a filter held to be true when its program ended, and what of that still holds when another goes on from it.

    encoders as they were                        the robot stood: the belief holds as it is
    encoders a drive of somebody's farther       it went there by a way nobody saw: moved, and widened for that way
    encoders set, or the robot switched off      they tell nothing of the time between: refused, unless whoever starts
                                                 says how far the robot may have been moved (`moved_std`)
    another map or robot                         refused

Rules: values; no file (kept_file.py), no robot, no clock but the robot's. What is refused is an EstimateFileError with
the reason and the remedy.

A kept belief on disk: JSON, every key checked when it is read.

    {"format": "nomad estimate 1", "world", "walls", "body", "clock_s", "encoders": [x_in, y_in, steering_rad],
     "turret_rad", "mean": [n numbers], "cov": [n rows of n numbers]}

Rules: the only file here that touches the disk; a file is whole, or it is the old one. Whatever is wrong is an
EstimateFileError that names the file and the key.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from math import cos, hypot, pi, sin
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np

from localization.filters.belief import HEADING, POSE, Belief, Floats, add, difference
from localization.filters.odometry import MAX_STATE, OdometryNoise
from localization.live.sensor_input import EncoderPose
from nclient.common.files import read_text, write_atomic
from nclient.errors import EstimateFileError
from worlds.world import World

ROUNDABOUT: Final = 3.0
"""How much longer than straight a way may have been that nobody saw."""
UNSEEN_TURN_RAD: Final = pi
"""And how much more it may have turned than the encoders' difference."""
FARTHEST_IN: Final = 60.0
"""A robot that was driven farther than this without the filter is to be found anew."""
TOP_SPEED_IN_S: Final = 40.0
"""No robot of these drives faster: encoders that say so were set."""
STANDS_IN: Final = 0.15
STANDS_RAD: Final = 0.003
"""Encoders tell tenths of an inch and of a degree; within this they are as they were."""
_SLACK_IN: Final = 1.0
_SAID: Final = "say how far it may have been moved (--moved-std X,Y,HEADING; 0,0,0: it stood), or leave --resume out"

Moved = tuple[float, float, float]
"""Standard deviations in inches, inches, radians."""


class MapSignature(NamedTuple):
    """What a belief is about: a map by its name and a digest of its walls, and a robot's body by its name."""

    world: str
    walls: str
    body: str


@dataclass(frozen=True, slots=True)
class Kept:
    """A belief over states (n,) about a site, and the encoders at the clock it is of."""

    site: MapSignature
    encoders: EncoderPose
    belief: Belief


def map_signature(world: World, body: str) -> MapSignature:
    """The site of a map and a body. Walls count as the same within a millionth of an inch, in whatever order."""
    ends = np.round(world.walls.reshape(-1, 2, 2), 6) + 0.0
    walls = sorted(sorted(wall) for wall in ends.tolist())
    return MapSignature(world.name, sha256(repr(walls).encode()).hexdigest()[:16], body)


def resume_belief(
    kept: Kept, site: MapSignature, now: EncoderPose, noise: OdometryNoise, moved_std: Moved | None = None
) -> Belief:
    """The belief now, of a robot whose encoders say `now`. `moved_std`: how far it may have been moved besides.

    Raises EstimateFileError where nothing can be said.
    """
    _same_site(kept.site, site)
    if moved_std is None:
        _same_counting(kept.encoders, now)
        return _driven_on(kept, now, noise)
    belief = _driven_on(kept, now, noise) if _counted_on(kept.encoders, now) else kept.belief
    cov = belief.cov.copy()
    cov[:POSE, :POSE] += np.diag(np.square(moved_std))
    return Belief(belief.mean, cov)


def _same_site(kept: MapSignature, here: MapSignature) -> None:
    if kept.walls != here.walls:
        raise EstimateFileError(
            f"the estimate is of the map {kept.world!r}, whose walls are not those of {here.world!r}: "
            f"take --map {kept.world} as it was then, or leave --resume out"
        )
    if kept.body != here.body:
        raise EstimateFileError(
            f"the estimate is of a {kept.body}, not of a {here.body}: take --body {kept.body}, or leave --resume out"
        )


def _same_counting(kept: EncoderPose, now: EncoderPose) -> None:
    """Raises EstimateFileError where the encoders have not counted on from where they were."""
    if now.clock_s < kept.clock_s:
        raise EstimateFileError(
            f"the robot's clock went back, from {kept.clock_s:.1f} to {now.clock_s:.1f} s: it was switched off and on, "
            f"and its encoders tell nothing of that time; {_SAID}"
        )
    if not _counted_on(kept, now):
        x, y, _ = now.pose
        raise EstimateFileError(
            f"the encoders were set meanwhile: they say ({x:.1f}, {y:.1f}) in, and said "
            f"({kept.pose[0]:.1f}, {kept.pose[1]:.1f}) when the estimate was saved; {_SAID}"
        )
    way = _way_in(kept, now)
    if way > FARTHEST_IN:
        raise EstimateFileError(
            f"the robot was driven {way:.0f} in away while no filter ran; beyond {FARTHEST_IN:.0f} in the estimate is "
            "worth nothing: leave --resume out"
        )


def _counted_on(kept: EncoderPose, now: EncoderPose) -> bool:
    """Whether the encoders may have come to where they are by driving."""
    passed_s = now.clock_s - kept.clock_s
    zeroed = not now.pose.any() and not _stood(kept, now)
    return passed_s >= 0.0 and not zeroed and _way_in(kept, now) <= TOP_SPEED_IN_S * passed_s + _SLACK_IN


def _driven_on(kept: Kept, now: EncoderPose, noise: OdometryNoise) -> Belief:
    """The belief moved as the encoders were, by a way that is unknown: in the frame of the pose it began at,

    P' = F P F' + Q, Q without direction: heading by turns and way, position by the way and, along its length, by that
    heading.
    """
    belief = kept.belief
    if _stood(kept.encoders, now):
        return belief
    change = difference(now.pose, kept.encoders.pose)
    apart = float(belief.mean[HEADING] - kept.encoders.pose[HEADING])
    dx = cos(apart) * change[0] - sin(apart) * change[1]
    dy = sin(apart) * change[0] + cos(apart) * change[1]
    by_state = np.eye(len(belief.mean))
    by_state[0, HEADING], by_state[1, HEADING] = -dy, dx
    cov = by_state @ belief.cov @ by_state.T
    cov[:POSE, :POSE] += np.diag(_unseen_variance(hypot(dx, dy), abs(float(change[HEADING])), noise))
    mean = belief.mean.copy()
    mean[:POSE] = add(belief.mean[:POSE], np.array([dx, dy, change[HEADING]]))
    return Belief(mean, cov)


def _unseen_variance(straight_in: float, turned_rad: float, noise: OdometryNoise) -> Floats:
    """Variances (3,) that a way has left which came to so much: longer and more winding than that."""
    way, turn = ROUNDABOUT * straight_in, ROUNDABOUT * turned_rad + UNSEEN_TURN_RAD
    heading = noise.rotation_std**2 * turn + noise.drift_std**2 * way
    place = noise.translation_std**2 * way + heading * way * way
    return np.array([place, place, heading])


def _stood(kept: EncoderPose, now: EncoderPose) -> bool:
    turned = abs(float(difference(now.pose, kept.pose)[HEADING]))
    return _way_in(kept, now) <= STANDS_IN and turned <= STANDS_RAD


def _way_in(kept: EncoderPose, now: EncoderPose) -> float:
    return hypot(*(now.pose - kept.pose)[:HEADING])


FORMAT: Final = "nomad estimate 1"
KEYS: Final = ("format", "world", "walls", "body", "clock_s", "encoders", "turret_rad", "mean", "cov")
MOST_BYTES: Final = 1 << 16
"""Twenty times the largest state's; a longer file is something else."""
FARTHEST: Final = 1e12
"""No second, inch or radian of a run, and no square of one, is farther from 0."""
SMALLEST_EIGENVALUE: Final = -1e-9
"""Rounding may leave a covariance that is zero somewhere a little below it."""


def save(path: Path, kept: Kept) -> None:
    """Write it. Raises EstimateFileError where that cannot be."""
    values = {
        "format": FORMAT,
        **kept.site._asdict(),
        "clock_s": kept.encoders.clock_s,
        "encoders": kept.encoders.pose.tolist(),
        "turret_rad": kept.encoders.turret_rad,
        "mean": kept.belief.mean.tolist(),
        "cov": kept.belief.cov.tolist(),
    }
    write_atomic(path, json.dumps(values, indent=1) + "\n", EstimateFileError)


def load(path: Path) -> Kept:
    """Read it. Raises EstimateFileError for whatever is no such file."""
    text = read_text(path, MOST_BYTES, EstimateFileError)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise EstimateFileError(f"{path}: is no JSON: {error}") from error
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        _fail(path, "format", f"expected {FORMAT!r}: a file that `nomad localize --save` wrote")
    for key in {*KEYS} ^ {*values}:
        _fail(path, key, "is missing" if key in KEYS else "unknown key")
    site = MapSignature(*(_text(path, key, values[key]) for key in MapSignature._fields))
    clock_s, turret_rad = _numbers(path, "clock_s", values, ()), _numbers(path, "turret_rad", values, ())
    encoders = EncoderPose.of(float(clock_s), _numbers(path, "encoders", values, (POSE,)), float(turret_rad))
    return Kept(site, encoders, _belief(path, values))


def _belief(path: Path, values: dict[str, Any]) -> Belief:
    size = len(values["mean"]) if isinstance(values["mean"], list) else 0
    if not POSE <= size <= MAX_STATE:
        _fail(path, "mean", f"expected {POSE} to {MAX_STATE} numbers")
    mean, cov = _numbers(path, "mean", values, (size,)), _numbers(path, "cov", values, (size, size))
    if not np.allclose(cov, cov.T) or np.linalg.eigvalsh(cov)[0] < SMALLEST_EIGENVALUE:
        _fail(path, "cov", "is no covariance: expected it symmetric, and no variance below 0")
    return Belief(mean, 0.5 * (cov + cov.T))


def _numbers(path: Path, key: str, values: dict[str, Any], shape: tuple[int, ...]) -> Floats:
    wanted = " by ".join(map(str, shape)) + " numbers" if shape else "a number"
    try:
        found = np.array(values[key], dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        _fail(path, key, f"expected {wanted}")
    if found.shape != shape or not all(abs(number) <= FARTHEST for number in found.ravel().tolist()):
        _fail(path, key, f"expected {wanted}, none beyond {FARTHEST:g}")
    return found


def _text(path: Path, key: str, value: object) -> str:
    if not isinstance(value, str):
        _fail(path, key, "expected a text")
    return value


def _fail(path: Path, key: str, complaint: str) -> NoReturn:
    raise EstimateFileError(f"{path}: {key}: {complaint}")
