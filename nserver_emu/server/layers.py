"""What the window of a robot shows, layer by layer, as plain data for whoever draws or prints it.

    actual_trace, encoder_trace     [[x, y] ...] in inches, the oldest first
    bumper                          the bits of State[33]
    infrared, sonar                 16 readings each; none of a robot without
    laser                           [[x, y] ...] in inches, in the robot's frame, as far as it has a laser
    client_graphics                 [{"figure", "numbers" (tenths, as drawn), "colour", "xor"} ...]

Rules: numbers, texts, lists and dictionaries only, as they are at the moment of asking; asking changes nothing.
"""

from __future__ import annotations

from typing import Any

from nserver_emu.server.graphics import Graphics, Layer, Trace, Traces
from nserver_emu.simulation.laser import points
from nserver_emu.simulation.robot import SimulatedRobot


def layers(robot_id: int, robot: SimulatedRobot, traces: Traces, graphics: Graphics) -> dict[str, Any]:
    """Every layer by its name; see the head of this file."""
    seen = points(robot.scan_laser(), robot.model.body).tolist() if robot.model.has_light_sensors else []
    return {
        Layer.ACTUAL_TRACE.value: _track(traces.actual.get(robot_id)),
        Layer.ENCODER_TRACE.value: _track(traces.encoder.get(robot_id)),
        Layer.BUMPER.value: robot.bumpers,
        Layer.INFRARED.value: [] if robot.infrared is None else list(robot.infrared.readings),
        Layer.SONAR.value: list(robot.sonar.readings_in),
        Layer.LASER.value: seen,
        Layer.CLIENT.value: [
            {"figure": shape.figure.value, "numbers": list(shape.numbers), "colour": shape.colour, "xor": shape.xor}
            for shape in graphics.shapes
        ],
    }


def _track(trace: Trace | None) -> list[list[float]]:
    return [] if trace is None else [list(point) for point in trace.points]
