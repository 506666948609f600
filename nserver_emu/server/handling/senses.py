"""Infrareds, compass and laser: their questions and settings, a function a command. The N150 has but the compass,
the Scout none of them.

Rules: as in questions.py; bytes of a setting are taken as the line carries them, and what no robot has is ERROR 2.
"""

from __future__ import annotations

from nclient.protocol.mask import COMPASS_SLOT, Position
from nclient.protocol.replies import Reply
from nclient.protocol.terms import LINES
from nclient.protocol.units import heading_tenths
from nserver_emu.server.conversation.session import BAD_VALUES, NOT_AVAILABLE, Visit, error_reply
from nserver_emu.server.stage.laser_vector import is_on, laser_vector
from nserver_emu.server.stage.stage import Stage
from nserver_emu.server.stage.state_reply import compass_stamps, infrared_stamps, robot_clock_ms, stamp_now
from nserver_emu.simulation.compass import CompassMode
from nserver_emu.simulation.infrared import INFRAREDS

_END_OF_ORDER = 255
_HIGHEST_BYTE = 255
CALIBRATED, NOT_CALIBRATED = (9, 9, 1), (0, 0, 0)
"""Calibration scores."""


def conf_ir(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The infrareds' history in tenths, more than 9 taken as 9, and which of them look."""
    robot, (history, *order) = stage.robot_of(visit), args
    if robot.infrared is None:
        return error_reply(NOT_AVAILABLE)
    end = order.index(_END_OF_ORDER) if _END_OF_ORDER in order else len(order)
    if history < 0 or not all(0 <= number < INFRAREDS for number in order[:end]):
        return error_reply(BAD_VALUES)
    robot.configure_infrareds(history, order[:end])
    return stage.state(visit)


def get_ir(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """All sixteen infrareds, mask or not."""
    robot = stage.robot_of(visit)
    if robot.infrared is None:
        return error_reply(NOT_AVAILABLE)
    stamps = infrared_stamps(robot) if visit.terms.mask.position & Position.INFRARED else {}
    slots = dict(enumerate(robot.infrared.readings, start=1))
    return Reply("infrared", slots, stamps=stamps, clock=robot_clock_ms(robot, stage.simulation.time_s))


def conf_cp(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The compass off, on, or calibrating, which a full turn of the turret completes.

    On the robot's own line the answer is the three scores of the calibration (decision of ours, for no source says
    what they mean: quality and surroundings 0..9, and how many there were, 0 or 1).
    """
    robot = stage.robot_of(visit)
    if robot.compass is None:
        return error_reply(NOT_AVAILABLE)
    if args[0] not in list(CompassMode):
        return error_reply(BAD_VALUES)
    robot.configure_compass(args[0])
    if visit.terms.line:
        return Reply("compass", values=CALIBRATED if robot.compass.calibrated else NOT_CALIBRATED)
    return stage.state(visit)


def get_cp(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The direction of the turret as the compass last told it."""
    robot, now_s = stage.robot_of(visit), stage.simulation.time_s
    if robot.compass is None:
        return error_reply(NOT_AVAILABLE)
    stamps = compass_stamps(robot, now_s) if visit.terms.mask.position & Position.COMPASS else {}
    slots = {COMPASS_SLOT: heading_tenths(robot.compass.direction_rad)}
    return Reply("compass", slots, stamps=stamps, clock=robot_clock_ms(robot, now_s))


def conf_ls(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """How many columns of the laser count (0: all) on this connection; the session has noted the mode.

    Threshold, width and processing tell a camera's picture from its noise; there is no picture here, and no source
    that tells their units: they have no effect.
    """
    if not stage.robot_of(visit).model.sees:
        return error_reply(NOT_AVAILABLE)
    visit.laser_columns = max(0, args[3])
    return stage.state(visit)


def get_ls(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """What the laser sees, in the shape of its mode."""
    return _laser(stage, visit, visit.terms.get_laser_width)


def conf_sg(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """How laser points become lines on this connection: threshold and gap in tenths of an inch, fewest points."""
    if not stage.robot_of(visit).model.sees:
        return error_reply(NOT_AVAILABLE)
    if not all(0 <= number <= _HIGHEST_BYTE for number in args):
        return error_reply(BAD_VALUES)
    threshold, min_points, gap = args
    visit.segments = (threshold, min_points, gap)
    return stage.state(visit)


def get_sg(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The lines that the laser sees."""
    return _laser(stage, visit, LINES)


def _laser(stage: Stage, visit: Visit, width: int) -> Reply:
    robot, now_s = stage.robot_of(visit), stage.simulation.time_s
    if not robot.model.sees:
        return error_reply(NOT_AVAILABLE)
    seen = laser_vector(robot, visit, width) if is_on(visit.terms.laser_mode) else (0,)
    stamps = {"laser": stamp_now(robot, now_s)} if visit.terms.mask.position & Position.LASER else {}
    return Reply("laser", laser=seen, stamps=stamps, clock=robot_clock_ms(robot, now_s))
