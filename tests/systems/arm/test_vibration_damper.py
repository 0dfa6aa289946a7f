"""Damper of a rod by its base: energy of the modes falls, as fast as it is designed for."""

import math

import numpy as np
import pytest

from parapod.systems.arm.vibration import LumpedRod, VibrationDamper
from parapod.systems.core.triples import cross, dot, plus
from parapod.systems.levelling_platform.statics import PAPER_ARM

PERIOD = 0.01
ROD = LumpedRod(1.9, (14.0, 12.0), 0.005)
HEIGHT = 0.48
LEAN, TURN = (0.0, 1.0), (1.0, 0.0)


class Rig:
    """Lumped modes on a base that inclines as it is asked to, about the ground under it."""

    def __init__(self, stand, damping=0.2, is_damped=True):
        self.system = VibrationDamper(ROD, PAPER_ARM, PERIOD, damping)
        self.shown = stand(self.system)
        self.is_damped = is_damped
        self.modes, self.inclination = np.zeros((2, 2)), np.zeros(2)
        self.places = None

    def step(self, position, measured=None, **inputs):
        """A period later; the joints' encoders show where they are now a period late."""
        displacement = self.shown.set(
            arm_position=position if measured is None else measured,
            posture=[*self.inclination, HEIGHT],
            posture_desired_state=[0.0, 0.0, HEIGHT, 0.0, 0.0, 0.0],
            fed_forward=inputs.pop("fed_forward", np.zeros(4)),
            enable=inputs.pop("enable", 1.0),
        )["displacement"]
        places, rows = [], []
        for place, axis in ROD.places(PAPER_ARM, list(position)):
            over = plus(place, (0.0, 0.0, HEIGHT))
            rows.append(cross(over, axis)[:2])
            places.append(np.array(plus(over, cross((*self.inclination, 0.0), over))))
            self.axis = axis
        axes = [axis for _, axis in ROD.places(PAPER_ARM, list(position))]
        if self.places is None:
            self.places = [places] * 2
        last, before = self.places
        for plane, axis in enumerate(axes):
            change = places[plane] - 2.0 * last[plane] + before[plane]
            load = -dot(axis, change) / PERIOD**2
            omega = ROD.frequencies[plane]
            for _ in range(20):  # short steps, by halves
                x, v = self.modes[plane]
                v += 0.05 * PERIOD * (load - omega**2 * x)
                self.modes[plane] = x + 0.05 * PERIOD * v, v
        self.places = [places, last]
        self.shown.tick()
        if self.is_damped:
            self.inclination = np.linalg.solve(rows, displacement[:2])
        return displacement

    def energies(self):
        return [
            v**2 + (omega * x) ** 2
            for (x, v), omega in zip(self.modes, ROD.frequencies, strict=True)
        ]


def swung(rig, axis, seconds=2.0):
    """Energies (k, 2) after a short jerk of the arm, at the ends of whole vibrations."""
    positions = [0.2 * np.clip(k / 12.0, 0.0, 1.0) * np.array(axis) for k in range(12)]
    base = np.array((0.0, 0.5 if axis is TURN else 0.0))
    for position in positions:
        rig.step(base + position)
    energies = []
    for _ in range(round(seconds / PERIOD)):
        rig.step(base + 0.2 * np.array(axis))
        energies.append(rig.energies())
    return np.array(energies)


@pytest.mark.parametrize(("axis", "plane"), [(LEAN, 0), (TURN, 1)])
def test_energy_falls_by_the_damping_that_is_added(stand, axis, plane):
    free, damped = (swung(Rig(stand, is_damped=on), axis)[:, plane] for on in (False, True))
    assert free[-1] > 0.7 * free[0]
    omega = ROD.frequencies[plane]
    k = round(2.0 * math.pi / (omega * PERIOD))  # a vibration
    ratio = math.log(damped[k] / damped[2 * k]) / (2.0 * omega * k * PERIOD)
    assert 0.12 < ratio < 0.3
    assert damped[-1] < 1e-2 * free[-1]


def test_more_damping_ends_sooner(stand):
    soft, hard = (swung(Rig(stand, damping), LEAN, 1.0)[-1, 0] for damping in (0.05, 0.2))
    assert hard < 0.2 * soft


def test_it_waits_while_a_feedforward_acts_and_then_sets_in(stand):
    rig = Rig(stand, is_damped=False)
    swung(rig, LEAN, 0.3)
    position = 0.2 * np.array(LEAN)
    waiting = [rig.step(position, fed_forward=np.full(4, 1e-3)) for _ in range(30)]
    assert np.abs(np.diff(np.array(waiting)[:, 0])).max() < 0.3 * np.abs(waiting[0][0]) + 0.02
    assert not np.array(waiting[12:]).any()
    after = np.abs([rig.step(position)[0] for _ in range(40)])
    # Little at first, and then as far as the vibration asks for.
    assert 0.0 < after[1:4].max() < 0.5 * after.max()


def test_a_base_at_rest_and_a_disabled_damper_ask_for_nothing(stand):
    rig = Rig(stand)
    assert not np.array([rig.step(np.array((0.3, 0.4))) for _ in range(50)]).any()
    rig = Rig(stand, is_damped=False)
    swung(rig, LEAN, 0.3)
    position = 0.2 * np.array(LEAN)
    off = [rig.step(position, enable=0.0) for _ in range(5)]
    assert not np.array(off[1:]).any()
    # Enabled anew it takes the modes to be at rest.
    assert not np.array([rig.step(position) for _ in range(20)]).any()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_finite_ends_the_observation(stand, bad):
    rig = Rig(stand, is_damped=False)
    swung(rig, LEAN, 0.3)
    position = 0.2 * np.array(LEAN)
    rig.step(position, measured=[0.0, bad])
    assert not np.array([rig.step(position) for _ in range(20)]).any()
