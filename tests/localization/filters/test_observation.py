"""What passes between gate and filter."""

from __future__ import annotations

import numpy as np

from localization.filters.update import Observation, Refusal


def test_only_beams_without_a_reason_are_used() -> None:
    codes = np.array([reason.value for reason in Refusal], dtype=np.int8)
    observation = Observation(np.zeros(6), np.zeros((6, 3)), np.ones(6), codes)
    assert observation.used.tolist() == [True] + [False] * 5
    assert observation.reasons() == tuple(Refusal)
