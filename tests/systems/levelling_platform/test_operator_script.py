import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.levelling_platform.scripts import OperatorScript, Step
from parapod.systems.levelling_platform.supervisor import Command, Phase

PERIOD = 0.01
POSTURE = (0.01, -0.02, 0.47)
OUTPUTS = ("operator", "drive_request", "posture_request", "arm_request", "steps_done")


class Operator:
    """An operator at whom the test shows phases."""

    def __init__(self, fix, *steps, phase=Phase.TRANSPORT):
        self.system = OperatorScript(steps, POSTURE, PERIOD)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self._fix = fix
        self.show(phase)

    def show(self, phase):
        self._fix(self.system, self.context, phase=(float(phase),))

    def after(self, time):
        """Outputs a time later, by name."""
        # Half a period on, so that it is clear which updates have been made.
        goal = round((self.context.get_time() + time) / PERIOD) * PERIOD + 0.1 * PERIOD
        self.simulator.AdvanceTo(goal)
        return {
            name: self.system.GetOutputPort(name).Eval(self.context).tolist() for name in OUTPUTS
        }


def test_without_steps_nothing_is_asked_for_but_the_first_posture(fix):
    assert Operator(fix).after(1.0) == {
        "operator": [0.0],
        "drive_request": [0.0, 0.0],
        "posture_request": list(POSTURE),
        "arm_request": [0.0, 0.0],
        "steps_done": [0.0],
    }


def test_a_step_does_all_that_it_names(fix):
    step = Step(Phase.TRANSPORT, 0.0, Command.GO, (0.3, 0.1), (0.0, 0.01, 0.48), (0.5, 0.6))
    assert Operator(fix, step).after(0.1) == {
        "operator": [1.0],
        "drive_request": [0.3, 0.1],
        "posture_request": [0.0, 0.01, 0.48],
        "arm_request": [0.5, 0.6],
        "steps_done": [1.0],
    }


def test_what_a_step_does_not_name_stays_but_its_command_is_taken_back(fix):
    first = Step(Phase.TRANSPORT, 0.0, Command.GO, (0.3, 0.1), (0.0, 0.01, 0.48), (0.5, 0.6))
    operator = Operator(fix, first, Step(Phase.TRANSPORT, 0.5))
    before = operator.after(0.4)
    after = operator.after(0.2)
    assert (before["operator"], after["operator"]) == ([1.0], [0.0])
    assert (before["steps_done"], after["steps_done"]) == ([1.0], [2.0])
    for name in ("drive_request", "posture_request", "arm_request"):
        assert after[name] == before[name]


def test_a_step_waits_for_its_delay_after_the_one_before(fix):
    steps = [Step(Phase.TRANSPORT, 0.3, drive=(v, 0.0)) for v in (0.1, 0.2)]
    operator = Operator(fix, *steps)
    assert operator.after(0.29)["steps_done"] == [0.0]
    assert operator.after(0.01)["drive_request"] == [0.1, 0.0]
    assert operator.after(0.29)["steps_done"] == [1.0]
    assert operator.after(0.01)["drive_request"] == [0.2, 0.0]


def test_a_step_waits_for_its_phase_and_then_for_its_delay(fix):
    operator = Operator(fix, Step(Phase.HOLD, 0.2, Command.STOP))
    assert operator.after(5.0)["steps_done"] == [0.0]
    operator.show(Phase.HOLD)
    assert operator.after(0.2)["steps_done"] == [0.0]
    assert operator.after(0.01)["operator"] == [float(Command.STOP)]


def test_the_delay_begins_anew_when_the_phase_comes_back(fix):
    operator = Operator(fix, Step(Phase.HOLD, 0.2, Command.STOP), phase=Phase.HOLD)
    operator.after(0.1)
    operator.show(Phase.POSTURE)
    operator.after(0.05)
    operator.show(Phase.HOLD)
    assert operator.after(0.2)["steps_done"] == [0.0]
    assert operator.after(0.01)["steps_done"] == [1.0]


def test_steps_are_done_in_their_order(fix):
    operator = Operator(
        fix, Step(Phase.HOLD, 0.0, arm=(0.1, 0.2)), Step(Phase.TRANSPORT, 0.0, drive=(0.3, 0.0))
    )
    assert operator.after(1.0)["steps_done"] == [0.0]
    operator.show(Phase.HOLD)
    assert operator.after(1.0)["steps_done"] == [1.0]
    operator.show(Phase.TRANSPORT)
    assert operator.after(1.0)["steps_done"] == [2.0]


def test_one_step_a_period_at_most(fix):
    steps = [Step(Phase.TRANSPORT, 0.0)] * 3
    operator = Operator(fix, *steps)
    done = [operator.after(t)["steps_done"][0] for t in (0.0, 0.01, 0.01, 0.01)]
    assert done == [1.0, 2.0, 3.0, 3.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_phase_that_is_not_finite_is_none_that_a_step_waits_for(fix, bad):
    operator = Operator(fix, Step(Phase.TRANSPORT, 0.1), phase=bad)
    assert operator.after(1.0)["steps_done"] == [0.0]
    operator.show(Phase.TRANSPORT)
    assert operator.after(0.1)["steps_done"] == [0.0]
    assert operator.after(0.01)["steps_done"] == [1.0]


def test_a_context_begins_with_the_first_step_again(fix):
    operator = Operator(fix, Step(Phase.TRANSPORT, 0.0))
    operator.after(1.0)
    again = operator.system.CreateDefaultContext()
    assert operator.system.GetOutputPort("steps_done").Eval(again).tolist() == [0.0]
    np.testing.assert_array_equal(
        operator.system.GetOutputPort("posture_request").Eval(again), POSTURE
    )


def test_no_output_depends_on_the_phase_directly():
    assert not OperatorScript([]).HasAnyDirectFeedthrough()
