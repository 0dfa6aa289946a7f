"""Variables of studies: forms in which values are given, and what is refused."""

import numpy as np
import pytest

from parapod.sims.study.variables import read_variables, split_variable
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import checked


@pytest.fixture
def read(trial):
    def read(**given):
        return read_variables(trial, checked(trial()), given)

    return read


def test_a_range_has_its_number_of_values_with_both_ends(read):
    (x,) = read(x="-5:5:11")
    assert x.values == pytest.approx(np.arange(-5.0, 6.0), abs=1e-15)
    assert read(x="3:1:2")[0].values == [3.0, 1.0]


def test_seeds_end_below_the_second_number(read):
    (seed,) = read(seed="3:6")
    assert list(seed.values) == [3, 4, 5]
    assert read(seed="0:4:3")[0].values == [0, 2, 4]


def test_values_are_listed_in_the_types_of_yaml(read):
    assert read(kind="good, refused")[0].values == ["good", "refused"]
    assert read(x="1,2.5")[0].values == [1, 2.5]
    assert read(x=np.array([1.0, 2.0]))[0].values == [1.0, 2.0]
    assert read(seed=range(3))[0].text == "[0, 1, 2]"
    assert not read(kind="good")[0].is_number


def test_a_text_may_be_empty(read):
    assert read(note=",a.py:make")[0].values == ["", "a.py:make"]
    assert read(note="'a, b', c")[0].values == ["a, b", "c"]


def test_shares_of_a_list_choose_each_value_equally_often(read):
    (x,) = read(x="1:3:3")
    shares = np.linspace(0.0, 1.0, 300, endpoint=False)
    assert [x.at(shares).count(value) for value in (1.0, 2.0, 3.0)] == [100] * 3
    assert x.at(np.array([1.0])) == [3.0]


def test_two_numbers_are_a_uniform_distribution_where_numbers_need_not_be_whole(read):
    for text in ("2:4", "uniform(2, 4)"):
        assert read(x=text)[0].at(np.array([0.0, 0.25, 1.0])) == [2.0, 2.5, 4.0]


def test_distributions_have_their_quantiles(read):
    assert read(x="normal(1, 2)")[0].at(np.array([0.5, 0.8413447460685429])) == pytest.approx(
        [1.0, 3.0], abs=1e-4
    )
    (wait,) = read(wait="loguniform(0.01, 1)")
    assert wait.at(np.array([0.0, 0.5, 1.0])) == pytest.approx([0.01, 0.1, 1.0])


def test_a_distribution_counts_as_far_as_it_is_admissible(read):
    (wait,) = read(wait="normal(0, 0.3)")  # 0..10
    found = np.array(wait.at(np.linspace(0.0, 1.0, 2001)))
    assert found.min() == 0.0
    assert found.max() <= 10.0
    # The median of a half normal distribution.
    assert found[1000] == pytest.approx(0.3 * 0.6744897501960817)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "varies at least one key"),
        ({"z": "0:1"}, "unknown key 'z'; allowed: backend, kind, note, seed, wait, x, y"),
        ({"x": "0:20:3"}, "x = 20 is outside -10..10"),
        ({"x": "0:20"}, "x = 20 is outside -10..10"),
        ({"x": [0.0, 11.0]}, "x = 11 is outside -10..10"),
        ({"x": "1:1:0"}, "the number of values must be whole, 1..10000"),
        ({"x": "2:1"}, "the end must be above the beginning"),
        ({"x": "uniform(2, 1)"}, "the first number must be below the second"),
        ({"x": "normal(0, 0)"}, "the deviation must be above 0"),
        ({"x": "normal(0)"}, "values are FIRST:LAST:NUMBER"),
        ({"x": "gauss(0, 1)"}, "values are FIRST:LAST:NUMBER"),
        ({"x": "normal(nan, 1)"}, "values are FIRST:LAST:NUMBER"),
        ({"wait": "loguniform(0, 1)"}, "the numbers must be above 0"),
        ({"wait": "normal(-9, 1)"}, "almost nothing of it is within 0..10"),
        ({"seed": "0:1.5"}, "both ends must be whole numbers"),
        ({"seed": "0:1:3"}, "seed must be a whole number, not 0.5"),
        ({"seed": "normal(0, 1)"}, "need not be whole"),
        ({"seed": "9999:10002"}, "seed = 10001 is outside 0..10000"),
        ({"kind": "good,bad"}, "kind = 'bad' is not one of good, refused"),
        ({"x": []}, "it has no values"),
        ({"x": "[1, "}, "values of x"),
    ],
)
def test_what_is_not_admissible_is_refused_by_its_key(read, given, words):
    with pytest.raises(ScenarioError) as caught:
        read(**given)
    assert words in str(caught.value)


def test_a_part_and_the_whole_of_it_are_not_varied_both(trial):
    from parapod.diagrams.levelling_platform.scenario import LevellingScenario

    given = {"ground.pitch_deg": "0:1:2", "ground": "{pitch_deg: 1}, {pitch_deg: 2}"}
    with pytest.raises(ScenarioError, match=r"ground\.pitch_deg is a part of ground"):
        read_variables(LevellingScenario, checked(LevellingScenario()), given)


def test_a_variable_is_split_at_its_first_sign_of_equality():
    assert split_variable("x = 1:2:3") == ("x", "1:2:3")
    for text in ("x", "=1", "x="):
        with pytest.raises(ScenarioError, match="is not of the form KEY=VALUES"):
            split_variable(text)
