"""The contents of a robot's window by layer, as plain data (numbers, texts, lists, dictionaries).

Name and value of each layer:

    actual_trace, encoder_trace     [[x, y] ...] in inches, the oldest first
    bumper                          the bits of State[33]
    infrared, sonar                 16 readings each, empty without the sensor
    laser                           [[x, y] ...] in inches, in the robot's frame, empty without a laser
    client_graphics                 [{"figure", "numbers" (tenths, as drawn), "colour", "xor"} ...]
"""

from __future__ import annotations

from typing import Any

from nserver_emu.server.graphics import Graphics, Layer, Trace, Traces
from nserver_emu.simulation.laser import points
from nserver_emu.simulation.robot import SimulatedRobot


def layers(robot_id: int, robot: SimulatedRobot, traces: Traces, graphics: Graphics) -> dict[str, Any]:
    """Return each layer by its name, as of now."""
    # All columns, independent of any connection's settings.
    laser_points = points(robot.scan_laser(), robot.model.body).tolist() if robot.model.has_light_sensors else []
    return {
        Layer.ACTUAL_TRACE.value: _track(traces.actual.get(robot_id)),
        Layer.ENCODER_TRACE.value: _track(traces.encoder.get(robot_id)),
        Layer.BUMPER.value: robot.bumpers,
        Layer.INFRARED.value: [] if robot.infrared is None else list(robot.infrared.readings),
        Layer.SONAR.value: list(robot.sonar.readings_in),
        Layer.LASER.value: laser_points,
        Layer.CLIENT.value: [
            {"figure": shape.figure.value, "numbers": list(shape.numbers), "colour": shape.colour, "xor": shape.xor}
            for shape in graphics.shapes
        ],
    }


def _track(trace: Trace | None) -> list[list[float]]:
    return [] if trace is None else [list(point) for point in trace.points]
