"""Numbers of rows are those that a law has with floats."""

import numpy as np
import pytest

from parapod.systems.core.rows import Rows


@pytest.mark.parametrize("exponent", [2, 3, 0.5])
def test_powers_are_those_of_floats(exponent):
    values = np.random.default_rng(0).uniform(0.0, 10.0, 20000)
    expected = [value**exponent for value in values.tolist()]
    assert np.array_equal((Rows(values) ** exponent).values, expected)
