import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.systems.actuators.compound_position_controller import (
    MODES,
    CompoundPositionController,
    CompoundPositionControllerParams,
)
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams

PERIOD = 0.01
PARAMS = CompoundPositionControllerParams()
LIMIT = PARAMS.velocity_limit


def controller_with(channels=1, **changes):
    return CompoundPositionController(replace(PARAMS, **changes), channels, PERIOD)


def tick(controller, context, fix, node, measured):
    """One sample; gives the command (n) that follows from it."""
    fix(controller, context, position_node=node, position_measured=measured)
    command = controller.GetOutputPort("velocity_command").Eval(context).copy()
    state = controller.EvalUniquePeriodicDiscreteUpdate(context)
    context.SetDiscreteState(0, state.value())
    return command


def ticks(controller, fix, samples):
    """Commands (k, n) for samples (node, measured) of one channel or of several."""
    context = controller.CreateDefaultContext()
    n = controller.GetInputPort("position_node").size()
    rows = [[np.broadcast_to(value, n) for value in sample] for sample in samples]
    return np.array([tick(controller, context, fix, *row) for row in rows])


def test_an_unknown_mode_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="mode 'compuond' is not one of compound, velocity, posi"):
        CompoundPositionControllerParams(mode="compuond")


# Eqs. (46)-(48) by hand: P = 10 /s, k_p = 0.6, k_i = 0.25, 10 ms
NODES = [(0.6002, 0.6), (0.6005, 0.6001), (0.6009, 0.6004)]


@pytest.mark.parametrize(
    ("mode", "second", "third"),
    [
        # 0.03 + 10 * 0.1e-3 - 0.01 = 0.021, sum 0.041; 0.04 + 10 * 0.1e-3 - 0.03 = 0.011, 0.052.
        ("compound", 0.6 * 0.021 + 0.25 * 0.041, 0.6 * 0.011 + 0.25 * 0.052),
        ("velocity", 0.6 * 0.02 + 0.25 * 0.04, 0.6 * 0.01 + 0.25 * 0.05),
    ],
)
def test_first_samples_follow_the_equations(fix, mode, second, third):
    commands = ticks(controller_with(mode=mode), fix, NODES)
    # The first: nothing is missing yet, and nothing moves.
    first = (0.6 + 0.25) * 0.02
    np.testing.assert_allclose(commands[:, 0], (first, second, third), rtol=1e-9)


def test_position_mode_runs_at_full_speed_to_the_node_that_is_due(fix):
    samples = [(0.6002, 0.6), (0.6004, 0.6), (0.6004, 0.60042), (0.6004, 0.6004)]
    commands = ticks(controller_with(mode="position"), fix, samples)
    assert commands[:, 0].tolist() == [0.0, LIMIT, -LIMIT, 0.0]


def test_position_mode_acts_between_samples_and_stands_still_within_a_count(fix):
    controller = controller_with(mode="position")
    context = controller.CreateDefaultContext()
    tick(controller, context, fix, [0.6002], [0.6])
    speeds = []
    for missing in (1e-4, 5.1e-6, 4.9e-6, 0.0, -4.9e-6, -5.1e-6):
        fix(controller, context, position_measured=[0.6002 - missing])
        speeds.append(controller.GetOutputPort("velocity_command").Eval(context)[0])
    assert speeds == [LIMIT, LIMIT, 0.0, 0.0, 0.0, -LIMIT]


@pytest.mark.parametrize("mode", MODES)
def test_control_begins_at_rest_where_the_drives_are(fix, mode):
    commands = ticks(controller_with(mode=mode), fix, [(0.65, 0.65)] * 5)
    assert not commands.any()


def test_channels_do_not_know_of_each_other(fix):
    others = [(node + 0.05, measured - 0.01) for node, measured in NODES]
    both = [tuple(zip(*rows, strict=True)) for rows in zip(NODES, others, strict=True)]
    together = ticks(controller_with(channels=2), fix, both)
    for channel, samples in enumerate((NODES, others)):
        alone = ticks(controller_with(), fix, samples)
        np.testing.assert_array_equal(together[:, channel], alone[:, 0])


