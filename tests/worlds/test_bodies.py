"""The robot models against the table of the robots."""

from __future__ import annotations

from math import degrees

import pytest

from worlds.robots import BODIES, N150, N200, SCOUT, Body


def test_the_bodies_are_found_by_their_names() -> None:
    assert dict(BODIES) == {"n150": N150, "n200": N200, "scout": SCOUT}
    assert [body.name for body in BODIES.values()] == list(BODIES)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_sixteen_sonars_counter_clockwise_from_the_front(body: Body) -> None:
    assert [degrees(angle) for angle in body.sonar_angles_rad] == pytest.approx([22.5 * i for i in range(16)])


@pytest.mark.parametrize(("body", "count"), [(N150, 20), (N200, 20), (SCOUT, 6)], ids=str)
def test_bumpers_around_the_body(body: Body, count: int) -> None:
    assert [degrees(angle) for angle in body.bumper_angles_rad] == pytest.approx(
        [360 / count * i for i in range(count)]
    )


# The data sheets have metres, the models inches.
@pytest.mark.parametrize(("body", "metres"), [(N150, 0.247), (N200, 0.229)], ids=str)
def test_radii_are_the_metres_of_the_data_sheet(body: Body, metres: float) -> None:
    assert body.radius_in * 0.0254 == pytest.approx(metres, abs=5e-4)
    assert body.sonar_ring_radius_in * 0.0254 == pytest.approx(0.23, abs=5e-4)
