"""PCG64 and its normal numbers in arrays of words, against numpy's generators."""

from __future__ import annotations

import numpy as np
import pytest

from nserver_emu.simulation.noise import Purpose, RngFactory

batch_random = pytest.importorskip("nserver_emu.simulation.batch_kernel", exc_type=ImportError)


@pytest.mark.parametrize("factory", [RngFactory(1, 0), RngFactory(9999, 123456789)])
def test_words_are_those_of_pcg64(factory: RngFactory) -> None:
    words = np.array(batch_random.stream_words(factory, Purpose.SONAR), dtype=np.uint64)
    with np.errstate(over="ignore"):
        found = [int(batch_random.next_word(words)) for _ in range(200)]
    assert found == [int(word) for word in factory.stream(Purpose.SONAR).bit_generator.random_raw(200)]


@pytest.mark.long
def test_normal_numbers_are_those_of_numpy() -> None:
    factory = RngFactory(2, 5)
    words = np.array(batch_random.stream_words(factory, Purpose.MOTION), dtype=np.uint64)
    with np.errstate(over="ignore"):
        found = [batch_random.standard_normal(words) for _ in range(20_000)]
    assert found == factory.stream(Purpose.MOTION).standard_normal(20_000).tolist()
    # Some lie in the tail beyond the ziggurat's layers, on both sides.
    assert min(found) < -batch_random._TAIL < batch_random._TAIL < max(found)
