"""The models as users know them."""

from __future__ import annotations

from math import radians

import pytest

from nserver_emu.simulation.drive import NO_AXIS, DifferentialDrive, SynchroDrive
from nserver_emu.simulation.models import MODELS, RobotModel
from worlds.robots import BODIES


@pytest.mark.parametrize("name", ["n150", "n200"])
def test_the_synchro_drives(name: str) -> None:
    model = MODELS[name]
    assert isinstance(model.drive(ramps=True), SynchroDrive)
    assert model.in_inches == (True, False, False)
    assert [axis.top_speed for axis in model.axes] == [20.0, radians(45.0), radians(45.0)]
    assert [axis.acceleration for axis in model.axes] == [30.0, radians(50.0), radians(50.0)]


def test_the_scout() -> None:
    model = MODELS["scout"]
    assert isinstance(model.drive(ramps=True), DifferentialDrive)
    assert model.track_in == pytest.approx(13.590, abs=5e-4)
    assert [axis.top_speed for axis in model.axes] == [39.0, 39.0, 0.0]
    assert [axis.acceleration for axis in model.axes[:2]] == [30.0, 30.0]
    assert model.in_inches == (True, True, False)


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_a_model_has_its_body_and_is_of_its_own_family(model: RobotModel) -> None:
    assert model.body is BODIES[model.name]
    assert model.family == model.name


def test_every_model_is_consistent() -> None:
    for name, model in MODELS.items():
        assert name == model.name
        for axis in model.axes:
            if axis is NO_AXIS:
                continue
            assert 0.0 < axis.resolution < axis.speed <= axis.top_speed
            assert 0.0 < axis.min_acceleration < axis.acceleration <= axis.top_acceleration
