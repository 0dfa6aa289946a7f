"""Each kind of fault against its definition, and promises that hold for all of them."""

import math

import numpy as np
import pytest

from parapod.systems.safety.faults import Fault, FaultInjector, FaultKind

PERIOD = 0.01
COUNTING = np.arange(10.0, 20.0)  # sample k is 10 + k
FRESH = [0] * 10
# Acts on the samples 3 to 6.
WINDOW = {"begin": 0.03, "duration": 0.04}
EVERY_KIND = [
    Fault(FaultKind.OFF, **WINDOW),
    Fault(FaultKind.STUCK, **WINDOW),
    Fault(FaultKind.GARBAGE, **WINDOW),
    Fault(FaultKind.WRONG, **WINDOW),
    Fault(FaultKind.SLOW, sample_period=0.02, **WINDOW),
    Fault(FaultKind.DELAYED, delay=0.02, **WINDOW),
    Fault(FaultKind.INTERMITTENT, missing_time=0.02, good_time=0.01, **WINDOW),
]
KINDS = [fault.kind.value for fault in EVERY_KIND]


def play(injector, samples, context=None):
    """Samples (count, n) as they are shown, the ages in periods (count), the latch (count)."""
    context = injector.CreateDefaultContext() if context is None else context
    samples = np.asarray(samples, dtype=float).reshape(len(samples), -1)
    outputs = [injector.GetOutputPort(name) for name in ("faulted", "extra_age", "changed")]
    shown = []
    for k, sample in enumerate(samples):
        context.SetTime(k * PERIOD)
        injector.GetInputPort("signal").FixValue(context, sample)
        before = [port.Eval(context) for port in outputs]
        context.SetDiscreteState(injector.EvalUniquePeriodicDiscreteUpdate(context))
        shown.append([port.Eval(context) for port in outputs])
        # Whoever reads at this instant gets the same, before and after the instant's updates.
        np.testing.assert_array_equal(before[0], shown[-1][0])
        np.testing.assert_array_equal(before[1], shown[-1][1])
    values, ages, latch = (np.array(column) for column in zip(*shown, strict=True))
    return values, ages[:, 0] / PERIOD, latch[:, 0]


def shown_of(fault, samples=COUNTING, **settings):
    shown, ages, _ = play(FaultInjector(1, [fault], PERIOD, **settings), samples)
    return shown[:, 0], ages


def values_at(injector, time, signal=0.0, context=None):
    """Values that are shown of a signal at a time, without an update."""
    context = injector.CreateDefaultContext() if context is None else context
    injector.GetInputPort("signal").FixValue(context, np.full(injector.size, signal))
    context.SetTime(time)
    return injector.GetOutputPort("faulted").Eval(context).tolist()


def assert_shows(fault, values, ages, **settings):
    """Samples 10, 11, ... are shown as these values, older by these ages in periods."""
    shown, found = shown_of(fault, COUNTING[: len(values)], **settings)
    np.testing.assert_array_equal(shown, values)
    np.testing.assert_allclose(found, ages, atol=1e-9)


# The kinds, one after the other


@pytest.mark.parametrize(
    ("fault", "values", "ages"),
    [
        (
            Fault(FaultKind.OFF, **WINDOW),
            [10, 11, 12, 0, 0, 0, 0, 17, 18, 19],
            [0, 0, 0, 1, 2, 3, 4, 0, 0, 0],
        ),
        # From the start it is a period old at once.
        (Fault(FaultKind.OFF), [0, 0, 0], [1, 2, 3]),
        (
            Fault(FaultKind.STUCK, **WINDOW),
            [10, 11, 12, 12, 12, 12, 12, 17, 18, 19],
            FRESH,
        ),
        (Fault(FaultKind.STUCK), [10, 10, 10], FRESH[:3]),
        (
            Fault(FaultKind.WRONG, scale=2.0, offset=1.0, **WINDOW),
            [10, 11, 12, 27, 29, 31, 33, 17, 18, 19],
            FRESH,
        ),
        # It turns the sign unless more is said.
        (
            Fault(FaultKind.WRONG, **WINDOW),
            [10, 11, 12, -13, -14, -15, -16, 17, 18, 19],
            FRESH,
        ),
        (
            Fault(
                FaultKind.INTERMITTENT,
                begin=0.03,
                duration=0.06,
                missing_time=0.02,
                good_time=0.01,
            ),
            [10, 11, 12, 0, 0, 15, 0, 0, 18, 19],
            [0, 0, 0, 1, 2, 0, 1, 2, 0, 0],
        ),
        (Fault(FaultKind.DELAYED, delay=0.03), [10, 10, 10, 10, 11], [0, 1, 2, 3, 3]),
    ],
    ids=lambda value: value.kind.value if isinstance(value, Fault) else "",
)
def test_each_kind_shows_its_values_and_ages(fault, values, ages):
    assert_shows(fault, values, ages)


