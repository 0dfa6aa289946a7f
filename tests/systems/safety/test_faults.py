"""Words for faults, the samples on which they act, and their severities."""

import ast
import inspect
import itertools
import math

import pytest

from parapod.systems.safety import faults
from parapod.systems.safety.faults import Fault, FaultKind, SampledFault, Severity

PERIOD = 0.01


def active_samples(fault, count=20):
    sampled = SampledFault(fault, PERIOD)
    return [k for k in range(count) if sampled.is_active(k)]


def test_kinds_are_px4s():
    assert [str(kind) for kind in FaultKind] == [
        "off",
        "stuck",
        "garbage",
        "wrong",
        "slow",
        "delayed",
        "intermittent",
    ]


def test_severities_are_ordered():
    ordered = sorted(Severity)
    assert [severity.name for severity in ordered] == [
        "NONE",
        "WARN",
        "HOLD",
        "BRAKE",
        "LATCHED_OFF",
    ]
    assert max(Severity.HOLD, Severity.WARN) is Severity.HOLD
    assert not Severity.NONE


@pytest.mark.parametrize("enum", [FaultKind, Severity])
def test_every_word_is_defined(enum):
    (body,) = (
        node.body
        for node in ast.parse(inspect.getsource(faults)).body
        if isinstance(node, ast.ClassDef) and node.name == enum.__name__
    )
    defined = {
        name.targets[0].id
        for name, text in itertools.pairwise(body)
        if isinstance(name, ast.Assign)
        and isinstance(text, ast.Expr)
        and len(text.value.value) > 15
    }
    assert defined == set(enum.__members__)


@pytest.mark.parametrize(
    ("begin", "duration", "samples"),
    [
        (0.03, 0.02, [3, 4]),
        (0.0, 0.01, [0]),
        (0.031, 0.02, [4, 5]),
        (0.029, 0.02, [3, 4]),
        (0.031, 0.005, []),
        (0.17, math.inf, [17, 18, 19]),
        # What sums of periods make of 0.03 and 0.05.
        (0.01 + 0.01 + 0.01 + 1e-12, 0.02 - 1e-12, [3, 4]),
    ],
)
def test_a_fault_acts_from_the_first_sample_at_or_after_its_begin_to_its_end(
    begin, duration, samples
):
    assert active_samples(Fault(FaultKind.OFF, begin=begin, duration=duration)) == samples


def test_samples_are_counted_right_after_a_day():
    sampled = SampledFault(Fault(FaultKind.OFF, begin=86400.0, duration=0.05), PERIOD)
    first = 8_640_000
    assert [sampled.is_active(first + k) for k in (-1, 0, 4, 5)] == [False, True, True, False]


def test_the_turns_of_an_intermittent_fault_begin_with_a_missing_one():
    fault = Fault(FaultKind.INTERMITTENT, begin=0.02, missing_time=0.03, good_time=0.02)
    gaps = [SampledFault(fault, PERIOD).gap(k) for k in range(2, 14)]
    assert gaps == [2, 2, 2, None, None, 7, 7, 7, None, None, 12, 12]


def test_a_kind_may_be_given_by_its_word():
    assert Fault("stuck").kind is FaultKind.STUCK


def test_a_wrong_value_has_the_other_sign_unless_more_is_said():
    assert Fault(FaultKind.WRONG).factor == -1.0
    assert Fault(FaultKind.WRONG, offset=0.5).factor == 1.0
    assert Fault(FaultKind.WRONG, offset=0.5, scale=2.0).factor == 2.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "stuk"}, "'stuk' is not a valid FaultKind"),
        ({"begin": -1.0}, "begin must be finite and 0 or more, not -1"),
        ({"begin": math.nan}, "begin"),
        ({"begin": math.inf}, "begin"),
        ({"duration": 0.0}, "duration must be above 0"),
        ({"duration": math.nan}, "duration"),
        ({"delay": 0.0}, "delay"),
        ({"delay": math.inf}, "delay must be finite"),
        ({"sample_period": -0.1}, "sample_period"),
        ({"sample_period": math.inf}, "sample_period"),
        ({"missing_time": 0.0}, "missing_time"),
        ({"good_time": math.inf}, "good_time"),
        ({"offset": math.nan}, "offset must be finite"),
        ({"scale": math.inf}, "factor must be finite"),
        ({"nan_share": 1.1}, "nan_share"),
        ({"nan_share": math.nan}, "nan_share"),
        ({"seed": -1}, "seed"),
        ({"index": -1}, "index"),
    ],
)
def test_senseless_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Fault(**({"kind": FaultKind.OFF} | settings))
