"""Steps of a rod's modes, its tip and wrench, beside Newton's law of its points of mass."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import ClampMotion, RodMotion, Tip
from parapod.systems.core.physics import GRAVITY

ROD = FlexibleRod(bending_stiffness=(430.0, 300.0))
UNDAMPED = replace(ROD, damping_ratio=0.0)
PERIOD = 1e-3


def leaning(lean, aside=0.0):
    return (GRAVITY * math.sin(lean), aside, GRAVITY * math.cos(lean))


class Swing:
    """A clamp that moves along and about all axes, in closed form."""

    def __init__(self, size=1.0):
        self.size = size

    def angles(self, t):
        s = self.size
        return np.array([0.5 * s * np.sin(2 * t), 0.7 * s * np.sin(1.3 * t), s * np.cos(1.7 * t)])

    def place(self, t):
        return self.size * np.array([0.2 * np.sin(3 * t), 0.1 * np.cos(2 * t), 0.05 * np.sin(t)])

    def rotation(self, t):
        return RollPitchYaw(self.angles(t)).ToRotationMatrix().matrix()

    def motion(self, t, h=1e-4):
        rotation = self.rotation(t)
        rates = (self.angles(t + h) - self.angles(t - h)) / (2 * h)
        second = (self.angles(t + h) - 2 * self.angles(t) + self.angles(t - h)) / h**2
        rpy = RollPitchYaw(self.angles(t))
        turning = rpy.CalcAngularVelocityInParentFromRpyDt(rates)
        spinning = rpy.CalcAngularVelocityInParentFromRpyDt(second)  # and what the rates change
        later, earlier = (RollPitchYaw(self.angles(t + d)) for d in (h, -h))
        spinning = spinning + (
            later.CalcAngularVelocityInParentFromRpyDt(rates)
            - earlier.CalcAngularVelocityInParentFromRpyDt(rates)
        ) / (2 * h)
        force = (self.place(t + h) - 2 * self.place(t) + self.place(t - h)) / h**2
        force = force + np.array([0.0, 0.0, GRAVITY])
        parts = (rotation.T @ part for part in (force, turning, spinning))
        return ClampMotion(*(tuple(part.tolist()) for part in parts))


def points_of(rod, q):
    """Masses (n) of a bent rod, their places (n, 3), derivatives of these by q (n, 2, modes)."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    z = 0.5 * rod.length * (1 + nodes)
    masses = np.append(0.5 * rod.mass * weights, rod.tip_mass)
    places = np.append(z, rod.length)
    shape = rod.shape(places)
    shortening = np.empty((places.size, rod.modes, rod.modes))
    for i, end in enumerate(places):
        slopes = rod.slope(0.5 * end * (1 + nodes))
        shortening[i] = (slopes * (0.5 * end * weights)[:, None]).T @ slopes
    planes = q.reshape(2, rod.modes)
    aside = planes @ shape.T
    short = 0.5 * np.einsum("pi,nij,pj->n", planes, shortening, planes)
    by_q = -np.einsum("nij,pj->npi", shortening, planes)
    return masses, np.stack([aside[0], aside[1], places - short], axis=-1), shape, by_q


def newton(rod, q_of, clamp, t, h=2e-4):
    """Wrench on the clamp [moment, force] and loads (2, modes) of the modes, by differences."""
    world = []
    for time in (t - h, t, t + h):
        masses, places, shape, by_q = points_of(rod, q_of(time))
        world.append(clamp.place(time) + places @ clamp.rotation(time).T)
    _, places, shape, by_q = points_of(rod, q_of(t))
    acceleration = (world[0] - 2 * world[1] + world[2]) / h**2 + [0.0, 0.0, GRAVITY]
    acceleration = acceleration @ clamp.rotation(t)
    force = -masses @ acceleration
    moment = -masses @ np.cross(places, acceleration)
    inertial = masses[:, None] * acceleration
    loads = [-inertial[:, plane] @ shape - inertial[:, 2] @ by_q[:, plane] for plane in range(2)]
    return moment, force, np.array(loads)


