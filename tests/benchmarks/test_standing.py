"""A simulated robot that stands still: the filter stays consistent, for any number of readings."""

from __future__ import annotations

import json

import numpy as np
import pytest
import standing

from localization.experiments.live_trial import SCENARIOS
from localization.filters.belief import chi_square_quantile

SEEDS = 6
# The sum of NEES over six robots has a chi-square distribution with 3 x 6 degrees of freedom.
LEAST, MOST = (chi_square_quantile(share, 3 * SEEDS) for share in (0.001, 0.999))


@pytest.mark.parametrize(
    ("name", "method", "seconds"), [("exact", "ekf", 20.0), ("exact", "finder", 20.0), ("noisy", "smoother", 60.0)]
)
def test_repeated_echoes_do_not_reduce_variance(name: str, method: str, seconds: float) -> None:
    """Use three degrees of freedom per robot."""
    total = sum(standing.measure_nees(SCENARIOS[name], seed, (seconds,), method)[0, 0] for seed in range(SEEDS))
    assert LEAST < total < MOST


def test_drawn_pose_is_free() -> None:
    for seed in range(20):
        x, y, _ = standing.draw_free_pose(np.random.default_rng(seed)).tolist()
        standing.WORLD.require_free(x, y, standing.N150.radius_in)


def test_report_text(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--noise", "exact", "noisy", "--seeds", "2", "--at", "1", "3"]
    standing.main([*words, "--json"])
    rows = json.loads(capsys.readouterr().out)
    assert [(row["noise"], row["after_s"]) for row in rows] == [("exact", 1), ("exact", 3), ("noisy", 1), ("noisy", 3)]
    runs = np.array([standing.measure_nees(SCENARIOS["noisy"], seed, (1.0, 3.0)) for seed in range(2)])
    assert [row["nees"] for row in rows[2:]] == pytest.approx(runs[:, :, 0].mean(axis=0))
    assert rows[3]["rmse_in"] == pytest.approx(np.sqrt((runs[:, 1, 1] ** 2).mean()))
    standing.main(words)
    assert "noisy" in capsys.readouterr().out
