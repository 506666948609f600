"""The model table by name."""

from __future__ import annotations

import pytest

from nclient.errors import AddressError
from nclient.protocol.types import MODELS, N200, model_named


def test_models_by_name() -> None:
    assert [model.number for model in (model_named("N200"), model_named("n150"), model_named("Scout"))] == [0, 1, 2]
    assert [name for name, model in MODELS.items() if model.sends_mask] == ["n200"]
    assert model_named("n200") is N200


def test_no_such_model() -> None:
    with pytest.raises(AddressError, match=r"no robot model 'n300'; there are n150, n200, scout"):
        model_named("n300")