def test_the_off_value_can_be_another_one_for_each_element():
    shown, _, _ = play(
        FaultInjector(2, [Fault(FaultKind.OFF)], off_value=(3.0, math.nan)), np.ones((2, 2))
    )
    np.testing.assert_array_equal(shown, [[3.0, math.nan]] * 2)


def test_stuck_holds_for_longer_than_samples_are_kept():
    injector = FaultInjector(1, [Fault(FaultKind.STUCK, begin=0.03)], PERIOD, longest_delay=0.02)
    shown, _, _ = play(injector, np.arange(500.0))
    assert set(shown[3:, 0]) == {2.0}


def test_wrong_inverts_a_binary_signal():
    shown, _ = shown_of(Fault(FaultKind.WRONG), [0.0, 1.0, 0.5, 0.51, math.nan], is_binary=True)
    np.testing.assert_array_equal(shown, [1.0, 0.0, 1.0, 0.0, math.nan])


@pytest.mark.parametrize(
    ("sample_period", "values", "ages"),
    [
        (0.02, [13, 13, 15, 15], [0, 1, 0, 1]),
        (0.025, [13, 13, 13, 16], [0, 1, 2, 0]),
        (1.0, [13, 13, 13, 13], [0, 1, 2, 3]),
        (0.01, [13, 14, 15, 16], [0, 0, 0, 0]),
        (0.001, [13, 14, 15, 16], [0, 0, 0, 0]),
    ],
)
def test_slow_shows_one_sample_a_period(sample_period, values, ages):
    assert_shows(
        Fault(FaultKind.SLOW, sample_period=sample_period, **WINDOW),
        [10, 11, 12, *values, 17, 18, 19],
        [0, 0, 0, *ages, 0, 0, 0],
    )


@pytest.mark.parametrize(
    ("delay", "values", "ages"),
    [
        (0.01, [12, 13, 14, 15], [1, 1, 1, 1]),
        (0.02, [11, 12, 13, 14], [2, 2, 2, 2]),
        (0.015, [11, 12, 13, 14], [2, 2, 2, 2]),
        (0.05, [10, 10, 10, 11], [3, 4, 5, 5]),
    ],
)
def test_delayed_shows_what_was_a_while_ago_or_the_oldest_there_is(delay, values, ages):
    assert_shows(
        Fault(FaultKind.DELAYED, delay=delay, **WINDOW),
        [10, 11, 12, *values, 17, 18, 19],
        [0, 0, 0, *ages, 0, 0, 0],
    )


def test_the_longest_delay_is_kept():
    fault = Fault(FaultKind.DELAYED, begin=2.0, delay=1.0)
    shown, ages = shown_of(fault, np.arange(300.0))
    np.testing.assert_array_equal(shown[200:], np.arange(100.0, 200.0))
    np.testing.assert_allclose(ages[200:], 100.0)


def test_garbage_is_another_value_of_the_span_in_each_sample_and_element():
    injector = FaultInjector(3, [Fault(FaultKind.GARBAGE)], span=((0.0, -5.0, 2.0), (1.0, 5.0, 2)))
    shown, ages, _ = play(injector, np.zeros((1000, 3)))
    assert len(np.unique(shown[:, :2])) == 2000
    np.testing.assert_array_equal(shown[:, 2], 2.0)
    # Uniform: mean and deviation, of which 1000 samples know 3 %.
    np.testing.assert_allclose(shown.mean(axis=0), [0.5, 0.0, 2.0], atol=0.2)
    np.testing.assert_allclose(shown.std(axis=0), np.array([1, 10, 0]) / math.sqrt(12), rtol=0.07)
    assert (shown >= [0.0, -5.0, 2.0]).all()
    assert (shown <= [1.0, 5.0, 2.0]).all()
    assert not ages.any()


def test_garbage_of_a_binary_signal_is_0_or_1():
    shown, _ = shown_of(Fault(FaultKind.GARBAGE), np.zeros(300), is_binary=True)
    assert set(shown) == {0.0, 1.0}
    assert shown.mean() == pytest.approx(0.5, abs=0.1)


