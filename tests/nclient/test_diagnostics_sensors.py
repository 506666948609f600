"""Diagnostics find each fault of a sensor, and none in a healthy robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from random import Random

import pytest

from nclient.cli import doctor
from nclient.cli.doctor import Finding, Grade, worst
from nclient.protocol.types import N150, N200, SCOUT, Model
from nclient.state import RobotState


def state(slots: Mapping[int, int] | None = None, model: Model = N150, clock_ms: int | None = 0,
          raw_volts: tuple[int, int] | None = (255, 255)) -> RobotState:
    """A state; slots that are not given as a robot at rest has them, which sees walls at 50 in."""
    raw = [0] * 17 + [50] * 16 + [model.bumper_rest] + [0] * 11
    for slot, value in (slots or {}).items():
        raw[slot] = value
    return RobotState(model, tuple(raw), clock_ms=clock_ms, raw_volts=raw_volts)


def rings(columns: Sequence[Sequence[int]], count: int = 20) -> list[RobotState]:
    """States whose sonar k reads columns[k], round and round."""
    return [state({17 + k: column[n % len(column)] for k, column in enumerate(columns)}) for n in range(count)]


def noisy(seed: int = 1) -> list[list[int]]:
    rng = Random(seed)
    # A noise of 1 percent: 20 readings of walls from 20 to 170 in.
    return [[round(far * (1 + rng.gauss(0, 0.01))) for _ in range(20)] for far in range(20, 180, 10)]


def grades(findings: list[Finding]) -> list[tuple[str, str]]:
    return [(finding.grade.name, finding.what) for finding in findings]


@pytest.mark.parametrize("seed", range(20))
def test_a_noisy_ring_is_healthy(seed: int) -> None:
    assert grades(doctor.sonars(rings(noisy(seed)))) == [("OK", "sonars")]


def test_a_ring_without_noise_is_healthy() -> None:
    # One sonar without an echo between neighbours that have one is suspicious; three in a row may be an open door.
    assert grades(doctor.sonars(rings([[30]] * 15 + [[255]]))) == [("WARN", "sonars")]
    assert grades(doctor.sonars(rings([[30]] * 13 + [[255]] * 3))) == [("OK", "sonars")]
    assert "13 of 16" in doctor.sonars(rings([[30]] * 13 + [[255]] * 3))[0].seen


def test_dead_sonars() -> None:
    columns = noisy()
    # Sonar 3 reads 0, which no working sonar does; sonar 9 has no echo between two neighbours that have one.
    columns[3], columns[9] = [0], [255]
    findings = doctor.sonars(rings(columns))
    assert grades(findings) == [("FAIL", "sonar 3"), ("WARN", "sonars")]
    assert "no echo while both neighbours have some: 9" in findings[1].seen
    assert grades(doctor.sonars(rings([[255]] * 16))) == [("WARN", "sonars")]


def test_silence_beside_a_corner_is_healthy() -> None:
    columns = [[40]] * 16
    columns[5], columns[6] = [255], [60]
    assert grades(doctor.sonars(rings(columns))) == [("OK", "sonars")], "two walls: 40 and 60 in"
    columns[6] = [48]
    assert grades(doctor.sonars(rings(columns))) == [("WARN", "sonars")], "one wall: 40 and 48 in"


def test_a_stuck_sonar_is_steadier_than_nearer_ones() -> None:
    columns = noisy()
    # 170 in with 1 percent of noise varies by inches: a constant 170 is suspicious.
    columns[15] = [170]
    assert grades(doctor.sonars(rings(columns))) == [("WARN", "sonar 15")]
    assert grades(doctor.sonars(rings(columns, count=9))) == [("OK", "sonars")], "too few states"
    # At 20 in the noise is 0.2 in, less than the resolution of an inch.
    columns[15] = [20]
    assert grades(doctor.sonars(rings(columns))) == [("OK", "sonars")], "near ones are steady by nature"
    columns = [[30]] * 16
    # Readings that change by one inch show rounding, and no noise.
    columns[1], columns[2], columns[3], columns[4] = [40, 41], [40, 41], [40, 41], [100]
    assert grades(doctor.sonars(rings(columns))) == [("OK", "sonars")], "by one, rounding flickers"
    # Readings that change by two inches show noise, so that each constant one is suspicious.
    columns[1], columns[2], columns[3] = [20, 22], [20, 22], [20, 22]
    assert len(doctor.sonars(rings(columns))) == 13


def test_infrareds() -> None:
    def states(*columns: Sequence[int]) -> list[RobotState]:
        return [state({1 + k: column[n % len(column)] for k, column in enumerate(columns)}, N200) for n in range(12)]

    changing = [[3, 5], [4, 6], [2, 7]]
    assert grades(doctor.infrareds(states(*changing, *[[15]] * 13))) == [("OK", "infrareds")]
    # A constant reading of 9 is suspicious; 15 is "nothing in range".
    assert grades(doctor.infrareds(states(*changing, [9], *[[15]] * 12))) == [("WARN", "infrared 3")]
    assert grades(doctor.infrareds(states(*[[0]] * 16))) == [("FAIL", "infrareds")]


@pytest.mark.parametrize(("bits", "grade", "text"), [
    # Bit 3 in both states; bit 19 in one of them.
    ([0, 0], "OK", "none"), ([8, 8 + 1], "FAIL", "all the time: 3"), ([0, 1 << 19], "WARN", "now and then: 19"),
])
@pytest.mark.parametrize("model", [N150, SCOUT])
def test_bumpers(model: Model, bits: list[int], grade: str, text: str) -> None:
    found = doctor.bumpers([state({33: model.bumper_rest | each}, model) for each in bits])
    assert (found.grade.name, text in found.seen) == (grade, True)


@pytest.mark.parametrize(("raw", "grade", "seen"), [
    # The raw byte r is (2 + 3 r / 255) x 12 / 5 V: 224 is 11.12 V, 201 is 10.48 V.
    (255, "OK", "12.00 V"), (224, "OK", "11.12 V"), (223, "WARN", "11.10 V: low"), (202, "WARN", "10.50 V: low"),
    (201, "FAIL", "10.48 V: empty"), (0, "FAIL", "4.80 V: empty"),
])
def test_batteries_by_the_formula(raw: int, grade: str, seen: str) -> None:
    computer, motors = doctor.batteries(state(raw_volts=(raw, 255)))
    assert (computer.what, computer.grade.name, computer.seen) == ("computer", grade, seen)
    assert (motors.what, motors.seen) == ("motors", "12.85 V")
    assert grades(doctor.batteries(state(raw_volts=None))) == [("WARN", "battery")]


@pytest.mark.parametrize(("times", "grade", "text"), [
    # A clock of 32 bits that starts again at 0 goes on.
    ([0, 100, 200], "OK", "went forward 0.2 s"), ([2**32 - 50, 50], "OK", "went forward 0.1 s"),
    ([500, 400, 900], "FAIL", "went back 1 times, by 0.1 s"), ([7, 7], "WARN", "stands still"),
    ([None, 7], "WARN", "never received"),
])
def test_the_clock(times: list[int | None], grade: str, text: str) -> None:
    found = doctor.clock([state(clock_ms=each) for each in times], 0.1)
    assert (found.grade.name, text in found.seen) == (grade, True)


def test_the_rate_of_the_clock() -> None:
    found = doctor.clock([state(clock_ms=0), state(clock_ms=3000)], 2.0)
    assert found.seen == "went forward 3.0 s, 1.50 s a second"


def test_a_moving_robot_is_reported() -> None:
    assert doctor.motion([state(), state()]).grade is Grade.OK
    # A motor bit, and a velocity without one.
    for moved in (state({41: 2}), state({39: -1})):
        assert doctor.motion([state(), moved]).grade is Grade.WARN


def test_findings_are_printed_as_lines() -> None:
    found = Finding(Grade.FAIL, "sonar 3", "reads 0", "mend it")
    assert str(found) == "FAIL  sonar 3      reads 0; mend it"
    assert str(Finding(Grade.OK, "clock", "goes")) == "OK    clock        goes"
    assert worst([found, Finding(Grade.WARN, "a", "b")]) is Grade.FAIL
    assert worst([]) is Grade.OK
