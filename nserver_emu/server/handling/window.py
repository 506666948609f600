"""Commands that draw into the window or have it redrawn: a function a command. What they leave is in graphics.py."""

from __future__ import annotations

from collections.abc import Callable

from nclient.protocol.replies import Reply
from nserver_emu.server.conversation.session import Visit
from nserver_emu.server.handling.ground import done
from nserver_emu.server.stage.graphics import Figure, Layer
from nserver_emu.server.stage.stage import Stage

_SENSORS = (Layer.BUMPER, Layer.INFRARED, Layer.SONAR, Layer.LASER)
_REDRAWN = {
    "refresh_all": tuple(Layer),
    "refresh_all_traces": (Layer.ACTUAL_TRACE, Layer.ENCODER_TRACE),
    "refresh_actual_trace": (Layer.ACTUAL_TRACE,),
    "refresh_encoder_trace": (Layer.ENCODER_TRACE,),
    "refresh_all_sensors": _SENSORS,
    "refresh_bumper_sensor": (Layer.BUMPER,),
    "refresh_infrared_sensor": (Layer.INFRARED,),
    "refresh_sonar_sensor": (Layer.SONAR,),
    "refresh_laser_sensor": (Layer.LASER,),
    "refresh_client_graphics": (Layer.CLIENT,),
}


def draw_robot(stage: Stage, _visit: Visit, args: tuple[int, ...]) -> Reply:
    """Draw a robot with its steering and turret."""
    return _draw(stage, Figure.ROBOT, args)


def draw_line(stage: Stage, _visit: Visit, args: tuple[int, ...]) -> Reply:
    """Draw a line between two points."""
    return _draw(stage, Figure.LINE, args)


def draw_arc(stage: Stage, _visit: Visit, args: tuple[int, ...]) -> Reply:
    """Draw part of the ellipse in a box."""
    return _draw(stage, Figure.ARC, args)


def refresher(layers: tuple[Layer, ...]) -> Callable[[Stage, Visit, tuple[int, ...]], Reply]:
    """The command that has these layers redrawn."""

    def refresh(stage: Stage, _visit: Visit, _args: tuple[int, ...]) -> Reply:
        stage.graphics.redraw(*layers)
        return done()

    return refresh


REFRESHERS = {name: refresher(layers) for name, layers in _REDRAWN.items()}
"""The ten refresh commands by their names."""


def _draw(stage: Stage, figure: Figure, args: tuple[int, ...]) -> Reply:
    *numbers, mode = args
    stage.graphics.draw(figure, tuple(numbers), mode, stage.allowed.graphics)
    return done()
