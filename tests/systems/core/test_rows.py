import inspect
import math

import numpy as np
import pytest

from parapod.systems.core import elementwise, quaternions
from parapod.systems.core.elementwise import (
    all_finite,
    atan2,
    both,
    clamp,
    copysign,
    either,
    exp,
    first_least,
    greatest,
    is_finite,
    least,
    length_of,
    log,
    negated,
    quotient,
    sin_cos,
    sqrt,
    sumprod,
    total,
    where,
)
from parapod.systems.core.rows import Mask, Parted, Rows, array_of, by_library, carried_out, each
from parapod.systems.core.vectors import Axes, turned_angles

RANDOM = np.random.default_rng(5)
NUMBERS = np.concatenate(
    [RANDOM.uniform(-1.5, 1.5, 400), RANDOM.normal(0.0, 30.0, 90), [0.0, -0.0, 1.0, -1.0, 0.5]]
)
A, B, C = (RANDOM.permutation(NUMBERS) for _ in range(3))


def one_by_one(law, *columns):
    """Results of a law for each row, as floats."""
    return [law(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def by_rows(law, *columns):
    """Numbers of a law of rows, which may part."""

    def of_rows(index):
        rows = (Rows(c if index is None else c[index]) for c in columns)
        return as_tuple(law(*rows))

    numbers = carried_out(
        of_rows, lambda i: as_tuple(law(*(float(c[i]) for c in columns))), columns[0].size
    )
    size = columns[0].size
    return np.array([x.values if type(x) is Rows else np.full(size, x) for x in numbers]).T


def as_tuple(result):
    return result if isinstance(result, tuple) else (result,)


def assert_same(rows, scalars):
    expected = np.array([as_tuple(result) for result in scalars], dtype=float)
    assert np.array_equal(rows, expected, equal_nan=True)
    finite = np.isfinite(expected)
    assert np.array_equal(np.signbit(rows[finite]), np.signbit(expected[finite]))


LAWS = {
    "arithmetic": lambda a, b, c: (
        a * b - 2.0 * c + 3,
        -a / (1.5 + b * b),
        abs(a) - (1.0 - c),
        +b,
    ),
    "powers and rounding": lambda a, b, c: (a**2, round(a * 10.0) * 0.1, (a % 0.7) + b),
    "functions": lambda a, b, c: (sqrt(a), *sin_cos(b), atan2(a, c), exp(0.1 * a), log(b)),
    "arc sine": lambda a, b, c: elementwise.asin(a),
    "sine": lambda a, b, c: elementwise.sin(a),
    "quotient": lambda a, b, c: (quotient(a, b), quotient(1.0, c)),
    "choices": lambda a, b, c: (
        where(a > b, a, c),
        least(a, b),
        greatest(a, b),
        clamp(a, -1.0, b),
    ),
    "signs": lambda a, b, c: (copysign(a, b), copysign(2.0, c), length_of(a, b, c)),
    "answers": lambda a, b, c: where(
        either(both(a > 0.0, b > 0.0), negated(is_finite(c))), a, where(a == b, 1.0, c)
    ),
    "answers compared": lambda a, b, c: (
        1.0 if (a > 0.0) == (b > 0.0) else 2.0,
        1.0 if (a > 0.0) != (b > 0.0) else 2.0,
        1.0 if bool(c == c) == (a > 0.5) else 2.0,
        1.0 if (a > 0.5) != True else 2.0,  # noqa: E712
    ),
    "ways": lambda a, b, c: (a if a > b else b * c) if c > 0.0 else (-a if a != b else 0.0),
    "finite": lambda a, b, c: (
        a if all_finite([[a, b], [b, c]]) else 0.0,
        b if all_finite(np.array([b, quotient(a, c)])) else 1.0,
    ),
    "sums": lambda a, b, c: total((a, 1e9 * b, c, -1e9 * b, 0.1)),
    "sums of products": lambda a, b, c: sumprod((a, 1e9, -1e9, 2.0), (b, c, c, a)),
    "loops": lambda a, b, c: next(x for x in (a, b, c, 9.0) if x > 0.5),
    "quaternions": lambda a, b, c: quaternions.turn_between(
        quaternions.of_angles(a, b, c), quaternions.of_turn((0.1 * c, 0.0 * a, b))
    ),
    "attitudes": lambda a, b, c: Axes.from_roll_pitch_yaw(a, b, c).roll_pitch_yaw(),
    "turns": lambda a, b, c: turned_angles((0.3 * a, 0.2, b), (a, 0.0 * b, c)),
    "for floats only": lambda a, b, c: (math.tanh(a), float(b), a),
}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_law_of_rows_is_that_of_each_row(law):
    assert_same(by_rows(law, A, B, C), one_by_one(law, A, B, C))


# Functions of a list of numbers, which have tests of their own.
OF_SEVERAL = (all_finite.__name__, first_least.__name__, sumprod.__name__, total.__name__)


def test_every_elementwise_function_takes_rows():
    """A new one is given rows, and floats for its other arguments."""
    for name, function in inspect.getmembers(elementwise, inspect.isfunction):
        if function.__module__ != elementwise.__name__ or name in OF_SEVERAL:
            continue
        count = sum(
            parameter.default is parameter.empty
            for parameter in inspect.signature(function).parameters.values()
        )
        of_answers = name in (both.__name__, either.__name__, negated.__name__, where.__name__)
        # Within the domain of all of them: of what is beyond it NumPy warns on some processors.
        first = Mask(A > 0.0) if of_answers else Rows(0.1 + 0.8 * np.abs(np.sin(A)))
        result = function(first, *[0.5] * (count - 1))
        for part in result if isinstance(result, tuple) else (result,):
            assert type(part) in (Rows, Mask), name


def test_the_first_of_the_smallest():
    numbers = [Rows(np.round(x)) for x in (A, B, C)]
    chosen = first_least(numbers)
    for i, row in enumerate(zip(*(x.values.tolist() for x in numbers), strict=True)):
        assert [bool(mask.flags[i]) for mask in chosen] == list(first_least(row))


@pytest.mark.parametrize("channels", [1, 4])
def test_channels_are_further_rows(channels):
    def law(gain, x, y):
        return (gain * x, y) if x > y else (y / gain, x)

    columns = [[Rows(RANDOM.permutation(NUMBERS)) for _ in range(channels)] for _ in range(2)]
    gains = [0.5 + i for i in range(channels)]
    for results, gain, x, y in zip(each(law, gains, *columns), gains, *columns, strict=True):
        expected = one_by_one(lambda x, y, gain=gain: law(gain, x, y), x.values, y.values)
        assert_same(np.array([part.values for part in results]).T, expected)
    assert each(law, [2.0, 3.0], [1.0, 2.0], [2.0, 1.0]) == [(1.0, 1.0), (6.0, 1.0)]
    assert each(lambda x: -x, [1.0, 2.0]) == [-1.0, -2.0]


def test_a_question_that_rows_answer_differently_parts_them():
    with pytest.raises(Parted) as parted:
        bool(Rows(np.array([1.0, 2.0, 3.0])) > 1.5)
    assert parted.value.flags.tolist() == [False, True, True]
    assert Rows(np.array([1.0, 2.0])) > 0.5
    assert not Rows(np.array([1.0, 2.0])) < 0.5


def test_an_error_of_one_row_is_that_of_its_own_law():
    def law(a):
        if a > 1.49:
            raise ValueError("too large")
        return 1.0 / a

    errors = []

    def one(i):
        try:
            return (law(float(A[i])),)
        except (ValueError, ZeroDivisionError) as error:
            errors.append((i, type(error)))
            return (math.nan,)

    with np.errstate(divide="raise"):
        (numbers,) = carried_out(
            lambda index: (law(Rows(A if index is None else A[index])),), one, A.size
        )
    for i, value in enumerate(A.tolist()):
        if value > 1.49:
            assert (i, ValueError) in errors
        elif value == 0.0:
            assert (i, ZeroDivisionError) in errors
        else:
            assert numbers.values[i] == 1.0 / value


def test_numbers_beside_rows_are_numbers():
    array = array_of([1.0, Rows(A)])
    assert array.dtype == object
    assert (np.float64(2.0) * Rows(A)).values.tolist() == (2.0 * A).tolist()
    for bad in ("1", None, np.ones(2)):
        with pytest.raises(TypeError):
            _ = Rows(A) + bad


@pytest.mark.parametrize(
    "function", [math.sin, math.cos, math.asin, math.exp, math.log, math.atan2, math.pow]
)
def test_functions_of_the_library_to_the_last_bit(function):
    count = 2 if function in (math.atan2, math.pow) else 1
    arguments = [RANDOM.uniform(0.01, 0.99, 5000) for _ in range(count)]
    assert by_library(function, *arguments).tolist() == [
        function(*row) for row in zip(*(a.tolist() for a in arguments), strict=True)
    ]


@pytest.mark.parametrize("exponent", [2, 3, 0.5])
def test_powers_are_those_of_floats(exponent):
    values = RANDOM.uniform(0.0, 10.0, 20000)
    expected = [value**exponent for value in values.tolist()]
    assert np.array_equal((Rows(values) ** exponent).values, expected)
