import math

import pytest

from parapod.systems.core.units import READ, units_of


@pytest.mark.parametrize(
    ("unit", "size", "each"),
    [
        ("V", 2, ["V", "V"]),
        ("rad, rad, m", 3, ["rad", "rad", "m"]),
        ("m, m, rad", 6, ["m", "m", "rad", "m", "m", "rad"]),
        ("m, m/s", 4, ["m", "m", "m/s", "m/s"]),
        ("rad, m, and their rates", 4, ["rad", "m", "rad/s", "m/s"]),
        ("rad, m and rates", 4, ["rad", "m", "rad/s", "m/s"]),
        ("rad, rad/s, m/s^2", 3, ["rad", "rad/s", "m/s^2"]),
        ("m/s, rad/s", 2, ["m/s", "rad/s"]),
    ],
)
def test_units_of_elements(unit, size, each):
    assert units_of(unit, size) == each


@pytest.mark.parametrize(("unit", "size"), [("m, rad", 3), ("m, m/s", 1), ("rad, m and rates", 2)])
def test_units_of_another_number_of_elements_are_refused(unit, size):
    with pytest.raises(ValueError, match=f"'{unit}' has units of .* elements, not of {size}"):
        units_of(unit, size)


@pytest.mark.parametrize("unit", ["metres", "m/s/", "gap of the feet", "m, ", "m*s", "1"])
def test_units_that_there_are_not_are_refused_with_those_that_there_are(unit):
    with pytest.raises(ValueError, match=r"'.*' is not a unit; .* of A, .*, such as m/s\^2"):
        units_of(unit, 1)


def test_people_read_millimetres_and_degrees():
    assert READ["m"] == ("mm", 1e3)
    assert READ["rad"] == ("deg", pytest.approx(180.0 / math.pi))