# Limits


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("away", [0.01, -0.01, 1e6, -1e300])
def test_command_is_within_the_limit_whatever_is_missing(fix, mode, away):
    commands = ticks(controller_with(mode=mode), fix, [(0.6 + away, 0.6)] * 4)
    assert np.abs(commands).max() <= LIMIT
    # A node is due one sample after it was given.
    assert commands[1 if mode == "position" else 0] == math.copysign(LIMIT, away)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sums_are_held_while_the_command_is_saturated(fix, sign):
    # Ten samples at the limit, after which an error of 0.02 m/s is answered as by a new one.
    far = [(0.6 + 0.01 * sign * k, 0.6) for k in range(1, 11)]
    then = (far[-1][0] + 0.0002 * sign, 0.6)
    commands = ticks(controller_with(mode="velocity"), fix, [*far, then])
    assert (commands[:-1] == sign * LIMIT).all()
    assert commands[-1, 0] == pytest.approx(sign * (0.6 + 0.25) * 0.02)


def test_sums_go_on_where_the_command_is_within_the_limit(fix):
    controller = controller_with(channels=2, mode="velocity")
    context = controller.CreateDefaultContext()
    for _ in range(3):
        tick(controller, context, fix, [0.6, 0.6], [0.6, 0.6])
    tick(controller, context, fix, [0.6 + 0.0002, 0.7], [0.6, 0.6])
    sums = context.get_discrete_state_vector().value()[4:6]
    np.testing.assert_allclose(sums, (0.02, 0.0), atol=1e-12)


# Bad input


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("port", ["position_node", "position_measured"])
def test_a_channel_without_a_finite_number_stands_still_and_recovers(fix, mode, bad, port):
    controller = controller_with(channels=2, mode=mode)
    good = controller_with(channels=2, mode=mode)
    contexts = [system.CreateDefaultContext() for system in (controller, good)]
    # Full speed is towards the node of the sample before.
    is_late = port == "position_node" and mode == "position"
    without = range(5, 8) if is_late else range(4, 7)
    for k in range(12):
        node, measured = 0.6 + 1e-4 * (k + 1), 0.6 + 0.9e-4 * k
        given = {"position_node": [node] * 2, "position_measured": [measured] * 2}
        expected = tick(good, contexts[1], fix, *given.values())
        if 4 <= k < 7:
            given[port] = [given[port][0], bad]
        sums = contexts[0].get_discrete_state_vector().value()[4:6].copy()
        command = tick(controller, contexts[0], fix, *given.values())
        assert np.isfinite(command).all()
        assert command[0] == expected[0]
        if k in without:
            assert command[1] == 0.0
            assert contexts[0].get_discrete_state_vector().value()[5] == sums[1]
    assert command[1] != 0.0


# Switching on and off


@pytest.mark.parametrize("mode", MODES)
def test_without_enable_it_always_controls_and_at_zero_it_never_does(fix, mode):
    for enable, is_still in (
        (None, False),
        (1.0, False),
        (0.0, True),
        (0.5, True),
        (math.nan, True),
    ):
        controller = controller_with(mode=mode)
        context = controller.CreateDefaultContext()
        if enable is not None:
            fix(controller, context, enable=[enable])
        tick(controller, context, fix, [0.601], [0.6])
        command = tick(controller, context, fix, [0.602], [0.6])
        assert (command[0] == 0.0) == is_still


@pytest.mark.parametrize("mode", MODES)
def test_it_forgets_everything_while_it_is_off(fix, mode):
    controller = controller_with(mode=mode)
    context = controller.CreateDefaultContext()
    fix(controller, context, enable=[1.0])
    for node, measured in NODES:
        tick(controller, context, fix, [node], [measured])
    fix(controller, context, enable=[0.0])
    assert tick(controller, context, fix, [0.8], [0.7]) == 0.0
    assert not context.get_discrete_state_vector().value().any()
    fix(controller, context, enable=[1.0])
    again = [tick(controller, context, fix, [node], [measured])[0] for node, measured in NODES]
    assert again == ticks(controller_with(mode=mode), fix, NODES)[:, 0].tolist()


