"""Traces of robots, of bounded size."""

from __future__ import annotations

import tracemalloc
from math import cos, hypot, sin

import pytest

from nserver_emu.control.snapshot import dumps, loads
from nserver_emu.server.graphics import MAX_POINTS, POINT_SPACING_IN, REMOVED_TOGETHER, Trace
from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import meet, simulation


def tracks(emulator: Emulator, robot_id: int) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    found = (traces.get(robot_id) for traces in (emulator.traces.actual, emulator.traces.encoder))
    actual, encoder = ([] if trace is None else trace.points for trace in found)
    return actual, encoder


def test_a_trace_has_half_inch_points_and_drops_the_oldest() -> None:
    trace = Trace()
    for number in range(20 * MAX_POINTS):
        trace.add(0.1 * number, 0.0)
    assert len(trace.points) == MAX_POINTS
    gaps = [after[0] - before[0] for before, after in zip(trace.points[:-1], trace.points[1:], strict=True)]
    assert min(gaps) >= POINT_SPACING_IN
    assert max(gaps) < POINT_SPACING_IN + 0.11
    assert trace.points[-1][0] > 0.1 * 20 * MAX_POINTS - 1.0


def test_a_full_track_takes_little_memory() -> None:
    tracemalloc.start()
    try:
        trace = Trace()
        for number in range(MAX_POINTS + REMOVED_TOGETHER - 1):
            trace.add(float(number), 0.5)
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert trace.points == trace.at(range(trace.first, trace.count + 1))
    assert trace.points[-1] == (float(number), 0.5)
    assert taken < 20 * (MAX_POINTS + REMOVED_TOGETHER), "two coordinates of eight bytes, and room to grow"


def test_actual_and_encoder_traces_differ_by_dp_and_noise() -> None:
    emulator = Emulator(simulation(noisy=True, seed=3))
    client, _ = meet(emulator)
    client.ask("dp", 1000, 1000)
    client.ask("vm", 100, 0, 0)
    emulator.pass_time(3.0)
    client.ask("st")
    emulator.pass_time(60.0)
    shown = tracks(emulator, 1)
    actual, believed = shown
    robot = emulator.simulation.robots[1]
    assert actual[0] == (0.0, 0.0)
    assert believed[0] == (0.0, 0.0)
    assert believed[1] == pytest.approx([100.5, 100.0], abs=0.6)
    assert hypot(actual[-1][0] - robot.actual.x_in, actual[-1][1] - robot.actual.y_in) < POINT_SPACING_IN
    assert hypot(believed[-1][0] - robot.encoder.x_in, believed[-1][1] - robot.encoder.y_in) < POINT_SPACING_IN
    assert 20 < len(actual) <= 62
    client.ask("refresh_all")
    assert tracks(emulator, 1) == shown


def test_a_robot_that_is_made_or_restored_has_its_track() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    client.ask("create_robot", 2, 1)
    assert tracks(emulator, 2) == ([], [])
    client.ask("vm", 100, 200, 0)
    emulator.pass_time(2.0)
    restored = Emulator(simulation())
    loads(restored, dumps(emulator))
    assert tracks(restored, 2) == tracks(emulator, 2)
    for each in (emulator, restored):
        each.pass_time(1.0)
    assert tracks(restored, 2) == tracks(emulator, 2)
    track, _ = tracks(emulator, 2)
    assert len(track) > 15


def test_a_trace_marks_placements_and_finds_points_by_number() -> None:
    trace = Trace()
    for number in range(30):
        trace.add(number + (50.0 if number >= 10 else 0.0), 0.0)
    trace.add(0.0, 0.0)
    assert (trace.count, trace.first, trace.jumps) == (31, 1, (11, 31))
    assert trace.at([1, 10, 11, 31]) == [(0.0, 0.0), (9.0, 0.0), (60.0, 0.0), (0.0, 0.0)]
    for number in range(MAX_POINTS - 1):
        trace.add(float(number + 1), 0.0)
    assert (trace.first, trace.jumps) == (31, (11, 31))
    trace.add(0.0, 0.0)
    assert trace.first == 32
    assert trace.jumps == (trace.count,), "those of points that are forgotten are forgotten"
    assert trace.at(range(trace.first, trace.count + 1)) == trace.points


def test_a_track_that_goes_round_and_round_never_jumps() -> None:
    trace = Trace()
    for number in range(1000):
        trace.add(5.0 * cos(number), 5.0 * sin(number))
    assert trace.count == 1000
    assert trace.jumps == ()
