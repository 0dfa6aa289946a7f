import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.leg_motion import LegRamp

PERIOD = 0.01
ACCELERATION = 0.1
STEP = ACCELERATION * PERIOD
MEASURED = np.array((0.45, 0.44, 0.43, 0.42))
POSTURE = np.array((0.40, 0.41, 0.42, 0.405, 0.001, -0.002, 0.003, -0.004))


class Ramp:
    """A ramp whose inputs are fixed by the test."""

    def __init__(self, fix, **inputs):
        self.system = LegRamp(ACCELERATION, PERIOD)
        self.context = self.system.CreateDefaultContext()
        self._fix = fix
        given = {
            "leg_rate": np.zeros(4),
            "extension": MEASURED,
            "posture_extension_state": POSTURE,
            "posture_control": (0.0,),
            "enable": (1.0,),
        }
        self.set(**(given | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def update(self, times=1):
        for _ in range(times):
            ahead = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            self.context.SetDiscreteState(ahead.value(0).copy())
        return self.desired

    @property
    def desired(self):
        return self.system.get_output_port().Eval(self.context).copy()


@pytest.fixture
def ramp(fix):
    """A ramp at rest that has started."""
    ramp = Ramp(fix)
    ramp.update()
    return ramp


def test_before_it_starts_the_legs_are_asked_to_be_where_they_are(fix):
    np.testing.assert_array_equal(Ramp(fix).desired, [*MEASURED, 0, 0, 0, 0])


def test_it_starts_where_the_legs_are_and_then_looks_at_them_no_more(ramp):
    ramp.set(extension=MEASURED + 0.01)
    np.testing.assert_array_equal(ramp.update(10), [*MEASURED, 0, 0, 0, 0])


def test_rates_approach_the_wanted_ones_with_the_acceleration(ramp):
    ramp.set(leg_rate=(0.003, -0.003, 0.0005, 0.0))
    for k in range(1, 6):
        rates = ramp.update()[4:]
        expected = np.clip((0.003, -0.003, 0.0005, 0.0), -k * STEP, k * STEP)
        np.testing.assert_allclose(rates, expected, rtol=1e-12)


def test_positions_are_the_integral_of_the_rates(ramp):
    ramp.set(leg_rate=(0.003, -0.006, 0.001, 0.0))
    rates = [np.zeros(4)]
    for _ in range(50):
        desired = ramp.update()
        rates.append(desired[4:])
    travelled = PERIOD * (np.sum(rates, axis=0) - 0.5 * rates[-1])
    np.testing.assert_allclose(desired[:4] - MEASURED, travelled, rtol=0, atol=1e-14)


def test_a_leg_comes_to_rest_with_the_same_acceleration(ramp):
    ramp.set(leg_rate=np.full(4, 0.006))
    ramp.update(20)
    ramp.set(leg_rate=np.zeros(4))
    rates = [ramp.update()[4] for _ in range(7)]
    np.testing.assert_allclose(rates, np.maximum(0.006 - STEP * np.arange(1, 8), 0.0), atol=1e-17)


def test_a_posture_is_followed_at_once_and_as_it_is(ramp):
    ramp.set(posture_control=(1.0,))
    np.testing.assert_array_equal(ramp.desired, POSTURE)


def test_after_a_posture_the_ramp_goes_on_from_there(ramp):
    ramp.set(posture_control=(1.0,))
    ramp.update()
    ramp.set(posture_control=(0.0,))
    np.testing.assert_array_equal(ramp.desired, POSTURE)
    rates = np.sign(POSTURE[4:]) * np.maximum(np.abs(POSTURE[4:]) - STEP, 0.0)
    way = 0.5 * PERIOD * (POSTURE[4:] + rates)
    np.testing.assert_allclose(ramp.update(), [*(POSTURE[:4] + way), *rates], rtol=1e-12)


def test_a_disabled_ramp_stays_with_the_legs(ramp):
    ramp.set(leg_rate=np.full(4, 0.006))
    ramp.update(20)
    ramp.set(enable=(0.0,), extension=MEASURED - 0.02)
    np.testing.assert_array_equal(ramp.update(), [*(MEASURED - 0.02), 0, 0, 0, 0])
    ramp.set(extension=MEASURED - 0.03)
    np.testing.assert_array_equal(ramp.update(), [*(MEASURED - 0.03), 0, 0, 0, 0])
    ramp.set(enable=(1.0,))
    assert ramp.desired[0] == MEASURED[0] - 0.03
    assert ramp.update()[4] == pytest.approx(STEP)


@pytest.mark.parametrize("off", [0.0, 0.5, math.nan])
def test_what_is_not_above_a_half_is_off(ramp, off):
    ramp.set(posture_control=(off,))
    np.testing.assert_array_equal(ramp.desired[:4], MEASURED)
    ramp.set(enable=(off,), extension=MEASURED - 0.02)
    np.testing.assert_array_equal(ramp.update()[:4], MEASURED - 0.02)


# Bad input


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("element", [1, 5])
def test_a_posture_that_is_not_finite_is_passed_on_and_the_ramp_keeps_that_leg(ramp, bad, element):
    asked = POSTURE.copy()
    asked[element] = bad
    ramp.set(posture_control=(1.0,), posture_extension_state=asked)
    np.testing.assert_array_equal(ramp.update(), asked)
    ramp.set(posture_control=(0.0,))
    kept = ramp.desired
    assert (kept[1], kept[5]) == (MEASURED[1], 0.0)
    np.testing.assert_array_equal(np.delete(kept, (1, 5)), np.delete(POSTURE, (1, 5)))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_it_does_not_start_before_every_leg_is_measured(fix, bad):
    ramp = Ramp(fix, extension=(bad, *MEASURED[1:]), leg_rate=np.full(4, 0.001))
    ramp.update(5)
    assert not np.isfinite(ramp.desired[0])
    ramp.set(extension=MEASURED)
    np.testing.assert_array_equal(ramp.update(), [*MEASURED, 0, 0, 0, 0])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_wanted_rate_that_is_not_finite_counts_as_zero(ramp, bad):
    ramp.set(leg_rate=np.full(4, 0.003))
    ramp.update(10)
    ramp.set(leg_rate=(0.003, bad, 0.003, 0.003))
    np.testing.assert_allclose(ramp.update(10)[4:], (0.003, 0.0, 0.003, 0.003), atol=1e-17)


# Prerequisites


@pytest.mark.parametrize(
    ("name", "value", "moves"),
    [
        ("posture_control", (1.0,), True),
        ("leg_rate", np.full(4, 0.003), False),
        ("extension", MEASURED + 0.001, False),
        ("posture_extension_state", POSTURE + 0.001, False),
        ("enable", (0.0,), False),
    ],
)
def test_a_started_ramp_moves_at_once_for_posture_control_only(fix, moved, name, value, moves):
    ramp = Ramp(fix)
    ramp.update()
    names = moved(ramp.system, ramp.context, lambda: ramp.set(**{name: value}))
    assert names == ({"extension_desired_state"} if moves else set())


@pytest.mark.parametrize(
    ("control", "name", "value"),
    [
        (0.0, "extension", MEASURED + 0.001),
        (1.0, "posture_extension_state", POSTURE + 0.001),
    ],
)
def test_what_is_passed_on_moves_the_output(fix, moved, control, name, value):
    ramp = Ramp(fix, posture_control=(control,))
    names = moved(ramp.system, ramp.context, lambda: ramp.set(**{name: value}))
    assert names == {"extension_desired_state"}


def test_the_state_moves_the_output(ramp, moved):
    def change():
        state = ramp.context.get_discrete_state_vector().CopyToVector()
        ramp.context.SetDiscreteState(state + np.append(np.full(8, 0.001), 0.0))

    assert moved(ramp.system, ramp.context, change) == {"extension_desired_state"}
