"""One object in place of many that are alike."""

import operator
import weakref
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pytest

from parapod.systems.core.merged import Alike, Mergeable, Merger
from parapod.systems.core.rows import Rows, each


def merged(objects):
    return Merger().merge(objects)


@dataclass(frozen=True)
class Leg:
    length: float
    name: str = "leg"

    @cached_property
    def square(self):
        return self.length * self.length


class Machine:
    def __init__(self, length, legs=2):
        self.legs = tuple(Leg(length + i) for i in range(legs))
        self.table = {"first": length, "same": 3.0}
        self.places = np.array([[length, 1.0], [0.0, -length]])
        self.pick = operator.itemgetter(1)
        self.reach = partial(self.scaled, 2.0)
        self.law = made(length)
        self.own = weakref.ref(self)

    @property
    def longest(self):
        return self.legs[-1].length

    @cached_property
    def sum(self):
        return self.legs[0].length + self.legs[1].length

    def scaled(self, factor):
        return factor * self.longest

    def led(self, x):
        return x + self.longest if x > 0.0 else x - self.longest


def made(length, *, twice=2.0):
    def law(x, offset=length):
        return twice * x + length + offset

    return law


LENGTHS = (1.5, 1.5, 0.25, 4.0)


@pytest.fixture
def machines():
    return [Machine(length) for length in LENGTHS]


def assert_rows(number, expected):
    assert type(number) is Rows
    assert number.values.tolist() == list(expected)


def test_every_attribute_is_that_of_each_row(machines):
    whole = merged(machines)
    assert_rows(whole.legs[1].length, (m.legs[1].length for m in machines))
    assert_rows(whole.legs[0].square, (m.legs[0].square for m in machines))
    assert whole.legs[0].name == "leg"
    assert_rows(whole.table["first"], LENGTHS)
    assert whole.table["same"] == 3.0
    assert_rows(whole.places[1, 1], (-length for length in LENGTHS))
    assert whole.places[0, 1] == 1.0
    assert_rows(whole.longest, (m.longest for m in machines))
    assert_rows(whole.sum, (m.sum for m in machines))
    assert_rows(whole.scaled(3.0), (m.scaled(3.0) for m in machines))
    assert_rows(whole.reach(), (m.reach() for m in machines))
    assert_rows(whole.law(1.0), (m.law(1.0) for m in machines))
    assert whole.pick((4.0, 5.0)) == 5.0
    assert whole.own() is whole


def test_what_all_rows_share_stays_what_it_is(machines):
    assert merged([machines[0]] * 3) is machines[0]
    assert merged([0.5, 0.5]) == 0.5
    assert_rows(merged([0.0, -0.0]), [0.0, -0.0])


@pytest.mark.parametrize(
    "objects",
    [
        (1, 2),
        ("a", "b"),
        (1.0, 1),
        ({"a": 1.0}, {"b": 1.0}),
        (np.zeros(2), np.zeros(3)),
        (np.array([1]), np.array([2])),
        (lambda x: x, lambda x: -x),
        (operator.itemgetter(0), operator.itemgetter(1)),
    ],
)
def test_what_differs_and_is_no_number_is_refused(objects):
    with pytest.raises((TypeError, ValueError), match=r"rows differ|shorter|longer"):
        merged(objects)


def test_a_different_number_of_parts_is_refused_as_it_is_read():
    whole = merged([Machine(1.0, 2), Machine(1.0, 3)])
    assert whole.table["first"] == 1.0
    with pytest.raises(ValueError, match=r"shorter|longer"):
        _ = whole.legs


def test_a_class_with_slots_has_them_merged():
    class Slotted:
        __slots__ = ("length",)
        kind = "slotted"

    slotted = [Slotted() for _ in LENGTHS]
    for one, length in zip(slotted, LENGTHS, strict=True):
        one.length = length
    with pytest.raises(TypeError, match="rows differ"):
        merged(slotted)
    kind = type("Open", (Slotted,), {"read": lambda self: self.length})
    for one in (open_ := [kind() for _ in LENGTHS]):
        one.length = 2.0 + len(vars(one))
    open_[1].length = 0.5
    whole = merged(open_)
    assert_rows(whole.read(), (2.0, 0.5, 2.0, 2.0))
    assert whole.kind == "slotted"


def test_a_method_in_another_language_is_not_taken_for_that_of_all():
    kind = type("Numbers", (list,), {})
    whole = merged([kind([1.0]), kind([2.0])])
    with pytest.raises(TypeError, match="one of them at a time"):
        whole.index(1.0)


def test_some_rows_have_an_object_of_their_own(machines):
    whole = merged(machines)
    assert isinstance(whole, Alike)
    some = whole.taken(np.array([3, 0]))
    assert_rows(some.longest, (5.0, 2.5))
    assert whole.taken(np.array([3, 0])) is some
    assert whole.taken(2) is machines[2]


def test_channels_of_rows_that_part_have_the_objects_of_their_rows(machines):
    x = [Rows(np.array([1.0, -1.0, 2.0, -2.0])), Rows(np.array([-3.0, 3.0, 3.0, 3.0]))]
    results = each(merged(machines).led, x)
    for result, column in zip(results, x, strict=True):
        rows = zip(machines, column.values.tolist(), strict=True)
        assert_rows(result, (machine.led(number) for machine, number in rows))


def test_an_object_may_say_itself_what_stands_for_many():
    class Course(Mergeable):
        def __init__(self, *values):
            self.values = values

        @classmethod
        def of_rows(cls, objects):
            return cls(*(value for one in objects for value in one.values))

    assert merged([Course(1), Course(2)]).values == (1, 2)
