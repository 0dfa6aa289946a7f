"""Laws of Drake's own systems, which calculate in C++ and one run at a time, for many rows.

Each is read from the system that is in the diagram. A system that is not here and has no laws of
its own is carried out by Drake, row by row, in contexts of its own: correct and slow.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems import primitives
from pydrake.systems.framework import System

from parapod.systems.core.elementwise import clamp
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import Laws, Output, RowsContext, Sampled, Vector, laws_of
from parapod.systems.core.merged import Mergeable
from parapod.systems.core.rows import Number, of_rows


def find_laws(system: System) -> Laws:
    """Laws of a leaf system: its own, those of Drake's primitive, or Drake's row by row.

    Raises:
        ParapodError: a system that rows cannot have, such as one with a continuous state.
    """
    laws = laws_of(system)
    if laws is None:
        find = _PRIMITIVES.get(type(system), _by_drake)
        laws = find(system)
    if laws.refusals:
        raise ParapodError(f"'{system.get_name()}' has no laws over rows: {laws.refusals[0]}")
    return laws


def _inputs(system: Any) -> frozenset[int]:
    ports = map(system.get_input_port, range(system.num_input_ports()))
    return frozenset(int(port.ticket()) for port in ports)


def _stateless(system: Any, *laws: Callable[..., Any]) -> Laws:
    tickets = _inputs(system)
    return Laws(outputs=[Output(law, tickets) for law in laws])


def _read(context: RowsContext, index: int = 0) -> list[Number]:
    numbers = context.input(index)
    if numbers is None:
        raise ParapodError(f"nothing drives input {index} of a primitive")
    return numbers


def _constant(system: Any) -> Laws:
    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        output.numbers = context.get_numeric_parameter(0).numbers

    return Laws(outputs=[Output(law)])


class _Courses(Mergeable):
    """Values of the trajectories of a source, or of one of each row."""

    def __init__(self, systems: Sequence[Any]):
        self._systems = [(system, system.CreateDefaultContext()) for system in systems]

    @classmethod
    def of_rows(cls, objects: Sequence["_Courses"]) -> "_Courses":
        return cls([system for courses in objects for system, _ in courses._systems])

    def at(self, time: float) -> list[Number]:
        """Numbers at an instant [s]."""
        values = []
        for system, own in self._systems:
            own.SetTime(time)
            values.append(system.get_output_port().Eval(own).tolist())
        return of_rows(values)


def _trajectory(system: Any) -> Laws:
    courses = _Courses([system])

    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        output.numbers = courses.at(context.get_time())

    return Laws(outputs=[Output(law, frozenset([int(system.time_ticket())]))])


def _pass_through(system: Any) -> Laws:
    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        output.numbers = _read(context)

    return _stateless(system, law)


def _demultiplexer(system: Any) -> Laws:
    laws, begin = [], 0
    for size in system.get_output_ports_sizes():

        def law(
            _system: Any,
            context: RowsContext,
            output: Vector,
            part: slice = slice(begin, begin + size),
        ) -> None:
            output.numbers = _read(context)[part]

        laws.append(law)
        begin += size
    return _stateless(system, *laws)


def _multiplexer(system: Any) -> Laws:
    count = system.num_input_ports()

    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        output.numbers = [number for i in range(count) for number in _read(context, i)]

    return _stateless(system, law)


def _adder(system: Any) -> Laws:
    count = system.num_input_ports()

    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        # As Drake has it: added to zeros one by one.
        total: list[Any] = [0.0] * len(output)
        for i in range(count):
            if (numbers := context.input(i)) is not None:
                total = [x + y for x, y in zip(total, numbers, strict=True)]
        output.numbers = total

    return _stateless(system, law)


def _response(system: Any, value: float) -> list[float]:
    """Output of a primitive without state whose inputs are all one number."""
    own = system.CreateDefaultContext()
    port = system.get_input_port()
    port.FixValue(own, np.full(port.size(), value))
    numbers: list[float] = system.get_output_port().Eval(own).tolist()
    return numbers


def _gain(system: Any) -> Laws:
    gains = _response(system, 1.0)

    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        numbers: list[Any] = _read(context)
        output.numbers = [gain * x for gain, x in zip(gains, numbers, strict=True)]

    return _stateless(system, law)


def _saturation(system: Any) -> Laws:
    low, high = _response(system, -np.inf), _response(system, np.inf)

    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        output.numbers = list(map(clamp, _read(context), low, high))

    return _stateless(system, law)


def _linear(system: Any) -> Laws:
    """Matrices of discrete or no state; a continuous one is Drake's to refuse."""
    period = system.time_period()
    if system.A().size and not period:
        return _by_drake(system)
    a, b, c, d = map(_products, (system.A(), system.B(), system.C(), system.D()))

    def law(_system: Any, context: RowsContext, output: Vector) -> None:
        total: list[Any] = [0.0] * len(output)
        if any(c):
            total = _added(total, c, context.get_discrete_state_vector().numbers)
        output.numbers = _added(total, d, _read(context)) if any(d) else total

    def update(_system: Any, context: RowsContext, discrete_state: Any) -> None:
        state = discrete_state.groups[0]
        total = _added([0.0] * len(state), a, context.get_discrete_state_vector().numbers)
        state.numbers = _added(total, b, _read(context)) if any(b) else total

    tickets = _inputs(system) if any(d) else frozenset()
    laws = Laws(outputs=[Output(law, tickets | {int(system.xd_ticket())})])
    if system.A().size:
        laws.sampled = [Sampled(period, 0.0, update)]
    return laws


