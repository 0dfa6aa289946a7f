"""One leg on its circle, as a diagram."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.walking_chair.leg_loop import LegLoopParams, make_leg_loop
from parapod.systems.actuators.compound_position_controller import MODES
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.trajectories import FootCircle

PARAMS = LegLoopParams()
STEP = PARAMS.drive_step


def params_with(mode="compound", **changes):
    controller = replace(PARAMS.controller, mode=mode)
    return replace(PARAMS, controller=controller, **changes)


def run(loop, until, context=None):
    simulator = Simulator(loop.diagram, context or loop.diagram.CreateDefaultContext())
    loop.reset(simulator.get_mutable_context())
    simulator.Initialize()
    simulator.AdvanceTo(until)
    return loop.recorded(simulator.get_context())


def lengths_at(time):
    return leg_inverse(PARAMS.geometry, PARAMS.circle.motion(time).position)


@pytest.mark.parametrize("mode", MODES)
def test_it_starts_at_rest_where_the_circle_begins(mode):
    time, position, velocity = run(make_leg_loop(params_with(mode)), 0.05)
    np.testing.assert_allclose(time, np.arange(51) * STEP, atol=1e-12)
    np.testing.assert_allclose(position[0], lengths_at(0.0), atol=1e-15)
    assert not velocity[0].any()
    assert velocity.any()


@pytest.mark.parametrize("mode", MODES)
def test_it_can_be_run_again_from_the_same_context(mode):
    loop = make_leg_loop(params_with(mode))
    context = loop.diagram.CreateDefaultContext()
    first, second = (run(loop, 0.3, context) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def by_hand(until, mode="compound"):
    """Positions (n, 3), from Eqs. (46)-(48) and the drives' lag alone."""
    steps_a_tick = round(PARAMS.period / STEP)
    gain, offset = np.array(PARAMS.gain), np.array(PARAMS.offset)
    share = -np.expm1(-STEP / PARAMS.drive.time_constant)
    position, velocity, goal = lengths_at(0.0), np.zeros(3), offset.copy()
    due = last = np.round(position / 5e-6) * 5e-6
    sums, positions = np.zeros(3), [position]
    for step in range(round(until / STEP)):
        held = goal
        if step % steps_a_tick == 0:
            node = lengths_at((step // steps_a_tick + 1) * PARAMS.period)
            measured = np.round(position / 5e-6) * 5e-6
            missing = 10.0 * (due - measured) if mode == "compound" else 0.0
            desired = (node - due) / PARAMS.period + missing
            error = desired - (measured - last) / PARAMS.period
            sums = sums + error
            goal = gain * (0.6 * error + 0.25 * sums) + offset
            due, last = node, measured
            # The drives take a command one of their steps after its sample.
            held = held if step else np.zeros(3)
        change = share * (held - velocity)
        position = position + held * STEP - PARAMS.drive.time_constant * change
        velocity = velocity + change
        positions.append(position)
    return np.array(positions)


@pytest.mark.parametrize("mode", ["compound", "velocity"])
def test_drives_go_where_the_equations_have_them(mode):
    _, position, _ = run(make_leg_loop(params_with(mode)), 1.0)
    np.testing.assert_allclose(position, by_hand(1.0, mode), rtol=0.0, atol=2e-6)


def test_position_mode_samples_its_command_as_often_as_the_drive_steps():
    _, _, velocity = run(make_leg_loop(params_with("position")), 0.5)
    # Its velocity turns between samples of the controller too.
    turns = np.flatnonzero(np.diff(np.sign(np.diff(velocity[:, 1])))) + 1
    assert set((turns % 10).tolist()) - {0, 1}


def test_drives_stay_within_their_strokes():
    # So low a circle is out of reach; nothing refuses it here.
    circle = FootCircle(z=-0.6450)
    loop = make_leg_loop(params_with(circle=circle))
    context = loop.diagram.CreateDefaultContext()
    simulator = Simulator(loop.diagram, context)
    loop.reset(context)
    loop.drives.set_position(context, (0.60, 0.60, 0.60))
    simulator.AdvanceTo(3.0)
    _, position, _ = loop.recorded(context)
    low, high = PARAMS.geometry.strokes.T
    assert (position >= low - 1e-6).all()
    assert (position <= high + 1e-6).all()
    assert np.abs(position - low).min() < 1e-4
