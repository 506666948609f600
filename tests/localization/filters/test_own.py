"""Filters of users: loading, the interface, and errors that say what is expected."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, Floats, independent
from localization.filters.health import HealthStatus
from localization.filters.own import OwnFilterAdapter, OwnFilterError, TimedEcho, load_factory
from localization.filters.registry import METHOD_CHOICES, METHODS, make
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.robots import BODIES

ROOM = load_world("thesis_room")
CONFIG = LocalizationConfig(ROOM.walls, BODIES["n150"])
START = independent([10.0, 20.0, 0.5], [0.1, 0.1, 0.01])


class Recorder:
    """A filter that records its calls and answers as it is told."""

    def __init__(self, config: LocalizationConfig = CONFIG, belief: Belief = START) -> None:
        del config
        self.x: Floats = belief.mean
        self.P: Floats = belief.cov
        self.steps: list[tuple[float, float]] = []
        self.echoes: list[TimedEcho] = []
        self.answer: tuple[float, float] | None = (0.5, 0.25)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        self.steps.append((distance_in, turn_rad))

    def update(self, echo: TimedEcho) -> tuple[float, float] | None:
        self.echoes.append(echo)
        return self.answer


def adapted() -> tuple[Recorder, OwnFilterAdapter]:
    own = Recorder()
    return own, OwnFilterAdapter(own, CONFIG)


def test_echoes_come_with_time_and_direction() -> None:
    own, to = adapted()
    poses = [(1.0, 0.0, 0.0, 0.0, 0.25), (2.0, 4.0, 0.0, 0.0, 0.25)]
    outcomes = to.process(poses[0], poses, [(1.5, 3, 40.0), (2.0, 0, 50.0), (2.0, 1, 255.0)])
    assert own.steps == [(2.0, 0.0), (2.0, 0.0), (0.0, 0.0)]
    first, second = own.echoes
    assert first[:3] == (1.5, 3, 40.0)
    assert first.direction_rad == pytest.approx(0.25 + 3 * np.pi / 8)
    assert first.ring_in == CONFIG.body.sonar_ring_radius_in
    assert (second.clock_s, second.direction_rad) == (2.0, 0.25)
    assert [outcome[:3] for outcome in outcomes] == [(0, 0.5, 1.0), (0, 0.5, 1.0), (Refusal.LIMIT, 0.0, 0.0)]


def test_estimate_after_the_last_echo_is_predicted() -> None:
    own, to = adapted()
    ahead = to.predicted(10.0, 0.0, (0.5, 0.0))
    assert ahead.mean == pytest.approx([10.0 + 10.0 * np.cos(0.5), 20.0 + 10.0 * np.sin(0.5), 0.5])
    assert np.trace(ahead.cov) > np.trace(START.cov)
    assert own.steps == []
    assert to.belief.mean == pytest.approx(START.mean)


def test_health_follows_from_what_update_returns() -> None:
    own, to = adapted()
    own.P = np.diag([0.01, 0.01, 0.001])
    found: list[HealthStatus] = []
    for answer, refusal in (((0.5, 0.25), Refusal.NONE), (None, Refusal.GATE)):
        own.answer = answer
        assert {to.update(0, 0.0, 40.0).refusal for _ in range(48)} == {refusal}
        found.append(to.health.status)
    assert found == [HealthStatus.OK, HealthStatus.DEGRADED]


def test_longer_states_are_allowed() -> None:
    own, to = adapted()
    own.x, own.P = np.arange(5.0), np.eye(5)
    to.predict(1.0, 0.0)
    assert to.belief.mean.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("name", "value", "word"), [
    ("x", np.array([0.0, np.nan, 0.0]), "finite"), ("x", np.zeros(2), r"\(2,\)"), ("x", "nowhere", "numbers"),
    ("P", np.eye(2), r"\(2, 2\)"), ("P", -np.eye(3), "above 0"), ("answer", (1.0, 0.0), "variance"),
    ("answer", 3.0, "innovation"), ("answer", (np.nan, 1.0), "None"),
])  # fmt: skip
def test_invalid_estimates_say_what_is_expected(name: str, value: object, word: str) -> None:
    own, to = adapted()
    setattr(own, name, value)
    with pytest.raises(OwnFilterError, match=word):
        to.update(0, 0.0, 40.0)


def test_missing_estimate_is_named() -> None:
    own = Recorder()
    del own.x
    with pytest.raises(OwnFilterError, match="has no x"):
        OwnFilterAdapter(own, CONFIG)


SOURCE = """
from helper import BASE
class MyFilter:
    def __init__(self, config, belief):
        self.x, self.P = belief.mean, belief.cov
"""


def test_classes_of_files_and_modules_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "filters_of_a_test.py").write_text(SOURCE, encoding="utf-8")
    (tmp_path / "helper.py").write_text("BASE = 1\n", encoding="utf-8")
    made = make(f"{tmp_path}/filters_of_a_test.py:MyFilter", CONFIG, START)
    assert made.belief.mean == pytest.approx(START.mean)
    monkeypatch.chdir(tmp_path)
    assert load_factory("filters_of_a_test:MyFilter").__name__ == "MyFilter"


def test_file_does_not_replace_a_module_of_its_name(tmp_path: Path) -> None:
    (tmp_path / "colorsys.py").write_text("class MyFilter:\n    pass\n", encoding="utf-8")
    load_factory(f"{tmp_path}/colorsys.py:MyFilter")
    assert hasattr(importlib.import_module("colorsys"), "rgb_to_hsv")


@pytest.mark.parametrize(("method", "word"), [
    ("no_such_module:MyFilter", "no module"), ("no_such.module:MyFilter", "no module"),
    ("nothing.py:A", "no such file"),
    (":A", "no module"), ("localization.filters.own:TimedEco", "did you mean TimedEcho"),
])  # fmt: skip
def test_missing_classes_are_reported(method: str, word: str) -> None:
    with pytest.raises(OwnFilterError, match=word):
        load_factory(method)


def test_errors_of_the_users_module_are_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_of_a_test.py").write_text("import no_such_thing_at_all\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="no_such_thing_at_all"):
        load_factory("broken_of_a_test:MyFilter")


def test_method_option_accepts_names_and_classes() -> None:
    assert tuple(METHOD_CHOICES) == tuple(METHODS)
    assert "ekf" in METHOD_CHOICES
    assert "my_filter.py:MyFilter" in METHOD_CHOICES
    assert "efk" not in METHOD_CHOICES
