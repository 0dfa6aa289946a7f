"""Linear model of a system about a context, or the reason why there is none.

Drake's `Linearize` takes a system whose discrete states are one group; a diagram has one a block.
Kinematics, actuators, PI controllers and the platform's feedforward convert to AutoDiffXd.
Encoders that count, estimators that reject and planners that decide do not: no whole station or
controller of the four machines has a linear model, but loops of those parts have.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.framework import Context, Diagram, System
from pydrake.systems.primitives import LinearSystem

from parapod.diagrams.wiring import leaf_systems
from parapod.systems.core.errors import ParapodError


def linearised(
    system: System, context: Context, inputs: Sequence[str], outputs: Sequence[str]
) -> LinearSystem:
    """The system about a context: changes of the outputs by changes of state and inputs.

    States are those of the context, one discrete group after the other, or the continuous ones;
    inputs and outputs are joined in the order of their names.

    Args:
        system: a system with one period, or with continuous state, or without state.
        context: its context, with values of the inputs.
        inputs: names of the inputs.
        outputs: names of the outputs.

    Raises:
        ParapodError: the system has no linear model; names the parts that are the reason.
    """
    period = _period(system, context)
    converted = system.ToAutoDiffXdMaybe()
    assert converted is not None
    variable = converted.CreateDefaultContext()
    variable.SetTimeStateAndParametersFrom(context)
    converted.FixInputPortsFrom(system, context, variable)
    is_sampled = context.num_discrete_state_groups() > 0
    groups: list[Any] = [group.CopyToVector() for group in context.get_discrete_state().get_data()]
    groups = groups or [context.get_continuous_state_vector().CopyToVector()]
    parts = [*groups, *(system.GetInputPort(name).Eval(context) for name in inputs)]
    values = InitializeAutoDiff(np.concatenate(parts).reshape(-1, 1)).ravel()
    slices = np.split(values, np.cumsum([len(part) for part in parts])[:-1])
    for i, value in enumerate(slices[: len(groups)]):
        if is_sampled:
            variable.SetDiscreteState(i, value)
        else:
            variable.SetContinuousState(value)
    for name, value in zip(inputs, slices[len(groups) :], strict=True):
        converted.GetInputPort(name).FixValue(variable, value)
    rows: list[Any] = [converted.GetOutputPort(name).Eval(variable) for name in outputs]
    if is_sampled:
        ahead = converted.EvalUniquePeriodicDiscreteUpdate(variable).get_data()
        rows = [*(group.CopyToVector() for group in ahead), *rows]
    else:
        rows = [converted.EvalTimeDerivatives(variable).get_vector().CopyToVector(), *rows]
    size = sum(map(len, groups))
    gradient = np.asarray(ExtractGradient(np.concatenate(rows).reshape(-1, 1)))
    (a, b), (c, d) = (np.split(part, [size], axis=1) for part in np.split(gradient, [size]))
    return LinearSystem(a, b, c, d, period)


def _period(system: System, context: Context) -> float:
    """Period of a system that has a linear model [s]; 0 for one that is not sampled.

    Raises:
        ParapodError: it has none.
    """
    contexts = {system: context}
    if isinstance(system, Diagram):
        contexts = {
            leaf: system.GetSubsystemContext(leaf, context) for leaf in leaf_systems(system)
        }
    reason = ""
    periods = set[float]()
    for leaf, own in contexts.items():
        if own.num_discrete_state_groups():
            timing = leaf.GetUniquePeriodicDiscreteUpdateAttribute()
            periods.add(timing.period_sec() if timing is not None else 0.0)
        if own.num_abstract_states():
            reason = f"'{leaf.get_name()}' has a state that is not of numbers"
    fixed = [f"'{leaf.get_name()}'" for leaf in contexts if leaf.ToAutoDiffXdMaybe() is None]
    if fixed:
        reason = f"{', '.join(fixed)} cannot be differentiated (no AutoDiffXd)"
    elif len(periods) > 1 or (periods and context.num_continuous_states()):
        listed = ", ".join(f"{period:g}" for period in sorted(periods))
        reason = f"its parts are sampled with different periods ({listed} s; 0: continuous)"
    if reason:
        raise ParapodError(f"'{system.get_name()}' has no linear model: {reason}")
    return min(periods, default=0.0)
