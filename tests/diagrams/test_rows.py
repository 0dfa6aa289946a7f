import math
import re
from operator import mul
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems import framework
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    DiscreteTimeDelay,
    Gain,
    LinearSystem,
    MatrixGain,
    Multiplexer,
    PassThrough,
    Saturation,
    TrajectorySource,
    VectorLogSink,
    ZeroOrderHold,
)
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.rows import RowsSimulator
from parapod.diagrams.wiring import add
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, elements, has_value, read, read_array

PERIOD = 0.1
UNTIL = 2.0


class Counter(LeafSystem):
    """Sums up its input times a factor; refuses sums above a limit, and starts with a pulse."""

    def __init__(self, base_limit=math.inf):
        super().__init__()
        self._limit = base_limit
        self._u = self.DeclareVectorInputPort("u", 2)
        self._free = self.DeclareVectorInputPort("free", 1)
        self._factor = self.DeclareNumericParameter(BasicVector(np.ones(2)))
        self._sum = self.DeclareDiscreteState(2)
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("sum", self._sum)
        self._product = declare_cached(
            self, "product", self._calc_product, {self.xd_ticket(), self._u.ticket()}
        )
        self.DeclareVectorOutputPort(
            "late", 2, self._calc_late, {self.time_ticket(), self._product.ticket}
        )
        self.DeclareInitializationDiscreteUpdateEvent(self._begin)
        self.DeclarePeriodicDiscreteUpdateEvent(0.03, 0.0, self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(0.07, 0.02, self._count)

    def _begin(self, context, state):
        state.set_value(0, 10.0 * np.array(context.get_discrete_state(0).value()) + 1.0)

    def _update(self, context, state):
        factors = context.get_numeric_parameter(self._factor)
        sums = context.get_discrete_state(0)
        numbers = [
            sums[i] + factors[i] * u if u > 0.0 else sums[i] * 0.5
            for i, u in enumerate(read(self._u, context))
        ]
        if numbers[0] > self._limit:
            raise ValueError(f"{float(numbers[0]):.3g} is too much")
        state.set_value(0, np.array(numbers))

    def _count(self, context, state):
        state.get_mutable_vector(1)[0] = context.get_discrete_state(1)[0] + 1.0

    def _calc_product(self, context):
        sums = elements(context.get_discrete_state(0))
        return list(map(mul, sums, read(self._u, context)))

    def _calc_late(self, context, output):
        offset = read(self._free, context)[0] if has_value(self._free, context) else 0.25
        product = self._product.value(self, context)
        output.SetFromVector(np.array([p + offset + context.get_time() for p in product]))


class DrakesOwn(framework.LeafSystem):
    """System of an author who knows of Drake alone."""

    def __init__(self):
        super().__init__()
        self._u = self.DeclareVectorInputPort("u", 2)
        self.DeclareStateOutputPort("y", self.DeclareDiscreteState(2))
        self.DeclareVectorOutputPort(
            "sine", 2, lambda c, out: out.SetFromVector(np.sin(self._u.Eval(c)))
        )
        self.DeclarePeriodicDiscreteUpdateEvent(0.05, 0.0, self._update)

    def _calc_sine(self, context, output):
        output.SetFromVector(np.sin(self._u.Eval(context)))

    def _update(self, context, state):
        state.set_value(0.9 * context.get_discrete_state_vector().value() + self._u.Eval(context))


class Circuit:
    """A diagram with logs of all its outputs."""

    def __init__(self):
        self.builder, self.logs = DiagramBuilder(), {}

    def add(self, system, *sources):
        add(self.builder, system, f"system_{len(self.logs)}_{type(system).__name__}")
        for i, source in enumerate(sources):
            self.builder.Connect(source, system.get_input_port(i))
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            log = add(self.builder, VectorLogSink(port.size(), PERIOD), f"log_{len(self.logs)}")
            self.builder.Connect(port, log.get_input_port())
            self.logs[f"{system.get_name()}.{port.get_name()}"] = log
        return system

    def build(self):
        self.diagram = self.builder.Build()
        return self


def drake_run(circuit, set_row, row):
    simulator = Simulator(circuit.diagram)
    set_row(simulator.get_mutable_context(), row)
    simulator.Initialize()
    simulator.AdvanceTo(UNTIL)
    context = simulator.get_context()
    return {name: log.FindLog(context).data().T for name, log in circuit.logs.items()}


def simulated(circuit, set_row, count):
    def beginnings():
        for row in range(count):
            context = circuit.diagram.CreateDefaultContext()
            set_row(context, row)
            yield circuit.diagram, context

    simulator = RowsSimulator(circuit.diagram, beginnings())
    for name, log in circuit.logs.items():
        simulator.log(log, name)
    simulator.advance_to(UNTIL, PERIOD)
    return simulator


def setting(source, value):
    """Sets the constant of a source to a function of the row."""

    def set_row(context, row):
        own = source.GetMyMutableContextFromRoot(context)
        source.get_mutable_source_value(own).SetFromVector(np.array(value(row), dtype=float))

    return set_row


def assert_rows_are_runs(circuit, set_row, count=4):
    simulator = simulated(circuit, set_row, count)
    assert not simulator.errors
    for row in range(count):
        for name, samples in drake_run(circuit, set_row, row).items():
            np.testing.assert_allclose(
                simulator.signal(name, row), samples, rtol=1e-15, atol=1e-15, err_msg=name
            )
    return simulator


@pytest.fixture(scope="module")
def primitives():
    circuit = Circuit()
    source = circuit.add(ConstantVectorSource(np.ones(4))).get_output_port()
    ways = np.array([[0.0, 1.0, -1.0]] * 2)
    path = PiecewisePolynomial.CubicShapePreserving([0.0, 1.0, 3.0], ways)
    moved = circuit.add(TrajectorySource(path, 1)).get_output_port()
    total = circuit.add(Adder(2, 4), source, moved).get_output_port()
    circuit.add(Gain(-2.5, 4), total)
    circuit.add(Gain(np.array([1.0, -3.0, 0.0, 0.1])), total)
    first, last = map(circuit.add(Demultiplexer(4, 2), total).get_output_port, range(2))
    mixed = circuit.add(Multiplexer([2, 4]), first, source).get_output_port()
    circuit.add(PassThrough(6), mixed)
    circuit.add(Saturation([-0.5] * 2, [0.75, 0.25]), last)
    circuit.add(MatrixGain(np.array([[0.0, 2.0], [-1.0, 0.0], [0.0, 0.0]])), first)
    held = circuit.add(ZeroOrderHold(0.15, 4, 0.05), total).get_output_port()
    circuit.add(DiscreteTimeDelay(0.05, 3, 4), held)
    lag = LinearSystem(0.5 * np.eye(4), 0.5 * np.eye(4), 2.0 * np.eye(4), np.zeros((4, 4)), 0.05)
    circuit.add(lag, held)
    return circuit.build()


def test_primitives_of_drake(primitives):
    source = primitives.diagram.GetSystems()[0]

    set_row = setting(source, lambda row: [row, 1.0, 0.3 * row, -1.0])
    simulator = assert_rows_are_runs(primitives, set_row)
    assert not simulator.one_by_one


def counting(limit=math.inf):
    circuit = Circuit()
    steps = np.cos(np.arange(80)).reshape(2, 40)
    path = PiecewisePolynomial.ZeroOrderHold(np.arange(40) * 0.1, steps)
    moved = circuit.add(TrajectorySource(path)).get_output_port()
    counter = circuit.add(Counter(limit), moved)
    circuit.build()

    def set_row(context, row):
        own = counter.GetMyMutableContextFromRoot(context)
        own.SetDiscreteState(0, np.array([0.1 * row, 0.7]))
        own.get_mutable_numeric_parameter(0).SetFromVector(np.array([1.0 + row, 2.0]))
        counter.GetInputPort("free").FixValue(own, [1.0 * row])

    return circuit, set_row


def test_states_caches_parameters_events_and_fixed_inputs():
    simulator = assert_rows_are_runs(*counting())
    assert not simulator.one_by_one


def test_a_row_that_fails_ends_alone_with_the_error_of_its_run():
    circuit, set_row = counting(limit=30.0)
    simulator = simulated(circuit, set_row, 5)
    assert 0 < len(simulator.errors) < 5
    for row in range(5):
        if row in simulator.errors:
            with pytest.raises(ValueError, match=str(simulator.errors[row])):
                drake_run(circuit, set_row, row)
        else:
            for name, samples in drake_run(circuit, set_row, row).items():
                assert np.array_equal(simulator.signal(name, row), samples)


def test_a_system_of_drake_alone_is_taken_row_by_row_and_named():
    circuit = Circuit()
    source = circuit.add(ConstantVectorSource(np.ones(2)))
    own = circuit.add(DrakesOwn(), source.get_output_port())
    circuit.add(Gain(2.0, 2), own.get_output_port(0))
    circuit.build()

    simulator = assert_rows_are_runs(circuit, setting(source, lambda row: [row, 1.0]))
    assert [name.split("::")[-1] for name in simulator.one_by_one] == [own.get_name()]


def test_an_array_of_floats_only_is_taken_row_by_row():
    class Insisting(LeafSystem):
        def __init__(self):
            super().__init__()
            self._u = self.DeclareVectorInputPort("u", 2)
            self.DeclareVectorOutputPort("y", 2, self._calc, {self._u.ticket()})

        def _calc(self, context, output):
            output.SetFromVector(np.tanh(read_array(self._u, context).astype(float)))

    circuit = Circuit()
    source = circuit.add(ConstantVectorSource(np.ones(2)))
    own = circuit.add(Insisting(), source.get_output_port())
    circuit.build()

    simulator = assert_rows_are_runs(circuit, setting(source, lambda row: [row, 1.0]))
    assert [name.split("::")[-1] for name in simulator.one_by_one] == [own.get_name()]


def test_a_continuous_state_is_refused_by_name():
    circuit = Circuit()
    source = circuit.add(ConstantVectorSource(np.ones(1)))
    circuit.add(LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), source.get_output_port())
    circuit.build()
    with pytest.raises(ParapodError, match="LinearSystem' has no laws over rows: a continuous"):
        RowsSimulator(circuit.diagram, [(circuit.diagram, circuit.diagram.CreateDefaultContext())])


def test_the_system_of_the_documents_takes_rows():
    page = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    (listing,) = (
        text for text in re.findall(r"```python\n(.*?)```", page, re.S) if "class" in text
    )
    names = {}
    exec(listing, names)
    circuit = Circuit()
    source = circuit.add(ConstantVectorSource(np.ones(1)))
    circuit.add(names["Governor"](), source.get_output_port())
    circuit.build()

    assert not assert_rows_are_runs(circuit, setting(source, lambda row: [0.6 * row])).one_by_one