def test_a_share_of_garbage_is_nan():
    shown, _ = shown_of(Fault(FaultKind.GARBAGE, nan_share=0.25), np.zeros(1000))
    assert np.isnan(shown).mean() == pytest.approx(0.25, abs=0.04)
    assert not np.isnan(shown_of(Fault(FaultKind.GARBAGE), np.zeros(500))[0]).any()
    assert np.isnan(shown_of(Fault(FaultKind.GARBAGE, nan_share=1.0), np.zeros(5))[0]).all()


# When and where


@pytest.mark.parametrize("fault", EVERY_KIND, ids=KINDS)
def test_a_fault_changes_its_element_in_its_time_and_nothing_else(fault):
    samples = np.random.default_rng(0).normal(size=(10, 3))
    only_second = Fault(**(vars(fault) | {"index": 1}))
    shown, _, _ = play(FaultInjector(3, [only_second]), samples)
    changed = shown != samples
    assert changed[3:7, 1].any()
    changed[3:7, 1] = False
    assert not changed.any()


def test_a_fault_between_samples_begins_and_ends_with_the_next_one():
    injector = FaultInjector(1, [Fault(FaultKind.WRONG, begin=0.025, duration=0.02)])
    times = (0.025, 0.0299, 0.03, 0.0455, 0.0499, 0.05, math.nan, math.inf, -math.inf)
    shown = [values_at(injector, time, 1.0)[0] for time in times]
    assert shown == [1.0, 1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0]


def test_faults_of_several_elements_and_times_act_beside_each_other():
    faults = [
        Fault(FaultKind.OFF, 0, begin=0.01, duration=0.02),
        Fault(FaultKind.STUCK, 1, begin=0.02),
        Fault(FaultKind.WRONG, 0, begin=0.04),
    ]
    shown, ages, _ = play(FaultInjector(2, faults), np.arange(1.0, 6.0).repeat(2).reshape(5, 2))
    np.testing.assert_array_equal(shown, [[1, 1], [0, 2], [0, 2], [4, 2], [-5, 2]])
    np.testing.assert_allclose(ages, [0, 1, 2, 0, 0])


def test_the_last_of_several_faults_of_an_element_counts():
    off, wrong = Fault(FaultKind.OFF), Fault(FaultKind.WRONG, 0)
    for faults, value, age in (([off, wrong], [-7.0, 0.0], 1), ([wrong, off], [0.0, 0.0], 1)):
        shown, ages, _ = play(FaultInjector(2, faults), [[7.0, 8.0]])
        np.testing.assert_array_equal(shown, [value])
        np.testing.assert_allclose(ages, age)
    _, ages, _ = play(FaultInjector(1, [off, wrong]), [[7.0]])
    np.testing.assert_array_equal(ages, [0])


def test_the_age_is_that_of_the_oldest_element():
    faults = [Fault(FaultKind.DELAYED, 0, delay=0.01), Fault(FaultKind.DELAYED, 1, delay=0.03)]
    _, ages, _ = play(FaultInjector(3, faults), np.zeros((6, 3)))
    np.testing.assert_allclose(ages, [0, 1, 2, 3, 3, 3])


# The latch


@pytest.mark.parametrize("fault", EVERY_KIND, ids=KINDS)
def test_changed_rises_with_the_first_sample_that_differs_and_stays(fault):
    shown, _, latch = play(FaultInjector(1, [fault]), COUNTING)
    first = np.flatnonzero(shown[:, 0] != COUNTING)[0]
    np.testing.assert_array_equal(latch, np.arange(10) >= first)


def test_a_fault_that_makes_no_difference_is_not_said_to_have_changed_anything():
    for kind in ("off", "stuck", "slow", "delayed", "intermittent"):
        injector = FaultInjector(1, [Fault(kind)], off_value=5.0)
        assert not play(injector, np.full(10, 5.0))[2].any()
    # Nor is NaN in place of NaN a change.
    assert not play(FaultInjector(1, [Fault(FaultKind.WRONG)]), np.full(5, math.nan))[2].any()


# Without a fault


@pytest.mark.parametrize("faults", [[], [Fault(FaultKind.OFF, begin=5.0)]])
def test_without_an_active_fault_every_bit_passes(faults):
    injector = FaultInjector(6, faults)
    context = injector.CreateDefaultContext()
    odd = np.array([-0.0, math.nan, math.inf, -math.inf, 5e-324, 0.1])
    injector.GetInputPort("signal").FixValue(context, odd)
    for time in (0.0, 0.0137, 4.9999):
        context.SetTime(time)
        assert injector.GetOutputPort("faulted").Eval(context).tobytes() == odd.tobytes()
        assert injector.GetOutputPort("extra_age").Eval(context) == [0.0]
        assert injector.GetOutputPort("changed").Eval(context) == [0.0]


