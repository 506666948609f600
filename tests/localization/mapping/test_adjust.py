"""Adjustment to taped lengths, against closed forms, scipy, and what must not change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from localization.filters.belief import Floats
from localization.mapping.adjust import ALONG_STD_IN, AdjustmentError, TapeLength, adjust_walls
from worlds.world import SurfaceSpot, WallAccuracy, World

ROOM = np.array([[0.0, 0.0, 100.0, 0.0], [100.0, 0.0, 100.0, 80.0], [100.0, 80.0, 0.0, 80.0], [0.0, 80.0, 0.0, 0.0]])
STDS = (0.05, 0.2, 0.04, 0.1)
STIFF_RAD = 1e-9


def room(walls: Floats = ROOM, stds: tuple[float, ...] = STDS, angle_rad: float = STIFF_RAD) -> World:
    """Return walls with these standard deviations."""
    accuracies = {row: WallAccuracy(std_in, angle_rad, 50.0) for row, std_in in enumerate(stds)}
    return World("room", inner_walls=walls, accuracies=accuracies)


def test_walls_share_the_difference_by_their_variances() -> None:
    # The width is the distance of the walls at the left and the right: conditional Gaussian of their two offsets.
    tape_std, length = 0.03, 100.4
    found = adjust_walls(room(), [TapeLength(((1.0, -1.0), (99.0, 1.0)), length, tape_std)])
    variances = np.array([STDS[3] ** 2, STDS[1] ** 2])
    # The two other walls hold the ends along their direction by a little.
    total = variances.sum() + tape_std**2
    left, right = -0.4 * variances[0] / total, 0.4 * variances[1] / total
    np.testing.assert_allclose(found.world.inner_walls[3, [0, 2]], left, atol=2e-3)
    np.testing.assert_allclose(found.world.inner_walls[1, [0, 2]], 100.0 + right, atol=2e-3)
    np.testing.assert_allclose(found.world.inner_walls[[0, 2]][:, [1, 3]], [[0, 0], [80, 80]], atol=1e-6)
    # Variances afterwards are those of a Kalman update.
    after = variances - variances**2 / total
    stds = [found.world.accuracies[row].offset_std_in for row in (3, 1)]
    np.testing.assert_allclose(stds, np.sqrt(after), rtol=5e-3)
    assert found.residuals_in == pytest.approx([-0.4 * tape_std**2 / total], abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_solution_is_that_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array([[0, 0], [90, 5], [110, 70], [40, 95], [-10, 60.0]]) + rng.normal(size=(5, 2))
    walls = np.hstack((corners, np.roll(corners, -1, axis=0)))
    stds, angle_rad = rng.uniform(0.05, 0.5, 5), 0.01
    length, tape_std = float(np.hypot(*(corners[2] - corners[0]))) + 0.3, 0.1
    tape = TapeLength((tuple(corners[0]), tuple(corners[2])), length, tape_std)
    found = adjust_walls(room(walls, tuple(stds.tolist()), angle_rad), [tape])

    def residuals(numbers: Floats) -> Floats:
        x, rows = numbers.reshape(5, 2), []
        for k in range(5):
            a, b = k, (k + 1) % 5
            along = corners[b] - corners[a]
            unit = along / np.hypot(*along)
            normal = np.array([-unit[1], unit[0]])
            da, db = x[a] - corners[a], x[b] - corners[b]
            rows += [normal @ (da + db) / 2.0 / stds[k], normal @ (db - da) / np.hypot(*along) / angle_rad,
                     unit @ da / ALONG_STD_IN, unit @ db / ALONG_STD_IN]  # fmt: skip
        return np.array([*rows, (np.hypot(*(x[2] - x[0])) - length) / tape_std])

    wanted = least_squares(residuals, corners.ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-15).x.reshape(5, 2)
    np.testing.assert_allclose(found.world.inner_walls[:, :2], wanted, atol=1e-6)


def test_corners_and_joints_stay_closed() -> None:
    walls = np.vstack((ROOM, [[60.0, 0.0, 60.0, 50.0]]))
    found = adjust_walls(
        room(walls, (*STDS, 0.3), 0.01), [TapeLength(((0, 0), (60, 0)), 60.5), TapeLength(((0, 0), (0, 80)), 80.2)]
    ).world.inner_walls
    np.testing.assert_array_equal(found[:4, 2:], np.roll(found[:4, :2], -1, axis=0))
    (x1, y1, x2, y2), (x, y, *_) = found[0], found[4]
    assert abs((x2 - x1) * (y - y1) - (y2 - y1) * (x - x1)) / 100.0 < 2e-3
    assert np.hypot(x - x1, y - y1) == pytest.approx(60.5, abs=0.05)


def test_without_contradiction_nothing_moves() -> None:
    found = adjust_walls(room(), [TapeLength(((0, 0), (100, 80)), float(np.hypot(100, 80)))])
    assert found.moved_in < 1e-9
    assert adjust_walls(room(), []).moved_in == 0.0


def test_result_does_not_depend_on_the_frame() -> None:
    c, s = np.cos(0.7), np.sin(0.7)
    turned = ROOM.reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + (30.0, -7.0)
    tapes = [TapeLength(((0, 0), (100, 0)), 100.3)]
    plain = adjust_walls(room(), tapes).world
    ends = turned.reshape(-1, 4)[0]
    tape = replace(tapes[0], ends_in=(tuple(ends[:2]), tuple(ends[2:])))
    other = adjust_walls(room(turned.reshape(-1, 4)), [tape]).world
    back = (other.inner_walls.reshape(-1, 2) - (30.0, -7.0)) @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(back.reshape(-1, 4), plain.inner_walls, atol=1e-6)


@pytest.mark.parametrize(
    ("tape", "words"),
    [(TapeLength(((0, 0), (50, 40)), 60.0), "within"), (TapeLength(((0, 0), (1, 1)), 60.0), "different"),
     (TapeLength(((0, 0), (100, 0)), 0.0), "above 0"), (TapeLength(((0, 0), (100, 0)), 103.0), "contradicts")],
)  # fmt: skip
def test_wrong_lengths_are_refused(tape: TapeLength, words: str) -> None:
    with pytest.raises(AdjustmentError, match=words):
        adjust_walls(room(), [tape])


def test_map_without_walls_is_refused() -> None:
    with pytest.raises(AdjustmentError, match="inner walls"):
        adjust_walls(World("nothing"), [])


def test_walls_without_accuracy_give_way() -> None:
    world = replace(room(), accuracies={3: WallAccuracy(0.05, 0.001, 50.0)})
    found = adjust_walls(world, [TapeLength(((0, 0), (100, 0)), 100.5, 0.01)]).world
    assert found.inner_walls[1, 0] == pytest.approx(100.5, abs=0.03)
    assert list(found.accuracies) == [3]


def test_surface_moves_with_an_adjusted_wall() -> None:
    surface = (SurfaceSpot(101.5, 20.0, 0.2),)
    world = replace(room(), accuracies={1: WallAccuracy(0.5, 0.0, 50.0, surface)})
    found = adjust_walls(world, [TapeLength(((0, 0), (100, 0)), 100.5, 0.01)]).world
    (spot,) = found.accuracies[1].surface
    assert spot.x_in - found.inner_walls[1, 0] == pytest.approx(1.5, abs=0.01)
    assert (spot.y_in, spot.std_in) == pytest.approx((20.0, 0.2), abs=0.1)
