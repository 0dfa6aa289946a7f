import gc
import math
import weakref

import numpy as np
import pytest

from parapod.systems.core.remembered import Remembered
from parapod.systems.levelling_platform.feedforward import KinematicFeedforward, PassiveLegSolver
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.model import LegTransmission


@pytest.fixture
def calls():
    return []


@pytest.fixture
def total(calls):
    """The sum of two lists, remembered."""

    def add(a, b):
        calls.append((a, b))
        return sum(a) + sum(b)

    return Remembered(add)


def test_same_arguments_are_calculated_once(total, calls):
    assert [total([1.0, 2.0], [3.0]), total([1.0, 2.0], [3.0])] == [6.0, 6.0]
    assert len(calls) == 1


def test_any_other_number_is_calculated_anew(total, calls):
    assert total([1.0, 2.0], [3.0]) == 6.0
    assert total([1.0, 2.0], [4.0]) == 7.0
    total([1.0, math.nextafter(2.0, 3.0)], [4.0])
    assert len(calls) == 3
    # Only the last is kept.
    assert total([1.0, 2.0], [3.0]) == 6.0
    assert len(calls) == 4


def test_what_is_not_a_number_is_never_the_same(total, calls):
    for _ in range(2):
        assert math.isnan(total([float("nan")], [1.0]))
    assert len(calls) == 2


def test_an_error_is_not_remembered(total, calls):
    assert total([1.0], [2.0]) == 3.0
    with pytest.raises(TypeError):
        total([1.0], ["two"])
    assert total([1.0], [2.0]) == 3.0
    assert len(calls) == 2


@pytest.mark.parametrize(
    "kind", [KinematicFeedforward, PassiveLegSolver, KinematicPlatform, LegTransmission]
)
def test_what_a_system_remembers_does_not_keep_it_alive(kind):
    system = kind()
    context = system.CreateDefaultContext()
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        port.FixValue(context, np.full(port.size(), 0.4))
    for i in range(system.num_output_ports()):
        system.get_output_port(i).Eval(context)
    gone = weakref.ref(system)
    del system, context, port
    gc.collect()
    assert gone() is None
