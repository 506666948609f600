"""Rings of sonars in model files: what they give, what they leave, and how they are refused."""

from __future__ import annotations

from math import cos, hypot, inf, radians, sin
from pathlib import Path

import pytest

from nclient.errors import WorldFileError
from worlds.rings import MAX_SONARS
from worlds.robots import N150, Body, load_bodies, load_calibration

MODELS = Path(__file__).parent / "models"


def body(tmp_path: Path, ring: str, more: str = "") -> Body:
    path = tmp_path / "mine.toml"
    path.write_text(f'[[model]]\nname = "mine"\nlike = "n150"\n{more}\n[model.ring]\n{ring}\n', encoding="utf-8")
    return load_bodies(path)["mine"]


def test_a_model_without_a_ring_has_that_of_its_base(tmp_path: Path) -> None:
    assert body(tmp_path, "").ring == N150.ring
    wide = body(tmp_path, "", "sonar_ring_radius_in = 12").ring
    assert (wide.radius_in, wide.angles_rad, wide.firing) == (12.0, N150.ring.angles_rad, N150.ring.firing)


def test_eight_sonars_of_a_corridor() -> None:
    ring = load_bodies(MODELS / "corridor8.toml")["corridor8"].ring
    assert (ring.count, ring.angles_rad[0], ring.half_cone_rad) == (8, radians(-90.0), radians(15.0))
    assert (ring.firing[0], ring.firing[-1], ring.interval_s) == ((0, 7), (4,), 0.06)
    # Three pairs and two single sonars: five steps of 0.06 s.
    assert ring.round_s == pytest.approx(0.3)
    assert ring.radius_in == pytest.approx(9.055, abs=1e-3)


@pytest.mark.parametrize(
    ("range_in", "reading_in"),
    [(0.0, 15.0), (5.8, 15.0), (39.37, 100.0), (39.5, 100.0), (39.6, 101.0), (196.5, 499.0), (196.8, 511.0),
     (inf, 511.0)],
)
def test_readings_are_rounded_within_the_limits(range_in: float, reading_in: float) -> None:
    # Centimetres, as the sensors of the corridor report them.
    ring = load_bodies(MODELS / "corridor8.toml")["corridor8"].ring
    assert ring.reading(range_in) * 2.54 == pytest.approx(reading_in)


@pytest.mark.parametrize(
    ("range_in", "reading_in"), [(3.0, 6), (6.4, 6), (6.5, 7), (254.4, 254), (254.6, 255), (inf, 255)]
)
def test_a_nomad_reads_whole_inches(range_in: float, reading_in: int) -> None:
    # From 6 in to 255 in, which also means "no echo".
    assert N150.ring.reading(range_in) == reading_in


def test_mounts_are_where_they_were_given(tmp_path: Path) -> None:
    mounts = [(10.0, 4.0), (10.0, -4.0), (-6.0, 0.0)]
    ring = body(tmp_path, f"angles_deg = [0, -30, 180]\nmounts_in = {[list(mount) for mount in mounts]}").ring
    assert [ring.mount_in(sonar) for sonar in range(3)] == [pytest.approx(mount) for mount in mounts]
    # No beam starts in front of its sonar.
    # The third mount is 6 in from the centre along its beam: with a larger radius the beam would start in front of
    # it.
    assert ring.radius_in == pytest.approx(6.0)
    assert all(forwards >= 0.0 for forwards, _ in ring.shifts_in)


def test_mounts_on_a_circle_are_no_shifts(tmp_path: Path) -> None:
    angles = [0.0, 40.0, 200.0]
    mounts = [[23.0 * cos(radians(angle)), 23.0 * sin(radians(angle))] for angle in angles]
    ring = body(tmp_path, f"angles_deg = {angles}\nmounts_cm = {mounts}").ring
    # All mounts lie on a circle in the direction of their angles: a radius says it all.
    assert not ring.shifts_in
    assert ring.radius_in == pytest.approx(23.0 / 2.54)
    assert hypot(*ring.mount_in(1)) == pytest.approx(23.0 / 2.54)


def test_angles_alone_fire_one_after_another(tmp_path: Path) -> None:
    assert body(tmp_path, "angles_deg = [5, 90, 180]").ring.firing == ((0,), (1,), (2,))


@pytest.mark.parametrize(
    ("ring", "expected"),
    [
        ("angles_deg = []", "angles_deg"),
        (f"angles_deg = {[0] * (MAX_SONARS + 1)}", "angles_deg"),
        ("angles_deg = [400]", "angles_deg"),
        ("angles_deg = [0, 90]\nmounts_in = [[1, 2]]", "mounts_in: expected 2 points"),
        ("angles_deg = [0, 90]\nmounts_in = [[1, 2], [900, 0]]", "within 100 in"),
        ("order = [16]", "order"),
        ("order = [[0, 1], 1]", "each once"),
        ("order = [[]]", "order"),
        ("order = []", "order"),
        ("interval_s = 2", "interval_s: expected 0.004 to 1.02"),
        ("min_range_in = 300", "minimum"),
        ("max_range_in = 600", "480"),
        ("max_range_in = 200\nno_echo_in = 100", "no_echo"),
        ("resolution_in = 300", "resolution"),
        ("resolution_in = 0", "resolution"),
        ("max_range_in = 2\nmax_range_m = 2", "exactly one"),
        ("half_cone_deg = 100", "half_cone_deg"),
        ("angels_deg = [1]", "did you mean angles_deg"),
    ],
)
def test_invalid_rings_are_refused_by_name(tmp_path: Path, ring: str, expected: str) -> None:
    with pytest.raises(WorldFileError, match=rf"mine\.toml: model\[0\]\.ring.*{expected}"):
        body(tmp_path, ring)


def test_a_radius_beside_mounts_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldFileError, match=r"sonar_ring_radius_in: .*found both"):
        body(tmp_path, "angles_deg = [0]\nmounts_in = [[1, 2]]", "sonar_ring_radius_in = 9")


def test_an_unknown_base_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[[model]]\nname = "mine"\nlike = "n155"\n', encoding="utf-8")
    with pytest.raises(WorldFileError, match="did you mean n150"):
        load_bodies(path)


def test_offsets_are_as_many_as_sonars(tmp_path: Path) -> None:
    text = (MODELS / "corridor8.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(f"{text}\n[model.sonar]\noffsets_in = {[0.5] * 8}\n", encoding="utf-8")
    found = load_calibration(path, "corridor8")
    assert (found.offsets_in, found.spread.offsets_in) == ((0.5,) * 8, (0.0,) * 8)
    path.write_text(f"{text}\n[model.sonar]\noffsets_in = {[0.5] * 16}\n", encoding="utf-8")
    with pytest.raises(WorldFileError, match=r"sonar\.offsets_in: expected a list of 8 numbers, found 16"):
        load_calibration(path, "corridor8")
    # A model below it has as many.
    twin = '[[model]]\nname = "twin"\nlike = "corridor8"\n[model.odometry]\nway_scale = 1.1\n'
    path.write_text(f"{text}\n{twin}", encoding="utf-8")
    assert load_calibration(path, "twin").offsets_in == (0.0,) * 8