def test_modes_and_wrench_obey_newtons_law_of_the_points_of_mass():
    rod, clamp, t = UNDAMPED, Swing(), 0.8
    motion, system = clamp.motion(t), RodMotion(rod, PERIOD)
    random = np.random.default_rng(3)
    places, rates = random.standard_normal((2, 4))
    left = []
    for scale in (1e-4, 1e-5):
        q, rate = scale * places, 10.0 * scale * rates
        state = [*q.tolist(), *rate.tolist()]
        second = second_derivative(system, state, motion)

        def q_of(time, q=q, rate=rate, second=second):
            return q + (time - t) * rate + 0.5 * (time - t) ** 2 * second

        moment, force, loads = newton(rod, q_of, clamp, t)
        wrench = system.bending_wrench(state, motion), system.rigid_wrench(motion)
        ours = np.add(np.concatenate(wrench[0]), np.concatenate(wrench[1]))
        elastic = (rod.frequencies**2).ravel() * q
        law = np.concatenate([moment, force, loads.ravel()])
        left.append(np.concatenate([ours, elastic]) - law)
    # Differences leave some 1e-5. Of what the deflection does, up to 14 N m, what is left is of
    # second order, and shrinks with it.
    assert np.abs(left[1]).max() < 5e-5
    assert np.abs(left[0] - left[1]).max() < 5e-4


def second_derivative(system, state, motion, h=1e-6):
    """Second derivatives (2n) of the coordinates, from two steps of a system of short period."""
    fine = RodMotion(system.rod, h)
    half = len(state) // 2
    ahead = fine.step(state, motion)
    return (np.array(ahead[half:]) - state[half:]) / h


@pytest.mark.parametrize("lean", [0.0, 0.8, 1.5, 3.0])
@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_energy_of_an_undamped_rod_stays(lean, period):
    system, force = RodMotion(UNDAMPED, period), leaning(lean, 0.4)
    rest = system.rest(force)
    state = list(rest)
    state[0], state[1], state[2], state[5] = state[0] + 0.1, 0.002, 0.05, 0.02
    motion = ClampMotion(force)
    lowest = system.energy(rest, force)
    start = system.energy(state, force) - lowest
    for _ in range(round(100.0 / period)):
        state = system.step(state, motion)
    assert system.energy(state, force) - lowest == pytest.approx(start, rel=1e-6)


def test_a_step_is_as_two_of_half_its_length():
    force = leaning(0.7, 0.2)
    whole, half = RodMotion(ROD, 0.01), RodMotion(ROD, 0.005)
    state = [0.05, 0.001, 0.02, 0.0, 0.1, 0.2, -0.3, 0.1]
    motion = ClampMotion(force, spinning=(0.3, -0.4, 0.0))
    twice = half.step(half.step(state, motion), motion)
    np.testing.assert_allclose(whole.step(state, motion), twice, rtol=1e-9, atol=1e-13)


def test_half_a_step_in_an_assumed_motion_is_corrected_by_what_it_was():
    force = leaning(0.7, 0.2)
    whole, half = RodMotion(ROD, 0.01), RodMotion(ROD, 0.005)
    state = [0.05, 0.001, 0.02, 0.0, 0.1, 0.2, -0.3, 0.1]
    assumed = ClampMotion(force)
    motion = ClampMotion((force[0] + 0.3, force[1] - 0.2, force[2]), spinning=(0.5, -0.4, 0.0))
    right = half.step(state, motion)
    wrong = half.step(state, assumed)
    left = np.subtract(whole.corrected(wrong, motion, assumed), right)
    assert np.abs(left).max() < 1e-3 * np.abs(np.subtract(wrong, right)).max()


def test_rest_stays_at_rest_and_is_the_sag():
    force = leaning(1.1, -2.0)
    system = RodMotion(ROD, PERIOD)
    rest = system.rest(force)
    np.testing.assert_allclose(system.step(rest, ClampMotion(force)), rest, atol=1e-12)
    tip = system.tip(rest, ClampMotion(force))
    in_x, in_y = ROD.sag(force[0], force[2], 0), ROD.sag(force[1], force[2], 1)
    expected = (in_x.across, in_y.across, -in_x.along - in_y.along)
    np.testing.assert_allclose(tip.place, expected, rtol=1e-9)
    np.testing.assert_allclose(tip.turn, (-in_y.slope, in_x.slope, 0.0), rtol=1e-9)


def test_free_vibration_has_the_frequency_and_the_damping_of_the_mode():
    rod = replace(ROD, modes=1, damping_ratio=0.02)
    system, omega = RodMotion(rod, 0.01), rod.frequencies[0, 0]
    state, still = [0.1, 0.0, 0.0, 0.0], ClampMotion((0.0, 0.0, 0.0))
    places = []
    for _ in range(200):
        places.append(state[0])
        state = system.step(state, still)
    t = 0.01 * np.arange(200)
    damped = omega * math.sqrt(1.0 - 0.02**2)
    decay = np.exp(-0.02 * omega * t)
    swing = np.cos(damped * t) + 0.02 * omega / damped * np.sin(damped * t)
    np.testing.assert_allclose(places, 0.1 * decay * swing, atol=1e-12)


