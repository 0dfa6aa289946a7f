import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import leg_forward, leg_inverse
from parapod.systems.walking_chair.planner import CircleReference
from parapod.systems.walking_chair.trajectories import FootCircle

LEG = LegGeometry()


def lengths_at(circle, time):
    return leg_inverse(LEG, circle.motion(time).position)


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_a_sample_is_where_the_foot_should_be_a_period_later(period):
    circle = FootCircle()
    builder = DiagramBuilder()
    reference = builder.AddSystem(CircleReference(circle, period=period))
    # Samples as a controller does, at the instants of the updates and before them.
    log = LogVectorOutput(reference.get_output_port(), builder, period)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.5)
    found = log.FindLog(simulator.get_context())
    assert len(found.sample_times()) > 20
    for time, node in zip(found.sample_times(), found.data().T, strict=True):
        np.testing.assert_allclose(node, lengths_at(circle, time + period), rtol=1e-12)


def test_nodes_rest_before_the_first_one_and_after_the_last_lap():
    circle = FootCircle(period=0.2, laps=1)
    reference = CircleReference(circle)
    simulator = Simulator(reference)
    simulator.AdvanceTo(0.5)
    node = reference.GetOutputPort("position_node").Eval(simulator.get_context())
    np.testing.assert_allclose(node, lengths_at(circle, 0.0), rtol=1e-13)


def test_nodes_put_the_foot_on_the_circle():
    simulator = Simulator(reference := CircleReference())
    for k in range(1, 50):
        simulator.AdvanceTo(0.1 * k - 0.003)
        node = reference.GetOutputPort("position_node").Eval(simulator.get_context())
        x, y, z = leg_forward(LEG, node).point
        assert np.hypot(x, y - 0.1) == pytest.approx(0.1, abs=1e-12)
        assert z == pytest.approx(-0.6754, abs=1e-12)


def test_a_circle_out_of_reach_gives_no_lengths():
    reference = CircleReference(FootCircle(z=0.5))
    node = reference.GetOutputPort("position_node").Eval(reference.CreateDefaultContext())
    assert np.isnan(node).all()