# Laws, with a drive


AMPLITUDE, RATE, LAG = 0.05, 1.0, 0.04


class Loop:
    """One drive on a sine, which it starts at full speed."""

    def __init__(self, period=PERIOD, gain=1.0, offset=0.0, until=8.0, **changes):
        builder = DiagramBuilder()
        times = np.arange(0.0, until + 1.0, 2e-3)
        nodes = AMPLITUDE * np.sin(RATE * (times + period))
        source = builder.AddSystem(
            TrajectorySource(PiecewisePolynomial.CubicShapePreserving(times, nodes[np.newaxis]))
        )
        params = replace(PARAMS, **changes)
        controller = builder.AddSystem(CompoundPositionController(params, 1, period))
        drive = VelocityServoParams(resolution=0.0, time_constant=LAG, max_velocity=LIMIT)
        servo = builder.AddSystem(VelocityServo(drive, 1, period, 1e-3))
        brake = builder.AddSystem(ConstantVectorSource([0.0]))
        for output, system, port in (
            (source.get_output_port(), controller, "position_node"),
            (servo.GetOutputPort("position_measured"), controller, "position_measured"),
            (controller.GetOutputPort("velocity_command"), servo, "velocity_command"),
            (brake.get_output_port(), servo, "brake"),
        ):
            builder.Connect(output, system.GetInputPort(port))
        log = LogVectorOutput(servo.GetOutputPort("state"), builder, 1e-3)
        simulator = Simulator(builder.Build())
        context = simulator.get_mutable_context()
        servo.set_position(context, [0.0])
        servo.set_imperfection(context, gain, offset)
        simulator.AdvanceTo(until)
        found = log.FindLog(context)
        self.time, self.position = found.sample_times().copy(), found.data()[0].copy()
        self.error = AMPLITUDE * np.sin(RATE * self.time) - self.position

    def largest(self, begin, end=math.inf):
        return np.abs(self.error[(self.time >= begin) & (self.time <= end)]).max()


def test_compound_error_halves_when_p_doubles():
    errors = [Loop(proportional=P).largest(2.0) for P in (5.0, 10.0, 20.0)]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.06)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.06)


def test_compound_error_doubles_with_the_period():
    errors = [Loop(period=period).largest(2.0) for period in (0.005, 0.01, 0.02)]
    assert errors[1] / errors[0] == pytest.approx(2.0, rel=0.15)
    assert errors[2] / errors[1] == pytest.approx(2.0, rel=0.15)


def test_imperfect_drives_are_followed_by_the_sum():
    perfect, imperfect = Loop(), Loop(gain=1.02, offset=-1e-3)
    assert imperfect.largest(2.0) == pytest.approx(perfect.largest(2.0), rel=0.1)


def test_velocity_mode_keeps_the_position_lost_at_the_start_and_does_not_lose_more():
    # One turn after the start, and another.
    first, second = 1.0 + 2.0 * math.pi / RATE, 1.0 + 4.0 * math.pi / RATE
    loop = Loop(mode="velocity", gain=1.02, offset=-1e-3, until=second)
    assert loop.largest(0.0, 0.5) > 1e-3
    assert loop.largest(first, second) == pytest.approx(loop.largest(1.0, first), rel=0.01)
    assert loop.largest(1.0) > 5.0 * Loop(gain=1.02, offset=-1e-3).largest(1.0)


def test_without_the_sum_the_velocity_mode_drifts():
    loop = Loop(mode="velocity", k_i=0.0, k_p=1.0, offset=-1e-3)
    middle, end = loop.error[loop.time == 4.0][0], loop.error[-1]
    assert end - middle > 1e-3
