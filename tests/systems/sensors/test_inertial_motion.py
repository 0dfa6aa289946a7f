import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial

from parapod.systems.sensors.inertial_motion import InertialMotion

PERIOD = 8.0 / 819.2
# Quaternion, position, a joint; angular velocity, velocity, the joint's rate.
POSE, VELOCITY, SIZE = 0, 8, 15


def states(velocity, quaternion=(1.0, 0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0)):
    """A trajectory of states with a velocity that is a piecewise linear function of time."""
    times, values = velocity
    samples = np.zeros((SIZE, len(times)))
    samples[POSE : POSE + 4] = np.array(quaternion)[:, np.newaxis]
    samples[VELOCITY : VELOCITY + 3] = np.array(spin)[:, np.newaxis]
    samples[VELOCITY + 3 : VELOCITY + 6] = np.transpose(values)
    return PiecewisePolynomial.FirstOrderHold(times, samples)


def motions(trajectory, until=1.0):
    """Outputs of the system at the sensor's sampling instants."""
    builder = DiagramBuilder()
    system = builder.AddSystem(InertialMotion(SIZE, POSE, VELOCITY, PERIOD))
    source = builder.AddSystem(TrajectorySource(trajectory))
    last = builder.AddSystem(ZeroOrderHold(PERIOD, SIZE))
    builder.Connect(source.get_output_port(), system.GetInputPort("state"))
    builder.Connect(source.get_output_port(), last.get_input_port())
    builder.Connect(last.get_output_port(), system.GetInputPort("last_state"))
    log = LogVectorOutput(system.get_output_port(), builder, PERIOD)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(until)
    return log.FindLog(simulator.get_context()).data().T


def ramp(*slope):
    return [0.0, 10.0], np.outer([0.0, 10.0], slope)


AT_REST = ramp(0.0, 0.0, 0.0)


def test_first_sample_at_rest_is_gravity():
    shown = motions(states(AT_REST))
    np.testing.assert_allclose(shown[0], (0, 0, 0, 0, 0, 0, 0, 0, 9.81), atol=1e-12)


def test_constant_acceleration_is_measured_exactly():
    shown = motions(states(ramp(0.3, -0.2, 0.1)))[1:, 6:]
    np.testing.assert_allclose(shown, [(0.3, -0.2, 9.91)] * len(shown), atol=1e-9)


def test_shaking_in_step_with_the_samples_is_not_taken_for_a_constant_acceleration():
    # 1 mm/s at the sampling rate: up to .64 m/s^2 at any instant, zero on average.
    times = np.linspace(0.0, 2.0, 40001)
    shaking = np.outer(1e-3 * np.sin(2.0 * math.pi * times / PERIOD), (1.0, 0.0, 0.0))
    assert np.abs(motions(states((times, shaking)))[:, 6]).max() < 1e-3


@pytest.mark.parametrize(
    "attitude", [(0.1, 0.0, 0.0), (0.0, -0.2, 0.0), (0.1, 0.2, 0.3), (-0.4, 1.2, -2.5)]
)
def test_everything_is_seen_along_the_bodys_axes(attitude):
    rotation = RollPitchYaw(attitude).ToRotationMatrix()
    # A quaternion that is not normalised and of the other sign means the same rotation.
    quaternion = -1.7 * rotation.ToQuaternion().wxyz()
    spin = np.array((0.2, -0.1, 0.4))
    shown = motions(states(ramp(0.3, -0.2, 0.1), quaternion, spin))[5]
    np.testing.assert_allclose(shown[:3], attitude, atol=1e-12)
    np.testing.assert_allclose(shown[3:6], rotation.matrix().T @ spin, atol=1e-12)
    expected = rotation.matrix().T @ np.array((0.3, -0.2, 9.91))
    np.testing.assert_allclose(shown[6:], expected, atol=1e-9)
