import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource, VectorLogSink
from pydrake.trajectories import PiecewisePolynomial

from parapod.systems.sensors.averaging_accelerometer import AveragingAccelerometer, in_body

PERIOD = 8.0 / 819.2


def samples(velocity, attitude=(0.0, 0.0, 0.0), until=1.0):
    """What the accelerometer shows at its own sampling instants."""
    builder = DiagramBuilder()
    sensor = builder.AddSystem(AveragingAccelerometer())
    source = builder.AddSystem(TrajectorySource(velocity))
    level = builder.AddSystem(ConstantVectorSource(np.array(attitude)))
    log = builder.AddSystem(VectorLogSink(3, PERIOD))
    builder.Connect(source.get_output_port(), sensor.GetInputPort("velocity"))
    builder.Connect(level.get_output_port(), sensor.GetInputPort("attitude"))
    builder.Connect(sensor.get_output_port(), log.get_input_port())
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(until)
    return log.FindLog(simulator.get_context()).data().T


def ramp(*slope):
    return PiecewisePolynomial.FirstOrderHold([0.0, 10.0], np.outer(slope, [0.0, 10.0]))


def test_first_sample_at_rest_is_gravity():
    np.testing.assert_allclose(samples(ramp(0.0, 0.0, 0.0))[0], (0.0, 0.0, 9.81), atol=1e-12)


def test_constant_acceleration_is_measured_exactly():
    shown = samples(ramp(0.3, -0.2, 0.1))
    np.testing.assert_allclose(shown[1:], [(0.3, -0.2, 9.91)] * (len(shown) - 1), atol=1e-9)


def test_shaking_in_step_with_the_samples_is_not_taken_for_a_constant_acceleration():
    # 1 mm/s at the sampling rate: up to .64 m/s^2 at any instant, zero on average.
    times = np.linspace(0.0, 2.0, 40001)
    shaking = 1e-3 * np.sin(2.0 * math.pi * times / PERIOD)
    velocity = PiecewisePolynomial.FirstOrderHold(times, np.outer((1.0, 0.0, 0.0), shaking))
    assert np.abs(samples(velocity)[:, 0]).max() < 1e-3


@pytest.mark.parametrize("attitude", [(0.1, 0.0, 0.0), (0.0, -0.2, 0.0), (0.1, 0.2, 0.3)])
def test_gravity_is_seen_in_the_bodys_axes(attitude):
    roll, pitch, _ = attitude
    expected = 9.81 * np.array(
        (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
    )
    np.testing.assert_allclose(samples(ramp(0, 0, 0), attitude)[0], expected, atol=1e-12)


def test_turning_a_vector_keeps_its_length_and_is_undone_by_the_rotation():
    from pydrake.math import RollPitchYaw

    angles, vector = (0.3, -0.4, 1.2), np.array((1.0, 2.0, -3.0))
    R_WB = RollPitchYaw(angles).ToRotationMatrix()
    np.testing.assert_allclose(R_WB.multiply(np.array(in_body(vector, *angles))), vector)
