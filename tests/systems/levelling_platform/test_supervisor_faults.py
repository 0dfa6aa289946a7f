"""Faults in an operation: what they stop, and how the operator goes on."""

import math

import pytest

from parapod.systems.levelling_platform.supervisor import Command, Phase, Refusal
from parapod.systems.safety.faults import Severity


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.FAULT}))
@pytest.mark.parametrize("severity", Severity)
def test_a_fault_of_severity_hold_or_more_stops_every_phase(operate, phase, severity):
    operation = operate().to(phase)
    operation.set(severity=(float(severity),))
    operation.tick()
    assert (operation.phase is Phase.FAULT) == (severity >= Severity.HOLD)
    if severity >= Severity.HOLD:
        assert operation["wheel_velocity_command"].tolist() == [0.0] * 4
        assert operation["wheel_brake"].tolist() == [1.0]
        assert operation["leg_rate"].tolist() == [0.0] * 4
        assert operation["posture_control"].tolist() == [0.0]
        assert operation["arm_enable"].tolist() == [0.0]


@pytest.mark.parametrize("severity", Severity)
def test_legs_are_without_voltage_from_severity_brake_on(operate, severity):
    operation = operate().to(Phase.FAULT)
    operation.set(severity=(float(severity),))
    operation.tick()
    assert operation["legs_enable"].tolist() == [float(severity < Severity.BRAKE)]
    assert operation["legs_stop"].tolist() == [float(severity >= Severity.BRAKE)]


GRAVE = [Severity.HOLD, Severity.BRAKE, Severity.LATCHED_OFF]


@pytest.mark.parametrize("severity", GRAVE)
def test_a_reset_is_refused_until_the_fault_is_gone(operate, severity):
    operation = operate().to(Phase.FAULT)
    operation.set(severity=(float(severity),), operator=(float(Command.RESET),))
    operation.tick(4)
    assert operation.phase is Phase.FAULT
    assert operation.refusal == (Refusal.COMMAND, float(Phase.FAULT))
    operation.set(severity=(float(Severity.WARN),))
    assert operation.wait(1.0) is Phase.FAULT
    operation.set(operator=(0.0,))
    operation.tick()
    assert operation.command(Command.RESET) is Phase.RETRACT
    assert operation["legs_enable"].tolist() == [1.0]


@pytest.mark.parametrize("severity", GRAVE)
@pytest.mark.parametrize("periods", [1, 2, 3])
def test_a_reset_waits_for_the_findings_that_end_with_it(operate, severity, periods):
    operation = operate().to(Phase.FAULT)
    operation.set(severity=(float(severity),), operator=(float(Command.RESET),))
    assert operation.tick(periods) is Phase.FAULT
    assert operation.refusal == (Refusal.NONE, 0.0)
    operation.set(severity=(float(Severity.WARN),))
    assert operation.tick() is Phase.RETRACT
    assert operation.refusal == (Refusal.NONE, 0.0)
    assert operation["legs_stop"].tolist() == [0.0]


def test_a_reset_that_was_refused_does_not_shorten_the_next_one_s_wait(operate):
    operation = operate().to(Phase.FAULT)
    for _ in range(2):
        operation.set(severity=(float(Severity.HOLD),), operator=(float(Command.RESET),))
        operation.tick(4)
        assert operation.refusal == (Refusal.COMMAND, float(Phase.FAULT))
        operation.set(operator=(0.0,))
        operation.wait(1.0)
    operation.set(operator=(float(Command.RESET),))
    operation.tick(3)
    operation.set(severity=(float(Severity.NONE),))
    assert operation.tick() is Phase.RETRACT


def test_a_reset_that_is_taken_back_while_it_waits_is_forgotten(operate):
    operation = operate().to(Phase.FAULT)
    operation.set(severity=(float(Severity.HOLD),))
    operation.command(Command.RESET)
    operation.tick()
    operation.set(severity=(float(Severity.NONE),))
    assert operation.wait(1.0) is Phase.FAULT
    assert operation.refusal == (Refusal.NONE, 0.0)
    # The next one waits as long as the first.
    operation.set(severity=(float(Severity.HOLD),), operator=(float(Command.RESET),))
    operation.tick(3)
    assert operation.refusal == (Refusal.NONE, 0.0)
    operation.set(severity=(float(Severity.NONE),))
    assert operation.tick() is Phase.RETRACT


@pytest.mark.parametrize("way_down", [False, True])
def test_after_a_fault_legs_go_up_at_once_even_if_it_was_on_the_way_down(operate, way_down):
    operation = operate().to(Phase.HOLD)
    if way_down:
        operation.set(posture_desired_state=(0, 0, 0.4, 0, 0, -0.01))
        operation.command(Command.STOP)
        assert operation["posture_control"].tolist() == [1.0]
    operation.to(Phase.FAULT)
    operation.command(Command.RESET)
    operation.tick()
    assert operation["posture_control"].tolist() == [0.0]
    assert (operation["leg_rate"] > 0.0).all()


def test_a_severity_that_is_nan_is_a_fault(operate):
    operation = operate(severity=(math.nan,))
    assert operation.tick() is Phase.FAULT
    assert operation["legs_enable"].tolist() == [0.0]
    assert operation.command(Command.RESET) is Phase.FAULT
