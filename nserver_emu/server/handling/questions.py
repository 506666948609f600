"""Questions about a robot and its sensors, and the sensors' settings: a function a command, wire units out.

Rules: a question changes nothing; a sensor that the model lacks is ERROR 4, never a made-up reading.
"""

from __future__ import annotations

import math

from nclient.protocol.mask import BUMPER_SLOT, Position
from nclient.protocol.replies import Reply
from nclient.protocol.units import clamped_word, wrapped_word
from nserver_emu.server.conversation.session import Visit
from nserver_emu.server.stage.axis_units import axis_tenths
from nserver_emu.server.stage.stage import Stage
from nserver_emu.server.stage.state_reply import (
    pose_tenths,
    robot_clock_ms,
    sonar_stamps,
    stamp_now,
    velocity_tenths,
)

_INT32_MAX = 0x7FFFFFFF


def conf_sn(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The sonars' firing rate, clamped, and order, which ends at the first that is no sonar; the ring starts anew."""
    rate, *order = args
    stage.robot_of(visit).configure_sonars(rate, tuple(order))
    return stage.state(visit)


def conf_ser(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The speed of another serial port of the robot: nothing is plugged in there, so nothing changes."""
    return stage.state(visit)


def ct(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The session has noted the mask; the reply shows it at work."""
    return stage.state(visit)


def gs(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The state."""
    return stage.state(visit)


def get_sn(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """All sixteen sonars, mask or not."""
    robot = stage.robot_of(visit)
    slots = dict(enumerate(robot.sonar.readings_in, start=17))
    stamps = sonar_stamps(robot) if visit.terms.mask.position & Position.SONAR else {}
    return Reply("sonar", slots, stamps=stamps, clock=robot_clock_ms(robot, stage.simulation.time_s))


def get_rc(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """Position and angles."""
    return Reply("configuration", dict(enumerate(pose_tenths(stage.robot_of(visit)), start=34)))


def get_rv(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The three velocities."""
    return Reply("velocity", dict(enumerate(velocity_tenths(stage.robot_of(visit)), start=38)))


def get_ra(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The three accelerations, in the places of the velocities; 0 where axes jump to their speed."""
    robot = stage.robot_of(visit)
    return Reply("velocity", dict(enumerate(axis_tenths(robot, robot.accelerations), start=38)))


def get_bp(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The bumpers."""
    robot = stage.robot_of(visit)
    asked = visit.terms.mask.position & Position.BUMPER
    now_s = stage.simulation.time_s
    stamps = {"bumper": stamp_now(robot, now_s)} if asked else {}
    return Reply("bumper", {BUMPER_SLOT: robot.bumpers}, stamps=stamps, clock=robot_clock_ms(robot, now_s))


def sim_truth(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """Where the actual robot is; the filter never sees it."""
    pose = stage.robot_of(visit).actual
    values = (
        1,
        wrapped_word(stage.clock_ms),
        clamped_word(round(pose.x_in * 1000)),
        clamped_word(round(pose.y_in * 1000)),
        round(math.degrees(pose.steering_rad) * 1000),
        round(math.degrees(pose.turret_rad) * 1000),
        stage.simulation.seed & _INT32_MAX,
        visit.robot_id or 0,
    )
    return Reply("truth", values=values)
