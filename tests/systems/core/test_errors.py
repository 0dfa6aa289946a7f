import pytest

from parapod.systems.core.errors import UndeterminedCalibration


@pytest.mark.parametrize("count", [1, 5])
def test_a_few_undetermined_directions_are_all_named(count):
    names = [f"l_{i}" for i in range(count)]
    error = UndeterminedCalibration(names, ["tilt it"])
    assert f"determine {'; '.join(names)} (what helps: tilt it)" in str(error)
    assert "more" not in str(error)


def test_of_many_undetermined_directions_five_are_named_and_the_others_counted():
    names = [f"l_{i}" for i in range(7)]
    error = UndeterminedCalibration(names, ["tilt it", "turn it"])
    assert "determine l_0; l_1; l_2; l_3; l_4; and 2 more (what" in str(error)
    assert error.directions == tuple(names)
