"""A robot's own errors in place of its setup's: what a calibration says, as errors of this drive's axes and this ring.

    synchro         translation and steering are way and turn themselves: scales (way, turn), drifts (drift, 0)
    differential    right = way + b turn / 2, left = way - b turn / 2: wheels of one scale, and drifts that part them,

                    drift_1 = drift / 2 + (turn - way) / b        drift_2 = drift / 2 - (turn - way) / b

Rules: pure. Slip and the turret's gears stay the setup's.
"""

from __future__ import annotations

from dataclasses import replace

from nserver_emu.simulation.models import RobotModel
from nserver_emu.simulation.odometry import Odometry
from nserver_emu.simulation.setup import RobotSetup
from worlds.calibration import Calibration


def setup_of(model: RobotModel, setup: RobotSetup) -> RobotSetup:
    """How a robot of this model is simulated with this setup."""
    errs = model.errs
    if errs is None:
        return setup
    sonar = replace(setup.sonar, offsets_in=errs.offsets_in, turned_rad=errs.turned_rad)
    return replace(setup, odometry=_odometry(errs, setup.odometry, model.track_in), sonar=sonar)


def _odometry(errs: Calibration, odometry: Odometry, track_in: float | None) -> Odometry:
    way, turn, drift, turret = errs.way_scale, errs.turn_scale, errs.drift_rad_in, odometry.scales[2]
    if track_in is None:
        return replace(odometry, scales=(way, turn, turret), drifts=(drift, 0.0))
    apart = (turn - way) / track_in
    return replace(odometry, scales=(way, way, turret), drifts=(drift / 2.0 + apart, drift / 2.0 - apart))