type _Products = list[list[tuple[int, float]]]


def _products(matrix: Any) -> _Products:
    """Columns and elements of each row of a matrix, but for zeros."""
    return [[(j, float(element)) for j, element in enumerate(row) if element] for row in matrix]


def _added(total: Sequence[Any], products: _Products, numbers: Sequence[Any]) -> list[Any]:
    """A vector, and added to it a matrix times another."""
    added = []
    for number, row in zip(total, products, strict=True):
        for j, element in row:
            number = number + element * numbers[j]
        added.append(number)
    return added


def _hold(system: Any) -> Laws:
    def law(_system: Any, context: RowsContext, discrete_state: Any) -> None:
        discrete_state.groups[0].numbers = _read(context)

    return Laws(outputs=[Output(None, group=0)], sampled=[_sampled(system, law)])


def _delay(system: Any) -> Laws:
    size = system.get_input_port().size()

    def law(_system: Any, context: RowsContext, discrete_state: Any) -> None:
        buffer = discrete_state.groups[0]
        buffer.numbers = buffer.numbers[size:] + _read(context)

    def first(_system: Any, context: RowsContext, output: Vector) -> None:
        output.numbers = context.get_discrete_state_vector().numbers[:size]

    tickets = frozenset([int(system.xd_ticket())])
    return Laws(outputs=[Output(first, tickets)], sampled=[_sampled(system, law)])


def _sampled(system: Any, law: Callable[..., Any]) -> Sampled:
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    return Sampled(timing.period_sec(), timing.offset_sec(), law)


_PRIMITIVES: dict[type, Callable[[Any], Laws]] = {
    primitives.Adder: _adder,
    primitives.ConstantVectorSource: _constant,
    primitives.Demultiplexer: _demultiplexer,
    primitives.DiscreteTimeDelay: _delay,
    primitives.Gain: _gain,
    primitives.LinearSystem: _linear,
    primitives.MatrixGain: _linear,
    primitives.Multiplexer: _multiplexer,
    primitives.PassThrough: _pass_through,
    primitives.Saturation: _saturation,
    primitives.TrajectorySource: _trajectory,
    primitives.VectorLogSink: lambda system: Laws(),
    primitives.ZeroOrderHold: _hold,
}


def _by_drake(system: Any) -> Laws:
    """A system that Drake carries out in a context of each row."""
    own = system.CreateDefaultContext()
    refusals = []
    if own.num_continuous_states() or own.num_abstract_states():
        kind = "a continuous" if own.num_continuous_states() else "an abstract"
        refusals.append(f"{kind} state of {type(system).__name__}")
    inputs = [system.get_input_port(i) for i in range(system.num_input_ports())]
    ports = [system.get_output_port(i) for i in range(system.num_output_ports())]
    refusals += [
        f"the abstract port '{port.get_name()}' of {type(system).__name__}"
        for port in (*inputs, *ports)
        if port.get_data_type().name != "kVectorValued"
    ]

    def prepared(context: RowsContext, read: Sequence[int]) -> Any:
        """Drake's context of a row, with the inputs that are read."""
        if type(context.index) is not int:
            raise TypeError("Drake's systems take one row at a time")
        drake = context.leaf.contexts[context.index]
        drake.SetTime(context.get_time())
        for group in range(drake.num_discrete_state_groups()):
            drake.SetDiscreteState(group, context.get_discrete_state(group).value())
        for i in read:
            if (numbers := context.input(i)) is not None:
                inputs[i].FixValue(drake, np.array(numbers))
        return drake

    every = range(len(inputs))

    def output_of(j: int) -> Output:
        read = [i for i in every if system.HasDirectFeedthrough(i, j)]

        def law(_system: Any, context: RowsContext, output: Vector) -> None:
            output.numbers = ports[j].Eval(prepared(context, read)).tolist()

        tickets = {int(inputs[i].ticket()) for i in read}
        return Output(
            law, frozenset({*tickets, int(system.xd_ticket()), int(system.time_ticket())})
        )

    def update(_system: Any, context: RowsContext, discrete_state: Any) -> None:
        values = system.EvalUniquePeriodicDiscreteUpdate(prepared(context, every))
        for group in range(values.num_groups()):
            discrete_state.set_value(group, values.value(group))

    def begin(_system: Any, context: RowsContext, discrete_state: Any) -> None:
        drake = prepared(context, every)
        system.ExecuteInitializationEvents(drake)
        for group in range(drake.num_discrete_state_groups()):
            discrete_state.set_value(group, drake.get_discrete_state(group).value())

    laws = Laws([output_of(j) for j in range(len(ports))], refusals=refusals)
    if own.num_discrete_state_groups():
        laws.initial = [begin]
        if system.GetUniquePeriodicDiscreteUpdateAttribute() is not None:
            laws.sampled = [_sampled(system, update)]
        elif not refusals:
            laws.refusals.append(f"several updates of {type(system).__name__}")
    laws.needs_contexts = True
    return laws
