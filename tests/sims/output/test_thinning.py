import numpy as np
import pytest

from parapod.sims.output.logs.thinning import Extremes, Snapshots

MOST = 100


def thinned(time, values, pieces=(1, 700)):
    """The line of some rows that come in pieces of random sizes."""
    random, extremes, k = np.random.default_rng(1), Extremes(values.shape[1], MOST), 0
    while k < len(time):
        size = int(random.integers(*pieces))
        extremes.add(time[k : k + size], values[k : k + size])
        k += size
    return extremes.line()


@pytest.mark.parametrize("count", [0, 1, 2, 99, 100, 101, 1000, 4321, 20_000])
def test_a_line_of_any_length_is_short_and_keeps_each_extreme(count):
    random = np.random.default_rng(0)
    time, values = 0.01 * np.arange(count), random.normal(size=(count, 3))
    if count:
        values[count // 3, 1] = 50.0  # a spike of one row
        values[count // 2, 2] = -50.0
    line = thinned(time, values)
    assert len(line.time) == len(line.values) <= 4 * MOST
    assert (np.diff(line.time) >= 0.0).all()
    if count <= MOST:
        np.testing.assert_array_equal(line.values, values)
        assert line.bucket == 1
    if count:
        np.testing.assert_array_equal(line.values.max(axis=0), values.max(axis=0))
        np.testing.assert_array_equal(line.values.min(axis=0), values.min(axis=0))
        assert (line.time[0], line.time[-1]) == (time[0], time[-1])


def test_each_bucket_tells_its_extremes_in_the_order_in_which_they_came():
    count = 3207
    values = np.random.default_rng(0).normal(size=(count, 2))
    line = thinned(np.arange(count, dtype=float), values)
    size = line.bucket
    assert size > 2
    for k, begin in enumerate(range(0, count, size)):
        rows, pair = values[begin : begin + size], line.values[2 * k : 2 * k + 2]
        for column in range(2):
            places = sorted((rows[:, column].argmin(), rows[:, column].argmax()))
            np.testing.assert_array_equal(pair[:, column], rows[places, column])


def test_what_is_not_known_is_left_out_and_remains_where_there_is_nothing_else():
    count = 1600
    values = np.ones((count, 1))
    values[:800] = np.nan
    values[900:908] = np.nan
    line = thinned(np.arange(count, dtype=float), values)
    assert 8 < line.bucket <= 32
    assert np.isnan(line.values[line.time < 800 - line.bucket]).all()
    # Also of the bucket in which eight are not known.
    assert (line.values[line.time >= 800 + line.bucket] == 1.0).all()


def test_two_pieces_are_as_good_as_one():
    time, values = np.arange(5000.0), np.random.default_rng(0).normal(size=(5000, 2))
    for one, other in zip(
        vars(thinned(time, values)).values(),
        vars(thinned(time, values, (5000, 5001))).values(),
        strict=True,
    ):
        assert np.shape(one) == np.shape(other)


@pytest.mark.parametrize("count", [1, 30, 31, 1000, 12_345])
def test_rows_that_are_kept_are_equally_far_apart_from_the_first_on(count):
    rows = Snapshots(30)
    for k in range(count):
        rows.take(k)
    assert min(count, 15) <= len(rows.rows) <= 30
    assert rows.rows[0] == 0
    assert len(set(np.diff(rows.rows))) <= 1
