"""Claims: how a number here is held against the printed one."""

import math

import pytest

from parapod.sims.output.results import Metric, Result
from parapod.sims.report.chapter import Claim, Numbers, Relation, Tone


def result(value, seed=0):
    return Result("tilt", "kinematic", seed, (Metric("tilt_deg", value, "deg"),))


def numbers(value, *seeds):
    return Numbers({"tilt": result(value)}, {"tilt": tuple(result(v) for v in seeds)})


def claim(printed, relation, **options):
    here = options.pop("here", lambda numbers: numbers("tilt", "tilt_deg"))
    return Claim("Fig. 1", "tilt", printed, "deg", here, relation, **options)


@pytest.mark.parametrize(
    ("relation", "options", "value", "word", "tone"),
    [
        (Relation.AT_MOST, {}, 0.1, "20 times better", Tone.GOOD),
        (Relation.AT_MOST, {}, -0.8, "2.5 times better", Tone.GOOD),
        (Relation.AT_MOST, {}, 1.9, "reached", Tone.GOOD),
        (Relation.AT_MOST, {}, 2.1, "worse", Tone.BAD),
        (Relation.AT_MOST, {}, -2.1, "worse", Tone.BAD),
        (Relation.AT_LEAST, {}, 2.0, "reached", Tone.GOOD),
        (Relation.AT_LEAST, {}, 1.9, "differs", Tone.BAD),
        (Relation.EQUAL, {}, 2.0, "the same", Tone.GOOD),
        (Relation.EQUAL, {}, 2.01, "differs", Tone.BAD),
        (Relation.EQUAL, {"tolerance": 0.1}, 2.1, "agrees", Tone.GOOD),
        (Relation.EQUAL, {"tolerance": 0.1}, 2.3, "differs", Tone.BAD),
        (Relation.ALIKE, {"tolerance": 2.0}, 3.9, "the same order", Tone.GOOD),
        (Relation.ALIKE, {"tolerance": 2.0}, 1.1, "the same order", Tone.GOOD),
        (Relation.ALIKE, {"tolerance": 2.0}, 4.1, "differs", Tone.BAD),
        (Relation.ALIKE, {"tolerance": 2.0}, 0.9, "differs", Tone.BAD),
        (Relation.USED, {}, 2.0, "used", Tone.NEUTRAL),
        (Relation.USED, {}, 2.1, "differs", Tone.BAD),
        (Relation.MISSING, {}, 2.0, "not reproduced", Tone.BAD),
    ],
)
def test_the_verdict_follows_from_both_numbers(relation, options, value, word, tone):
    verdict = claim(2.0, relation, **options).verdict(numbers(value))
    assert (verdict.word, verdict.tone) == (word, tone)


@pytest.mark.parametrize("value", [0.1, 1.9, 2.1])
def test_a_verdict_on_what_the_paper_measured_says_that_it_is_simulated_here(value):
    of_machine = claim(2.0, Relation.AT_MOST, is_measured=True).verdict(numbers(value))
    of_numbers = claim(2.0, Relation.AT_MOST).verdict(numbers(value))
    assert (of_machine.remark, of_numbers.remark) == ("simulated here", "")
    assert (of_machine.word, of_machine.tone) == (of_numbers.word, of_numbers.tone)
    without = claim(2.0, Relation.AT_MOST, is_measured=True).verdict(Numbers({}))
    assert (without.word, without.remark) == ("not run", "")


@pytest.mark.parametrize("relation", list(Relation))
def test_a_number_that_is_not_there_is_never_good(relation):
    for without in (Numbers({}), numbers(math.nan), numbers(math.inf)):
        assert claim(2.0, relation).verdict(without).tone is Tone.BAD
    assert claim(2.0, relation, here=None).verdict(numbers(2.0)).word == "not reproduced"


def test_numbers_printed_as_text_are_judged_by_their_difference():
    words = claim("much smaller", Relation.EQUAL, tolerance=0.1, show=lambda _: "3 against 40")
    assert words.verdict(numbers(0.075)).tone is Tone.GOOD
    assert words.verdict(numbers(0.3)).tone is Tone.BAD
    assert words.shown(numbers(0.075)) == "3 against 40"
    assert words.as_printed() == "much smaller deg"


def test_with_seeds_the_printed_number_is_looked_for_among_them():
    spread = claim(2.0, Relation.ALIKE, tolerance=10.0, spread=("tilt", "tilt_deg"))
    assert spread.verdict(numbers(0.5, 0.1, 3.0, 1.0)).word == "within the seeds"
    assert spread.shown(numbers(0.5, 0.1, 3.0, 1.0)) == "0.5 deg (0.1 to 3 over the seeds)"
    assert spread.verdict(numbers(0.5, 0.1, 1.0)).word == "differs"
    assert spread.verdict(numbers(0.5)).word == "the same order"
    assert spread.shown(numbers(0.5)) == "0.5 deg"


def test_a_misspelt_metric_is_an_error_and_not_a_missing_number():
    with pytest.raises(KeyError, match=r"'tilt' measures no 'roll_deg'"):
        numbers(1.0)("tilt", "roll_deg")
