"""Linear models: beside Drake's own, of several groups of states, and refused with the reason."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.examples import PendulumPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import DiscreteTimeIntegrator, Gain, Integrator, Linearize

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.linear import linearised
from parapod.diagrams.machine import list_machines
from parapod.diagrams.wiring import add, connect, inputs_of
from parapod.systems.core.errors import ParapodError
from parapod.systems.levelling_platform.inclination_loop import PostureLoop


def matrices(model):
    return model.A(), model.B(), model.C(), model.D()


def chain(*systems):
    """Systems in a row, from `u` to `y`."""
    builder = DiagramBuilder()
    for system in systems:
        add(builder, system)
    for one, other in pairwise(systems):
        connect(builder, one.get_output_port(), other.get_input_port())
    builder.ExportInput(systems[0].get_input_port(), "u")
    builder.ExportOutput(systems[-1].get_output_port(), "y")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("u").FixValue(context, np.zeros(systems[0].get_input_port().size()))
    return diagram, context


def test_it_is_drakes_where_that_has_one():
    loop, pendulum = PostureLoop(), PendulumPlant()
    for system, name, values in ((loop, "attitude", [0.01, -0.02]), (pendulum, "tau", [0.3])):
        context = system.CreateDefaultContext()
        for port in inputs_of(system).values():
            port.FixValue(context, np.ones(port.size()))
        port = system.GetInputPort(name)
        port.FixValue(context, values)
        output = system.get_output_port()
        one = linearised(system, context, [name], [output.get_name()])
        other = Linearize(
            system, context, port.get_index(), output.get_index(), equilibrium_check_tolerance=1e9
        )
        for mine, drakes in zip(matrices(one), matrices(other), strict=True):
            np.testing.assert_allclose(mine, drakes, atol=1e-12)
        assert one.time_period() == other.time_period()


def test_several_groups_are_joined_in_their_order():
    diagram, context = chain(
        DiscreteTimeIntegrator(1, 0.1), Gain(3.0, 1), DiscreteTimeIntegrator(1, 0.1)
    )
    a, b, c, d = matrices(linearised(diagram, context, ["u"], ["y"]))
    np.testing.assert_allclose(a, [[1.0, 0.0], [0.3, 1.0]])
    np.testing.assert_allclose(b, [[0.1], [0.0]])
    np.testing.assert_allclose(c, [[0.0, 1.0]])
    np.testing.assert_allclose(d, [[0.0]])


def test_continuous_states_and_none_at_all():
    a, b, c, d = matrices(linearised(*chain(Gain(2.0, 1), Integrator(1)), ["u"], ["y"]))
    assert [part.tolist() for part in (a, b, c, d)] == [[[0.0]], [[2.0]], [[1.0]], [[0.0]]]
    a, _, _, d = matrices(linearised(*chain(Gain(2.0, 2)), ["u"], ["y"]))
    assert a.shape == (0, 0)
    np.testing.assert_allclose(d, 2.0 * np.eye(2))


def test_different_periods_are_refused():
    diagram, context = chain(DiscreteTimeIntegrator(1, 0.1), DiscreteTimeIntegrator(1, 0.2))
    with pytest.raises(ParapodError, match=r"different periods \(0.1, 0.2 s"):
        linearised(diagram, context, ["u"], ["y"])
    diagram, context = chain(DiscreteTimeIntegrator(1, 0.1), Integrator(1))
    with pytest.raises(ParapodError, match="different periods"):
        linearised(diagram, context, ["u"], ["y"])


@pytest.mark.parametrize("machine", list_machines(), ids=lambda machine: machine.name)
def test_whole_stations_and_controllers_are_refused_with_the_parts_that_are_the_reason(machine):
    scenario = machine.scenario(backend="kinematic")
    loop = ClosedLoop(machine, scenario, log=())
    for system in (loop.station, loop.controller):
        with pytest.raises(
            ParapodError, match=r"has no linear model: '.*cannot be diff"
        ) as caught:
            linearised(system, system.CreateDefaultContext(), [], [])
        assert "\n" not in str(caught.value)