def test_turning_base_carries_a_vibration_that_stays_where_it_is_in_space():
    # A round rod, upright without gravity, turned about its own axis: Foucault's pendulum.
    rod = FlexibleRod(damping_ratio=0.0)
    still = (0.0, 0.0, 0.0)
    rate, errors = 0.3, []
    for period in (0.01, 0.005, 0.0025):
        system = RodMotion(rod, period)
        state = system.rest(still)
        state[0] = 0.05
        state[6] = -rate * 0.05  # at rest in space
        aside = []
        for k in range(1, round(4.0 / period) + 1):
            state = system.step(state, ClampMotion(still, (0.0, 0.0, rate)))
            angle = rate * period * k
            x, y = state[0], state[2]
            aside.append(math.sin(angle) * x + math.cos(angle) * y)
        errors.append(max(map(abs, aside)))
    assert errors[-1] < 1e-5 * 0.05 * 100.0
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.15)


def test_wrench_at_rest_is_the_weight_at_its_bent_place():
    lean = 0.9
    force = leaning(lean)
    system, motion = RodMotion(ROD, PERIOD), ClampMotion(force)
    state = system.rest(force)
    moment, excess = system.bending_wrench(state, motion)
    np.testing.assert_allclose(excess, 0.0, atol=1e-9)
    masses, places, _, _ = points_of(ROD, np.array(state[:4]))
    rigid, total = system.rigid_wrench(motion)
    np.testing.assert_allclose(total, -masses.sum() * np.array(force), rtol=1e-12)
    expected = -masses @ np.cross(places, force)
    np.testing.assert_allclose(np.add(moment, rigid), expected, rtol=1e-3, atol=1e-9)


def test_tip_rates_are_those_of_the_tip():
    system, h = RodMotion(ROD, 1e-5), 1e-5
    motion = ClampMotion(leaning(0.4, 0.1), (0.2, 0.1, -0.3), (0.5, 0.3, 0.1))
    state = [0.05, 0.001, 0.02, 0.0005, 0.1, 0.2, -0.3, 0.1]
    later = system.step(state, motion)
    before, after = system.tip(state, motion), system.tip(later, motion)
    middle = system.tip([0.5 * (a + b) for a, b in zip(state, later, strict=True)], motion)
    for part, rate in (("place", "velocity"), ("turn", "turning")):
        change = np.subtract(getattr(after, part), getattr(before, part)) / h
        np.testing.assert_allclose(getattr(middle, rate), change, atol=1e-4)


def test_rows_of_a_batch_are_steps_of_their_own():
    system, count = RodMotion(ROD, 0.01), 5
    random = np.random.default_rng(1)
    states = 0.05 * random.standard_normal((count, 8))
    motions = random.standard_normal((count, 9)) + 9.0 * (np.arange(9) == 2)

    def motion_of(numbers):
        return ClampMotion(tuple(numbers[:3]), tuple(numbers[3:6]), tuple(numbers[6:]))

    batch, of_batch = list(states.T), motion_of(list(motions.T))
    together = system.step(batch, of_batch)
    wrench = system.bending_wrench(batch, of_batch)
    tip = system.tip(batch, of_batch)
    for i in range(count):
        state, motion = states[i].tolist(), motion_of(motions[i].tolist())
        row = system.step(state, motion)
        np.testing.assert_allclose([number[i] for number in together], row, rtol=1e-10, atol=1e-13)
        for part, of_row in zip(wrench, system.bending_wrench(state, motion), strict=True):
            np.testing.assert_allclose([number[i] for number in part], of_row, atol=1e-10)
        for name in Tip._fields:
            whole = [np.broadcast_to(number, count)[i] for number in getattr(tip, name)]
            np.testing.assert_allclose(whole, getattr(system.tip(state, motion), name), atol=1e-12)


@pytest.mark.parametrize(
    ("modes", "period", "words"),
    [
        (
            3,
            0.01,
            r"mode 3 of the rod has 111 Hz, more than a period of 0.01 s carries; at most 2",
        ),
        (
            2,
            0.02,
            r"mode 2 of the rod has 34.8 Hz.* at most 1 modes, or a period of at most 0.013 s",
        ),
        (1, 0.5, r"mode 1 of the rod has 2.23 Hz.* carries; a period of at most 0.2 s would do"),
    ],
)
def test_modes_above_what_the_period_carries_are_refused(modes, period, words):
    with pytest.raises(ValueError, match=words):
        RodMotion(FlexibleRod(modes=modes), period)
