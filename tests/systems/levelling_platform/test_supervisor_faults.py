"""Faults in an operation: what they stop, and how the operator goes on."""

import math

import pytest

from parapod.systems.levelling_platform.supervisor import Command, Phase, Refusal
from parapod.systems.safety.faults import Severity

NOTHING_REFUSED = (Refusal.NONE, 0.0)
RESET_REFUSED = (Refusal.CAUSE, float(Phase.FAULT))


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.FAULT}))
def test_a_fault_of_severity_hold_or_more_stops_every_phase(operate, phase):
    operation = operate().to(phase).tick(severity=Severity.WARN)
    assert operation.phase is not Phase.FAULT
    assert operation.tick(severity=Severity.HOLD).phase is Phase.FAULT
    assert operation["wheel_velocity_command"].tolist() == [0.0] * 4
    assert operation["wheel_brake"] == 1.0
    assert operation["leg_rate"].tolist() == [0.0] * 4
    assert operation["posture_control"] == 0.0
    assert operation["arm_enable"] == 0.0


@pytest.mark.parametrize("severity", Severity)
def test_legs_are_without_voltage_from_severity_brake_on(operate, severity):
    operation = operate().to(Phase.FAULT).tick(severity=severity)
    assert operation["legs_enable"] == float(severity < Severity.BRAKE)
    assert operation["legs_stop"] == float(severity >= Severity.BRAKE)


def test_a_reset_is_refused_until_the_fault_is_gone(operate):
    operation = operate().to(Phase.FAULT)
    operation.tick(4, severity=Severity.HOLD, operator=Command.RESET)
    assert operation.phase is Phase.FAULT
    assert operation.refusal == RESET_REFUSED
    assert operation.wait(0.5, severity=Severity.WARN).phase is Phase.FAULT
    operation.tick(operator=0.0)
    assert operation.command(Command.RESET).phase is Phase.STANDBY
    assert operation["legs_enable"] == 1.0


@pytest.mark.parametrize("severity", [Severity.HOLD, Severity.BRAKE])
@pytest.mark.parametrize("periods", [1, 2, 3])
def test_a_reset_waits_for_the_findings_that_end_with_it(operate, severity, periods):
    operation = operate().to(Phase.FAULT)
    assert operation.tick(periods, severity=severity, operator=Command.RESET).phase is Phase.FAULT
    assert operation.refusal == NOTHING_REFUSED
    assert operation.tick(severity=Severity.WARN).phase is Phase.STANDBY
    assert operation.refusal == NOTHING_REFUSED
    assert operation["legs_stop"] == 0.0


def test_a_reset_that_was_refused_does_not_shorten_the_next_one_s_wait(operate):
    operation = operate().to(Phase.FAULT)
    for _ in range(2):
        operation.tick(4, severity=Severity.HOLD, operator=Command.RESET)
        assert operation.refusal == RESET_REFUSED
        operation.wait(0.5, operator=0.0)
    operation.tick(3, operator=Command.RESET)
    assert operation.tick(severity=Severity.NONE).phase is Phase.STANDBY


def test_a_reset_that_is_taken_back_while_it_waits_is_forgotten(operate):
    operation = operate().to(Phase.FAULT).set(severity=Severity.HOLD)
    operation.command(Command.RESET).tick()
    assert operation.wait(0.5, severity=Severity.NONE).phase is Phase.FAULT
    assert operation.refusal == NOTHING_REFUSED
    # The next one waits as long as the first.
    operation.tick(3, severity=Severity.HOLD, operator=Command.RESET)
    assert operation.refusal == NOTHING_REFUSED
    assert operation.tick(severity=Severity.NONE).phase is Phase.STANDBY


@pytest.mark.parametrize("way_down", [False, True])
def test_after_a_fault_legs_go_up_at_once_even_if_it_was_on_the_way_down(operate, way_down):
    operation = operate().to(Phase.HOLD)
    if way_down:
        operation.set(posture_desired_state=(0, 0, 0.4, 0, 0, -0.01)).command(Command.STOP)
        assert operation["posture_control"] == 1.0
    operation.to(Phase.FAULT).command(Command.RESET)
    for _ in range(50):  # until it is told to
        assert operation.tick()["leg_rate"].tolist() == [0.0] * 4
    operation.command(Command.STOP).tick()
    assert operation["posture_control"] == 0.0
    assert (operation["leg_rate"] > 0.0).all()


def test_a_severity_that_is_nan_is_a_fault(operate):
    operation = operate(severity=math.nan).tick()
    assert operation.phase is Phase.FAULT
    assert operation["legs_enable"] == 0.0
    assert operation.command(Command.RESET).phase is Phase.FAULT