# Seeds and contexts


def test_garbage_follows_from_its_seed_and_stays_between_two_samples():
    runs = [
        shown_of(Fault(FaultKind.GARBAGE, seed=seed), np.zeros(50))[0] for seed in (3, 3, 4, 0)
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not set(runs[0]) & set(runs[2])
    assert not set(runs[0]) & set(runs[3])
    injector = FaultInjector(1, [Fault(FaultKind.GARBAGE)])
    values = [values_at(injector, time)[0] for time in (0.01, 0.0137, 0.0199, 0.02)]
    assert values[0] == values[1] == values[2] != values[3]


@pytest.mark.parametrize("fault", EVERY_KIND, ids=KINDS)
def test_a_context_at_its_defaults_begins_anew_with_the_faults_that_are_built_in_or_set(fault):
    injector = FaultInjector(1, [fault])
    context = injector.CreateDefaultContext()
    built = play(injector, COUNTING, context)
    # One cell of a campaign after another.
    for previous in EVERY_KIND:
        injector.SetDefaultContext(context)
        injector.set_faults(context, [previous])
        play(injector, COUNTING, context)
    injector.SetDefaultContext(context)
    np.testing.assert_array_equal(play(injector, COUNTING, context)[0], built[0])
    bare = FaultInjector(1)
    context = bare.CreateDefaultContext()
    play(bare, COUNTING, context)
    bare.SetDefaultContext(context)
    bare.set_faults(context, [fault])
    for expected, found in zip(built, play(bare, COUNTING, context), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_faults_can_be_set_in_the_middle_of_a_run_of_one_context():
    injector = FaultInjector(1, [Fault(FaultKind.OFF)])
    context = injector.CreateDefaultContext()
    play(injector, COUNTING, context)
    changed = injector.GetOutputPort("changed")
    assert changed.Eval(context) == [1.0]
    other = context.Clone()
    injector.set_faults(context, [Fault(FaultKind.STUCK)])
    assert (changed.Eval(context), changed.Eval(other)) == ([0.0], [1.0])
    assert values_at(injector, 0.1, 33.0, context) == [19.0]
    injector.set_faults(context, [Fault(FaultKind.DELAYED, delay=0.04)])
    assert values_at(injector, 0.1, 33.0, context) == [16.0]
    injector.set_faults(context, [])
    assert values_at(injector, 0.1, 33.0, context) == [33.0]
    assert values_at(injector, 0.1, 33.0, other) == [0.0]


# Bad input


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_bad_input_passes_is_held_and_delayed_like_any_other(value):
    samples = [1.0, value, 3.0, 4.0, 5.0]
    cases = {
        FaultKind.STUCK: ([1.0, value, value, value, value], {}),
        FaultKind.WRONG: ([1.0, value, -3.0, -4.0, -5.0], {}),
        FaultKind.DELAYED: ([1.0, value, value, 3.0, 4.0], {"delay": 0.01}),
        FaultKind.OFF: ([1.0, value, 0.0, 0.0, 0.0], {}),
    }
    for kind, (expected, settings) in cases.items():
        shown, _ = shown_of(Fault(kind, begin=0.02, **settings), samples)
        np.testing.assert_array_equal(shown, expected)
    shown, _ = shown_of(Fault(FaultKind.WRONG), [value])
    np.testing.assert_array_equal(shown, [-value])


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault(FaultKind.OFF, 2), "index must be in 0..1 or None, not 2"),
        (Fault(FaultKind.DELAYED, delay=1.5), "delay must be up to longest_delay, 1.0, not 1.5"),
        (Fault(FaultKind.INTERMITTENT, good_time=0.004), "a period, 0.01, or more, not 0.004"),
    ],
)
def test_a_fault_that_does_not_fit_is_refused_and_the_context_stays(fault, message):
    with pytest.raises(ValueError, match=message):
        FaultInjector(2, [fault])
    injector = FaultInjector(2, [Fault(FaultKind.OFF)], off_value=7.0)
    context = injector.CreateDefaultContext()
    with pytest.raises(ValueError, match=message):
        injector.set_faults(context, [fault])
    assert values_at(injector, 0.0, 1.0, context) == [7.0, 7.0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"period": 0.0}, "period"),
        ({"period": math.nan}, "period"),
        ({"span": (1.0, 0.0)}, "span"),
        ({"span": (0.0, math.inf)}, "span"),
        ({"off_value": (1.0, 2.0, 3.0)}, "broadcast"),
    ],
)
def test_senseless_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        FaultInjector(2, **settings)
