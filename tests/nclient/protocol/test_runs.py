"""Runs of numbers, against the constructs that take them one by one."""

from __future__ import annotations

import pytest
from construct import Int8ub, Int16ul, Int32ul
from hypothesis import given
from hypothesis import strategies as st

from nclient.protocol.layouts import BYTES, LINE_LONG, LINE_SIGNED, LONGS, SHORTS, SIGNED_LONGS, SIGNED_SHORTS, Run

KINDS = [(BYTES, Int8ub), (SHORTS, Int16ul), (LONGS, Int32ul), (SIGNED_SHORTS, LINE_SIGNED), (SIGNED_LONGS, LINE_LONG)]


@pytest.mark.parametrize(("run", "element"), KINDS)
@given(data=st.data())
def test_a_run_is_its_elements_one_after_another(run: Run, element: object, data: st.DataObject) -> None:
    # The largest magnitude: one bit less for the sign. Sign-magnitude is symmetric.
    most = 2 ** (8 * run.octets - bool(run.sign)) - 1
    # The oracle builds each number alone with construct, and not with the code for whole runs.
    numbers = data.draw(st.lists(st.integers(-most if run.sign else 0, most), max_size=20))
    packed = run.pack(numbers)
    assert packed == b"".join(element.build(number) for number in numbers)  # type: ignore[attr-defined]
    assert run.unpack(packed) == tuple(numbers)


@pytest.mark.parametrize(
    ("run", "number"),
    [(BYTES, 256), (BYTES, -1), (SHORTS, 65536), (LONGS, -1), (SIGNED_SHORTS, 32768), (SIGNED_SHORTS, -32768),
     (SIGNED_LONGS, 2**31)],
)  # fmt: skip
def test_a_number_that_does_not_fit_is_refused(run: Run, number: int) -> None:
    with pytest.raises(ValueError, match=str(abs(number))):
        run.pack([0, number])


@pytest.mark.parametrize(("run", "data", "number"), [
    (SIGNED_SHORTS, "0080", 0), (SIGNED_LONGS, "00000080", 0),
    (SIGNED_SHORTS, "3280", -50), (SIGNED_SHORTS, "c201", 450),
])  # fmt: skip
def test_the_top_bit_means_minus_and_minus_nothing_is_nothing(run: Run, data: str, number: int) -> None:
    assert run.unpack(bytes.fromhex(data)) == (number,)
