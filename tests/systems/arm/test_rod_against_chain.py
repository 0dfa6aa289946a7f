"""The modes of a rod beside a chain of bodies: tip and wrench on the base in the same swing."""

import math

import numpy as np
import pytest

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import ClampMotion, RodMotion
from parapod.systems.core.physics import GRAVITY
from tests.systems.arm.rod_chain import base_wrench_and_tip, swing_of

ROD = FlexibleRod(damping_ratio=0.0, modes=3)
STEP = 1e-3


@pytest.fixture(scope="module")
def chain():
    return base_wrench_and_tip()


@pytest.fixture(scope="module")
def modes(chain):
    """Tip, moment and force (n, 3) of the modes at the chain's times."""
    way = swing_of()
    rate, acceleration = way.derivative(1), way.derivative(2)
    system = RodMotion(ROD, STEP)

    def motion_at(time):
        angle, w, a = (float(part.value(time)[0, 0]) for part in (way, rate, acceleration))
        force = -GRAVITY * math.sin(angle), 0.0, GRAVITY * math.cos(angle)
        return ClampMotion(force, (0.0, w, 0.0), (0.0, a, 0.0))

    state, rows = system.rest((0.0, 0.0, GRAVITY)), []
    stride = round((chain.time[1] - chain.time[0]) / STEP)
    for k in range(stride * (len(chain.time) - 1) + 1):
        if k % stride == 0:
            # Just before the instant, as the cubic's acceleration jumps at its ends.
            motion = motion_at(max(0.0, k * STEP - 1e-9))
            bending, rigid = system.bending_wrench(state, motion), system.rigid_wrench(motion)
            wrench = [np.add(*parts) for parts in zip(bending, rigid, strict=True)]
            rows.append((system.tip(state, motion).place, *wrench))
        state = system.step(state, motion_at((k + 0.5) * STEP))
    return tuple(np.array(part) for part in zip(*rows, strict=True))


@pytest.mark.slow
def test_tip_goes_where_the_chain_s_does(chain, modes):
    tip, _, _ = modes
    largest = np.abs(chain.tip[:, 0]).max()
    assert np.abs(tip[:, 0] - chain.tip[:, 0]).max() < 0.01 * largest
    assert np.abs(tip[:, 2] - chain.tip[:, 2]).max() < 0.03 * np.abs(chain.tip[:, 2]).max()


@pytest.mark.slow
def test_wrench_on_the_base_is_the_chain_s_within_two_percent(chain, modes):
    _, moment, force = modes
    for ours, theirs in ((moment, chain.moment), (force, chain.force)):
        assert np.abs(ours - theirs).max() < 0.02 * np.abs(theirs).max()
