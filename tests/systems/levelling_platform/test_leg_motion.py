"""Ramps of the legs, and feet that are kept on the ground."""

import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.leg_motion import ContactKeeper, LegRamp
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, stand

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


RATE, LIMIT, PRESS, PATIENCE = 5e-4, 3e-3, 2e-5, 0.1
DESIRED = np.array((0.40, 0.41, 0.42, 0.405, 0.001, -0.002, 0.003, -0.004))
CLOSED = (1.0, 1.0, 1.0, 1.0)


def switches(contact):
    return np.concatenate([np.zeros(8), contact])


class Keeper:
    """A keeper whose inputs are fixed by the test."""

    def __init__(self, fix, contact=CLOSED, **inputs):
        self.system = ContactKeeper(RATE, LIMIT, PRESS, PATIENCE, PERIOD)
        self.context = self.system.CreateDefaultContext()
        self._fix = fix
        given = {
            "extension_desired_state": DESIRED,
            "limits": switches(contact),
            "enable": (1.0,),
        }
        self.set(**(given | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def touch(self, *contact):
        self.set(limits=switches(contact))

    def update(self, times=1):
        for _ in range(times):
            ahead = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            for group in range(ahead.num_groups()):
                self.context.SetDiscreteState(group, ahead.value(group).copy())
        return self.trim

    @property
    def trim(self):
        """Trim and its rate."""
        return self.context.get_discrete_state(0).CopyToVector()[:2]

    def _output(self, name):
        return self.system.GetOutputPort(name).Eval(self.context).copy()

    @property
    def output(self):
        return self._output("extension_trimmed_state")

    @property
    def standing(self):
        return self._output("standing").tolist()


def test_with_four_closed_switches_nothing_is_trimmed(fix):
    keeper = Keeper(fix)
    assert keeper.update(10).tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(keeper.output, DESIRED)


@pytest.mark.parametrize("contact", [(1, 0, 1, 1), (1, 1, 1, 0), (1, 0, 1, 0)])
def test_with_foot_2_or_4_in_the_air_the_passive_leg_grows_longer(fix, contact):
    trim = Keeper(fix, contact).update(7)
    np.testing.assert_allclose(trim, (-7 * PERIOD * RATE, -RATE), rtol=1e-9)


@pytest.mark.parametrize("contact", [(0, 1, 1, 1), (1, 1, 0, 1), (0, 1, 0, 1)])
def test_with_foot_1_or_3_in_the_air_the_passive_leg_grows_shorter(fix, contact):
    trim = Keeper(fix, contact).update(7)
    np.testing.assert_allclose(trim, (7 * PERIOD * RATE, RATE), rtol=1e-9)


@pytest.mark.parametrize("contact", [(0, 0, 1, 1), (0, 0, 0, 0), (1, 1, 0, 0)])
def test_feet_of_both_diagonals_in_the_air_tell_nothing(fix, contact):
    assert Keeper(fix, contact).update(5).tolist() == [0.0, 0.0]


def test_only_the_passive_leg_is_trimmed_position_and_rate_alike(fix):
    keeper = Keeper(fix, (1, 0, 1, 1))
    trim, rate = keeper.update(3)
    np.testing.assert_allclose(keeper.output - DESIRED, (0, 0, 0, trim, 0, 0, 0, rate), atol=1e-16)


@pytest.mark.parametrize(("contact", "sign"), [((1, 0, 1, 1), -1.0), ((0, 1, 1, 1), 1.0)])
def test_the_trim_goes_on_a_little_when_all_switches_have_closed_and_then_stays(
    fix, contact, sign
):
    keeper = Keeper(fix, contact)
    trim, _ = keeper.update(20)
    keeper.touch(*CLOSED)
    trims = np.array([keeper.update() for _ in range(20)])
    np.testing.assert_allclose(trims[-1], (trim + sign * PRESS, 0.0), rtol=1e-9, atol=1e-18)
    assert np.abs(trims[:, 1]).max() <= RATE * (1.0 + 1e-9)


@pytest.mark.parametrize(("contact", "sign"), [((1, 0, 1, 1), -1.0), ((0, 1, 1, 1), 1.0)])
def test_the_trim_ends_at_its_limit_with_rate_zero(fix, contact, sign):
    assert Keeper(fix, contact).update(700).tolist() == [sign * LIMIT, 0.0]


@pytest.mark.parametrize("off", [0.0, 0.5, math.nan])
def test_a_disabled_keeper_trims_nothing(fix, off):
    keeper = Keeper(fix, (1, 0, 1, 1))
    keeper.update(5)
    keeper.set(enable=(off,))
    assert keeper.update().tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(keeper.output, DESIRED)


def test_switches_at_the_ends_of_the_stroke_do_not_count(fix):
    keeper = Keeper(fix, limits=np.ones(12))
    assert keeper.update(5).tolist() == [0.0, 0.0]
    keeper.set(limits=np.concatenate([np.zeros(8), CLOSED]))
    assert keeper.update(5).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("bad", [math.nan, -math.inf, 0.5])
def test_a_switch_that_is_not_above_a_half_is_open(fix, bad):
    np.testing.assert_allclose(Keeper(fix, (1, 1, 1, bad)).update(), (-PERIOD * RATE, -RATE))


def test_what_is_not_finite_is_passed_on_and_leaves_the_trim(fix):
    asked = DESIRED.copy()
    asked[[0, 3]] = math.nan
    keeper = Keeper(fix, (1, 0, 1, 1), extension_desired_state=asked)
    trim, rate = keeper.update(2)
    assert np.isfinite((trim, rate)).all()
    assert np.isnan(keeper.output).tolist() == [True, False, False, True] + [False] * 4


@pytest.mark.parametrize("error", [-2e-3, 2e-3])
def test_a_passive_leg_of_the_wrong_length_is_brought_to_the_ground(fix, error):
    """On a platform that stands on one diagonal, whatever foot is lifted."""
    geometry, params = PlatformGeometry(foot_radius=0.025), KinematicPlatformParams()
    keeper = Keeper(fix, extension_desired_state=[0.405] * 4 + [0.0] * 4)
    opened = False
    for _ in range(1000):
        extension = keeper.output[:4] + np.array((0.0, 0.0, 0.0, error))
        force = stand(
            geometry, params, extension.tolist(), [0.0] * 4, [0.0, 0.0], [0.0, 0.0]
        ).contact_force
        contact = [f >= 5.0 for f in force]
        opened |= not all(contact)
        keeper.touch(*contact)
        keeper.update()
    assert opened
    assert all(contact)
    assert keeper.trim[0] == pytest.approx(-error, rel=0.1)


# Who stands


def test_a_foot_stands_while_its_switch_is_closed_and_a_little_longer(fix):
    keeper = Keeper(fix)
    keeper.update(3)
    keeper.touch(1, 0, 1, 1)
    stood = [keeper.standing]
    for _ in range(20):
        keeper.update()
        stood.append(keeper.standing)
    periods = round(PATIENCE / PERIOD)
    assert all(feet == [1.0] * 4 for feet in stood[:periods])
    assert all(feet == [1.0, 0.0, 1.0, 1.0] for feet in stood[periods + 1 :])
    keeper.touch(*CLOSED)
    assert keeper.standing == [1.0] * 4


@pytest.mark.parametrize("off", [0.0, math.nan])
def test_with_a_disabled_keeper_a_foot_stands_while_its_switch_is_closed_and_no_longer(fix, off):
    keeper = Keeper(fix, enable=(off,))
    keeper.update(3)
    keeper.touch(1, 0, 1, 1)
    assert keeper.standing == [1.0, 0.0, 1.0, 1.0]


def test_a_foot_that_was_in_the_air_when_the_keeper_begins_does_not_stand(fix):
    keeper = Keeper(fix, (1, 0, 1, 1), enable=(0.0,))
    keeper.update(3)
    keeper.set(enable=(1.0,))
    assert keeper.standing == [1.0, 0.0, 1.0, 1.0]
    keeper.update(3)
    assert keeper.standing == [1.0, 0.0, 1.0, 1.0]
