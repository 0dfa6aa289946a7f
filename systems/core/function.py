"""Systems without state that wrap plain functions."""

import functools
import weakref
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array


class FunctionSystem(LeafSystem):
    """Outputs that are plain functions of the inputs.

    Use it to put kinematics, a feedforward or statics into a diagram without a class:

        FunctionSystem({"pose": 6}, {"length": (6, lambda pose: lengths(pose))})

    | port | size | unit | meaning |
    |---|---|---|---|
    | in each input | as given | as given | arguments of the functions, in this order |
    | out each output | as given | as given | value of its function |

    State: none.

    Bad input: handed to the functions as it is.

    Args:
        inputs: sizes of the inputs by their names.
        outputs: name and size of each output, and a function of all inputs (arrays) that returns
            an array.
    """

    def __init__(
        self,
        inputs: Mapping[str, int],
        outputs: Mapping[str, tuple[int, Callable[..., Any]]],
    ):
        super().__init__()
        self._inputs = [self.DeclareVectorInputPort(name, n) for name, n in inputs.items()]
        tickets = {port.ticket() for port in self._inputs} or {self.nothing_ticket()}
        for name, (size, function) in outputs.items():
            calc = functools.partial(_calc, weakref.ref(self), function)
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc=tickets)


def _calc(
    reference: "weakref.ref[FunctionSystem]",
    function: Callable[..., Any],
    context: Context,
    output: BasicVector,
) -> None:
    system: Any = reference()
    values = (read_array(port, context) for port in system._inputs)
    output.SetFromVector(np.asarray(function(*values), dtype=float))
