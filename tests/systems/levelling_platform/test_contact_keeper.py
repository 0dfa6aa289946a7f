import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.leg_motion import ContactKeeper
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, stand

PERIOD, RATE, LIMIT, PRESS, PATIENCE = 0.01, 5e-4, 3e-3, 2e-5, 0.1
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


# Prerequisites


@pytest.mark.parametrize(
    ("name", "value", "moves"),
    [
        ("extension_desired_state", DESIRED + 0.001, True),
        ("limits", switches((1, 0, 1, 1)), False),
        ("enable", (0.0,), False),
    ],
)
def test_only_what_is_desired_moves_the_trimmed_state_at_once(fix, moved, name, value, moves):
    keeper = Keeper(fix, (1, 0, 1, 0))
    keeper.update(3)
    names = moved(keeper.system, keeper.context, lambda: keeper.set(**{name: value}))
    assert ("extension_trimmed_state" in names) == moves


@pytest.mark.parametrize(
    ("name", "value"), [("limits", switches((1, 0, 1, 1))), ("enable", (0.0,))]
)
def test_switches_and_enable_move_who_stands_at_once(fix, moved, name, value):
    keeper = Keeper(fix, (1, 1, 1, 0))
    keeper.update(20)
    keeper.touch(1, 1, 0, 0)
    keeper.update()
    names = moved(keeper.system, keeper.context, lambda: keeper.set(**{name: value}))
    assert names == {"standing"}


@pytest.mark.parametrize(
    ("group", "value", "name"),
    [
        (0, (0.001, 0.0, 0.0), "extension_trimmed_state"),
        (1, (0.0, PATIENCE, 0.0, 0.0), "standing"),
    ],
)
def test_each_state_moves_its_output(fix, moved, group, value, name):
    keeper = Keeper(fix, (1, 0, 1, 1))

    def change():
        keeper.context.SetDiscreteState(group, np.array(value))

    assert moved(keeper.system, keeper.context, change) == {name}
