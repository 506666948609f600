"""The model table by name."""

from __future__ import annotations

import pytest

from nclient.errors import AddressError
from nclient.protocol.types import MODELS, N200, get_model


def test_models_by_name() -> None:
    assert [model.number for model in (get_model("N200"), get_model("n150"), get_model("Scout"))] == [0, 1, 2]
    assert [name for name, model in MODELS.items() if model.sends_mask] == ["n200"]
    assert get_model("n200") is N200


def test_no_such_model() -> None:
    with pytest.raises(AddressError, match=r"'n300'.* n150, n200, scout"):
        get_model("n300")
