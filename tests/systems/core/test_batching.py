import numpy as np
import pytest

from parapod.systems.core.batching import columns, first_of_largest, stack


def test_what_is_taken_apart_is_put_together_again():
    batch = np.arange(24.0).reshape(2, 4, 3)
    (taken,), shape = columns((batch, 3, "batch"))
    assert shape == (2, 4)
    assert all(column.flags.c_contiguous for column in taken)
    np.testing.assert_array_equal(stack(taken, shape), batch)


def test_blocks_broadcast_and_one_without_a_batch_stays_floats():
    (many, few, one), shape = columns(
        (np.ones((5, 1, 2)), 2, "many"), (np.ones((4, 1), dtype=int), 1, "few"), ((1, 2), 2, "one")
    )
    assert shape == (5, 4)
    assert [column.shape for column in (*many, *few)] == [(20,)] * 3
    assert few[0].dtype == float
    assert one == [1.0, 2.0]
    assert {type(value) for value in one} == {float}
    np.testing.assert_array_equal(stack(one, shape), np.broadcast_to((1.0, 2.0), (5, 4, 2)))


@pytest.mark.parametrize("value", [0.0, [0.0], np.zeros((2, 4))])
def test_another_width_is_refused_by_name(value):
    with pytest.raises(ValueError, match=r"ground must have shape \(\.\.\., 2\)"):
        columns((value, 2, "ground"))


def test_the_first_of_values_that_differ_by_rounding_is_the_largest():
    assert first_of_largest([[0.0, 1.0], [1.0 + 1e-13, 0.5]], 1e-9) == (0, 1)
    assert first_of_largest([[0.0, 1.0], [1.0 + 1e-6, 0.5]], 1e-9) == (1, 0)
    assert first_of_largest([3.0, np.nan, np.inf, np.nan], 1e-9) == (1,)
