"""Sonars that stand anywhere on the robot: expected ranges by the ray caster, derivatives by finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig, sonar_of
from localization.filters.belief import Floats, independent, unpack
from localization.filters.ekf import KalmanFilter
from localization.filters.odometry import OdometryNoise
from localization.filters.particles import ConeLikelihood, RayLikelihood
from localization.filters.registry import make, update_for
from localization.filters.sonar_cone import ConeModel, ConeSonar, EchoCandidate, arm_of, cone_sonar, first_echoes
from localization.filters.sonar_ray import STRICT, WIRE_SONAR, predict_beam, ranges_along, ray_sonar, wall_map
from worlds.compiled import VARIABLE
from worlds.raycast import cast_ray
from worlds.rings import Ring, SonarMount
from worlds.robots import N150, Body

ROOM = np.array([[-90.0, -60.0, 90.0, -60.0], [90.0, -60.0, 90.0, 60.0], [90.0, 60.0, -90.0, 60.0],
                 [-90.0, 60.0, -90.0, -60.0]])  # fmt: skip
POSE = np.array([12.0, -7.0, 0.4])
P = np.diag([0.1, 0.1, 0.01]) ** 2
MOUNTS = [(8.0, 5.0, 0.3), (-4.0, -6.0, 3.0), (6.0, -6.5, -1.4)]


def ring_of(mounts: list[tuple[float, float, float]]) -> Ring:
    """Return the ring of sonars at x, y that look in a direction."""
    shifts = tuple(
        (x * np.cos(a) + y * np.sin(a) - 2.0, y * np.cos(a) - x * np.sin(a)) for x, y, a in mounts
    )
    firing = tuple((sonar,) for sonar in range(len(mounts)))
    return replace(N150.ring, radius_in=2.0, angles_rad=tuple(a for *_, a in mounts), shifts_in=shifts, firing=firing)


BODY = replace(N150, ring=ring_of(MOUNTS))


def face(pose: Floats, x: float, y: float) -> Floats:
    """Return where a point of the robot is in the map."""
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    return np.array([pose[0] + cosine * x - sine * y, pose[1] + sine * x + cosine * y])


def range_of(pose: Floats, mount: tuple[float, float, float]) -> float:
    """Return the range from a sonar to the room by the ray caster alone."""
    x, y, angle = mount
    from_x, from_y = face(pose, x, y).tolist()
    return cast_ray(from_x, from_y, np.cos(pose[2] + angle), np.sin(pose[2] + angle), ROOM)[0]


@pytest.mark.parametrize("sonar", range(3))
def test_a_beam_starts_where_its_sonar_is_mounted(sonar: int) -> None:
    mount = BODY.ring.mounts[sonar]
    beam = predict_beam(POSE.tolist(), P.tolist(), mount.direction_rad, mount.ring_in, wall_map(ROOM), STRICT,
                        mount.left_in)  # fmt: skip
    assert beam.range_in == pytest.approx(range_of(POSE, MOUNTS[sonar]))
    step = 1e-6
    by_hand = [
        (range_of(POSE + step * axis, MOUNTS[sonar]) - range_of(POSE - step * axis, MOUNTS[sonar])) / (2.0 * step)
        for axis in np.eye(3)
    ]
    assert pytest.approx(by_hand, abs=1e-6) == beam.H
    many = ranges_along(POSE[None], mount._replace(direction_rad=np.array([mount.direction_rad])), wall_map(ROOM))
    assert many.range_in[0, 0] == pytest.approx(beam.range_in)


@pytest.mark.parametrize("sonar", range(3))
def test_a_cone_has_its_face_there(sonar: int) -> None:
    # One wall in front of each sonar, 40 in from its face: the echo is its perpendicular distance.
    x, y, angle = MOUNTS[sonar]
    direction = POSE[2] + angle
    ahead = np.array([np.cos(direction), np.sin(direction)])
    middle = face(POSE, x, y) + 40.0 * ahead
    across = 30.0 * np.array([-ahead[1], ahead[0]])
    model = ConeModel([[*(middle - across), *(middle + across)]], BODY, ConeSonar())

    def echo_at(pose: Floats) -> EchoCandidate:
        x_in, y_in, heading = pose.tolist()
        return first_echoes(x_in, y_in, heading, 0.01, BODY.ring.mounts[sonar], model)[0]

    first = echo_at(POSE)
    assert first.range_in == pytest.approx(40.0)
    step = 1e-6
    by_hand = [
        (echo_at(POSE + step * axis).range_in - echo_at(POSE - step * axis).range_in) / (2.0 * step)
        for axis in np.eye(3)
    ]
    assert pytest.approx(by_hand, abs=1e-6) == first.H


def test_the_arm_of_a_mount_leads_to_the_sonar() -> None:
    for (x, y, angle), mount in zip(MOUNTS, BODY.ring.mounts, strict=True):
        assert arm_of(mount, np.cos(angle), np.sin(angle)) == pytest.approx((x, y))


@pytest.mark.parametrize("rays", [True, False])
def test_particles_expect_mounted_sonars(rays: bool) -> None:
    exact = RayLikelihood(ROOM, BODY, WIRE_SONAR)
    likelihood = exact if rays else ConeLikelihood(ROOM, BODY, ConeSonar(outlier_probability=0.0))
    # Square to a wall, the sonar 2 looks at it: the most likely reading is the range from its mount.
    pose = np.array([0.0, 0.0, 1.4 - np.pi / 2])
    expected = range_of(pose, MOUNTS[2])
    readings = np.arange(expected - 6.0, expected + 6.01, 0.5)
    values = [likelihood.at(pose[None], 2, 0.0, float(reading)).total[0] for reading in readings]
    assert readings[int(np.argmax(values))] == pytest.approx(expected, abs=0.26)


@pytest.mark.parametrize("method", ["ekf", "iekf", "ukf", "smoother", "mcl", "offsets"])
@pytest.mark.parametrize("rays", [True, False])
def test_every_method_corrects_by_mounted_sonars(method: str, rays: bool) -> None:
    # 24 sonars in pairs beside one another; the belief is 1 in and 0.02 rad off.
    mounts = [(7.0 * np.cos(a) - 2.0 * np.sin(a), 7.0 * np.sin(a) + 2.0 * np.cos(a), a)
              for a in np.arange(24) * (np.pi / 12.0)]  # fmt: skip
    body = replace(N150, ring=replace(ring_of(mounts), resolution_in=0.01))
    sonar_noise = replace(sonar_of(body.ring, rays=rays), range_std_relative=0.01)
    config = LocalizationConfig(ROOM, body, OdometryNoise(), sonar_noise)
    truth = np.array([5.0, 3.0, 0.0])
    filter_ = make(method, config, independent(truth + np.array([0.7, -0.7, 0.02]), (0.7, 0.7, 0.02)), seed=3)
    for sonar, mount in enumerate(mounts):
        # Only sonars that look squarely at a wall: rays and cones agree there.
        if sonar % 6 == 0:
            for _ in range(3):
                filter_.predict(0.0, 0.0)
                filter_.update(sonar, 0.0, range_of(truth, mount))
    # The particle filter widens its likelihood by 0.5 in.
    largest_in = float(np.abs(filter_.belief.mean[:2] - truth[:2]).max())
    assert largest_in < (0.5 if method == "mcl" else 0.25)


@pytest.fixture
def numba(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    monkeypatch.setenv(VARIABLE, "always")


@pytest.mark.long
@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("rays", [True, False])
def test_compiled_code_has_the_same_mounts(monkeypatch: pytest.MonkeyPatch, rays: bool) -> None:
    sonar = sonar_of(BODY.ring, rays=rays)
    belief = independent(POSE + np.array([0.3, -0.2, 0.01]), (0.5, 0.5, 0.02))
    echoes = [(0.1 * (1 + k), k, round(range_of(POSE, mount))) for k, mount in enumerate(MOUNTS)]
    encoders = (0.0, 0.0, 0.0, 0.0, 0.0)
    poses = [encoders, (1.0, 0.0, 0.0, 0.0, 0.0)]
    fast = KalmanFilter(belief, update_for(ROOM, BODY, sonar), OdometryNoise())
    monkeypatch.setenv(VARIABLE, "never")
    plain = KalmanFilter(belief, update_for(ROOM, BODY, sonar), OdometryNoise())
    assert fast._compiled
    assert not plain._compiled
    one, other = plain.process(encoders, poses, echoes), fast.process(encoders, poses, echoes)
    assert np.array(one) == pytest.approx(np.array(other), rel=1e-9, nan_ok=True)
    assert unpack(fast.belief)[0] == pytest.approx(unpack(plain.belief)[0], rel=1e-9)


def test_noise_is_that_of_the_ring() -> None:
    ring = replace(N150.ring, min_range_in=4.0, max_range_in=200.0, resolution_in=0.3, half_cone_rad=0.2)
    rays, cones = ray_sonar(ring), cone_sonar(ring)
    for sonar in (rays, cones):
        assert (sonar.lowest_in, sonar.highest_in, sonar.range_span_in) == (4.0, 200.0, 196.0)
        assert sonar.rounding_var_in2 == pytest.approx(0.3**2 / 12.0)
    assert cones.cone_rad == pytest.approx(0.4)
    # A Nomad's are the defaults, to the bit.
    assert ray_sonar(N150.ring) == WIRE_SONAR
    assert cone_sonar(N150.ring) == ConeSonar()
    assert isinstance(BODY, Body)
    forwards_in, left_in = BODY.ring.shifts_in[0]
    assert BODY.ring.mounts[0] == SonarMount(0.3, 2.0 + forwards_in, left_in)
