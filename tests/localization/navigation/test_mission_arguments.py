"""Arguments of verbs: refusals that name the keys of step lists."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from localization.navigation.mission import Mission
from localization.navigation.pilot import check_arguments, read_points
from nclient.errors import MissionFileError


@pytest.mark.parametrize(
    ("verb", "expected"),
    [
        (lambda robot: robot.go_to("15", 5), "go_to: x_in: expected a length, a number, found the text '15'"),
        (lambda robot: robot.go_to(1, nan), "go_to: y_in: expected a length, a finite number, found nan"),
        (lambda robot: robot.go_to(1, 2, inf),
         "go_to: heading_deg: expected an angle in degrees, a finite number, found inf"),
        (lambda robot: robot.go_to(1, 2, within_in=0), "go_to: within_in: expected 0.1 to 100, found 0"),
        (lambda robot: robot.go_to(1, 2, limit_s=-1), "go_to: limit_s: expected 0 to 86400, found -1"),
        (lambda robot: robot.go_to(1, 2, limit_s=nan),
         "go_to: limit_s: expected 0 to 86400, a finite number, found nan"),
        (lambda robot: robot.go_to(500, 5, retries=-1),
         "go_to: retries: expected a whole number from 0 to 100, found -1"),
        (lambda robot: robot.go_to(500, 5, retries=1.5),
         "go_to: retries: expected a whole number from 0 to 100, found 1.5"),
        (lambda robot: robot.follow([(15, 5), (nan, 20)]),
         "follow: points_in[1][0]: expected a length, a finite number, found nan"),
        (lambda robot: robot.follow([]), "follow: points_in: expected at least 1 points, found 0"),
        (lambda robot: robot.follow(3), "follow: points_in: expected a list of points [[x, y], ...], found 3"),
        (lambda robot: robot.follow([(1, 2)], retries=-1),
         "follow: retries: expected a whole number from 0 to 100, found -1"),
        (lambda robot: robot.turn(nan), "turn: heading_deg: expected an angle in degrees, a finite number, found nan"),
        (lambda robot: robot.turn(by_deg=nan), "turn: by_deg: expected -3600 to 3600, a finite number, found nan"),
        (lambda robot: robot.turn(by_deg=-3601), "turn: by_deg: expected -3600 to 3600, found -3601"),
        (lambda robot: robot.turn(), "turn: expected heading_deg or by_deg, one of them"),
        (lambda robot: robot.turn(3, by_deg=3), "turn: expected heading_deg or by_deg, one of them"),
        (lambda robot: robot.look(nan), "look: seconds: expected 0 to 86400, a finite number, found nan"),
        (lambda robot: robot.look(-1), "look: seconds: expected 0 to 86400, found -1"),
        (lambda robot: robot.wait_for(True, 3), "wait_for: condition: expected a function of what is seen, found true"),
        (lambda robot: robot.wait_for(bool, None), "wait_for: limit_s: expected 0 to 86400, a number, found None"),
        (lambda robot: robot.wait_for(bool, 3, 4), "wait_for: words: expected a text, found 4"),
        (lambda robot: robot.patrol([(1, 2)], rounds=-1),
         "patrol: rounds: expected a whole number from 1 to 10000, found -1"),
        (lambda robot: robot.patrol([(1, 2)], rounds=0),
         "patrol: rounds: expected a whole number from 1 to 10000, found 0"),
        (lambda robot: robot.patrol([(1, 2, 3)]),
         "patrol: points_in[0]: expected a point [x, y], found the list [1, 2, 3]"),
        (lambda robot: robot.dock(1, 2, None), "dock: heading_deg: expected an angle in degrees, a number, found None"),
        (lambda robot: robot.dock(1, 2, nan),
         "dock: heading_deg: expected an angle in degrees, a finite number, found nan"),
        (lambda robot: robot.dock(1e9, 2, 0),
         "dock: x_in: expected -100000 to 100000, found 1000000000.0; is the unit right?"),
    ],
)  # fmt: skip
def test_invalid_argument_is_refused_before_any_motion(verb: Callable[[Any], object], expected: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        verb(object.__new__(Mission))
    assert str(refused.value) == expected


def test_none_and_numpy_numbers_are_accepted() -> None:
    check_arguments("go_to", x_in=np.float64(1), y_in=np.int64(2), heading_deg=None, limit_s=inf, retries=np.int32(0))
    check_arguments("turn", heading_deg=None, by_deg=np.float32(3600))


@pytest.mark.parametrize(
    "given",
    [[(1, 2), (3, 4)], ((1.0, 2.0), [3.0, 4.0]), np.array([[1, 2], [3, 4]]), {"a": (1, 2), "b": (3, 4)}.values()],
)
def test_points_may_be_any_sequence(given: object) -> None:
    assert read_points("follow", given) == ((1.0, 2.0), (3.0, 4.0))
