"""Instants add up exactly where seconds do not."""

from __future__ import annotations

from functools import reduce
from math import inf, nan
from operator import add

import pytest

from nserver_emu.simulation.segments import to_ps, to_s


def test_ten_tenths_are_one_second() -> None:
    assert reduce(add, [0.1] * 10) != 1.0, "added one after the other; `sum` corrects itself from Python 3.12 on"
    assert sum(to_ps(0.1) for _ in range(10)) == to_ps(1.0)
    assert to_s(to_ps(0.06)) == 0.06


@pytest.mark.parametrize("seconds", [-0.1, inf, nan])
def test_time_runs_forward_only(seconds: float) -> None:
    with pytest.raises(ValueError, match="0 s or more"):
        to_ps(seconds)
