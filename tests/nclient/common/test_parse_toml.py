"""Files as text and TOML: whatever is wrong is the reader's own error, and can be reported."""

from __future__ import annotations

import pytest

from nclient.common.files import parse_toml
from nclient.errors import FaultPlanError

BEYOND = "0x" + "f" * 3600
"""Python reads it, and shows no number of more than 4,300 decimal digits."""


@pytest.mark.parametrize(
    "text", [f"seed = {BEYOND}", f"seed = 1\n[[rule]]\nname = [[1, {BEYOND}]]", "a.b = 0b" + "1" * 4097]
)
# 4097 bits, one more than allowed, in a table, a list and a nested key.
def test_integers_too_long_to_print_are_rejected(text: str) -> None:
    with pytest.raises(FaultPlanError, match=r"^plan: .* 4096 bits$"):
        parse_toml(text, "plan", FaultPlanError)


def test_longest_accepted_integer_can_be_printed() -> None:
    (largest,) = parse_toml("a = 0x" + "f" * 1024, "plan", FaultPlanError).values()
    assert str(largest) == str(2**4096 - 1)
