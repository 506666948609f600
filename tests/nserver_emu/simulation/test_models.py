"""The models as users know them."""

from __future__ import annotations

from math import radians

from nserver_emu.simulation.models import MODELS
from worlds.bodies import BODIES


def test_the_n150() -> None:
    model = MODELS["n150"]
    assert model.body is BODIES["n150"]
    assert [axis.top_speed for axis in model.axes] == [20.0, radians(45.0), radians(45.0)]
    assert [axis.acceleration for axis in model.axes] == [30.0, radians(50.0), radians(50.0)]


def test_every_model_is_consistent() -> None:
    for name, model in MODELS.items():
        assert name == model.name
        for axis in model.axes:
            assert 0.0 < axis.resolution < axis.speed <= axis.top_speed
            assert 0.0 < axis.least_acceleration < axis.acceleration <= axis.top_acceleration
