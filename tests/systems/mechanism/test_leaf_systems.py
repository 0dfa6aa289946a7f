"""Mechanisms as systems: inverse, forward and forces in one diagram undo each other."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.systems.mechanism.leaf_systems import (
    MechanismForces,
    MechanismForward,
    MechanismInverse,
)
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.statics import motor_forces
from tests.systems.mechanism.conftest import MECHANISMS

DELTA = MECHANISMS / "delta" / "delta.xml"
PERIOD = 0.01


@pytest.fixture(scope="module")
def circle():
    """A delta that goes round: its diagram's logs of what is asked for, and what is done."""
    mechanism = Mechanism.load(DELTA)
    times = np.linspace(0.0, 1.0, 101)
    angle = 2.0 * np.pi * times
    height = mechanism.pose("platform", mechanism.home).translation()[2]
    places = np.array([0.05 * np.sin(angle), 0.05 * (1 - np.cos(angle)), height + 0.0 * angle])
    motion = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        times, places, periodic_end_condition=True
    )
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(motion, 1))
    inverse = builder.AddSystem(MechanismInverse(mechanism, "platform", period=PERIOD))
    parts = builder.AddSystem(Demultiplexer(6, 3))
    forward = builder.AddSystem(MechanismForward(mechanism, "platform", PERIOD))
    forces = builder.AddSystem(MechanismForces(mechanism, "platform"))
    builder.Connect(source.get_output_port(), inverse.GetInputPort("pose_desired_state"))
    builder.Connect(inverse.GetOutputPort("motor_desired_state"), parts.get_input_port())
    builder.Connect(parts.get_output_port(0), forward.GetInputPort("position"))
    builder.Connect(parts.get_output_port(1), forward.GetInputPort("velocity"))
    builder.Connect(forward.GetOutputPort("positions"), forces.GetInputPort("positions"))
    builder.Connect(parts.get_output_port(1), forces.GetInputPort("velocity"))
    logs = {
        name: LogVectorOutput(port, builder, PERIOD)
        for name, port in (
            ("asked", source.get_output_port()),
            ("motors", inverse.GetOutputPort("motor_desired_state")),
            ("pose", forward.GetOutputPort("pose")),
            ("rate", forward.GetOutputPort("pose_rate")),
            ("positions", forward.GetOutputPort("positions")),
            ("force", forces.GetOutputPort("force")),
        )
    }
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    context = simulator.get_context()
    return mechanism, {name: log.FindLog(context).data().T for name, log in logs.items()}


def test_the_frame_goes_where_it_is_asked_to(circle):
    _, logs = circle
    np.testing.assert_allclose(logs["pose"][:, :3], logs["asked"][:, :3], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(logs["rate"][:, :3], logs["asked"][:, 3:], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(logs["pose"][:, 3:], 0.0, atol=1e-9)
    assert np.ptp(logs["pose"][:, 0]) > 0.09


def test_rates_of_the_motors_are_those_of_their_positions(circle):
    _, logs = circle
    positions, rates = logs["motors"][:, :3], logs["motors"][:, 3:]
    central = (positions[2:] - positions[:-2]) / (2.0 * PERIOD)
    np.testing.assert_allclose(rates[1:-1], central, rtol=0.0, atol=5e-3)


def test_forces_are_those_of_the_pose(circle):
    mechanism, logs = circle
    for k in (0, 33, 77):
        held = motor_forces(mechanism, logs["positions"][k], logs["motors"][k, 3:])
        np.testing.assert_allclose(logs["force"][k], held.forces, rtol=1e-12)


def test_a_simulation_begins_at_the_pose_that_it_is_given():
    mechanism = Mechanism.load(DELTA)
    forward = MechanismForward(mechanism, "platform")
    context = forward.CreateDefaultContext()
    q = mechanism.forward(mechanism.motor_positions(mechanism.home) + 0.5)
    forward.begin(context, q)
    forward.GetInputPort("position").FixValue(context, mechanism.motor_positions(q))
    np.testing.assert_allclose(
        forward.GetOutputPort("positions").Eval(context), q, rtol=0.0, atol=1e-9
    )
