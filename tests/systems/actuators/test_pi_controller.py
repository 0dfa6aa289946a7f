import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiController, PiControllerParams

POLE = 10.0
# Eq. (17): a pure integrator without end stops.
INTEGRATOR = LinearActuatorParams(
    model="integrator", supply_voltage=100.0, stop_min=-100.0, stop_max=100.0
)
AT_REST = {"desired": (0.4,), "measured": (0.4,), "enable": (1.0,)}


@pytest.fixture
def fix(fix):
    """fix(...) that takes the halves of `desired_state` apart, as `desired` and `desired_rate`.

    A half that is not given stays as it is; the rates begin at zero.
    """

    def fix_halves(controller, context, **inputs):
        names = ("desired", "desired_rate")
        given = {name: inputs.pop(name) for name in names if name in inputs}
        if given:
            port = controller.GetInputPort("desired_state")
            n = controller.channels
            halves = np.split(port.Eval(context) if port.HasValue(context) else np.zeros(2 * n), 2)
            state = [given.get(name, half) for name, half in zip(names, halves, strict=True)]
            assert [len(half) for half in state] == [n, n]
            inputs["desired_state"] = np.concatenate(state)
        fix(controller, context, **inputs)

    return fix_halves


class Loop:
    """One actuator under PI control, whose inputs are fixed by the test."""

    def __init__(self, period=0.01, params=PiControllerParams(), start=0.0):
        builder = DiagramBuilder()
        self.controller = builder.AddSystem(PiController(params, channels=1, period=period))
        self.plant = builder.AddSystem(LinearActuator(INTEGRATOR, channels=1, time_step=period))
        builder.Connect(
            self.controller.GetOutputPort("voltage"), self.plant.GetInputPort("voltage")
        )
        builder.Connect(
            self.plant.GetOutputPort("extension"), self.controller.GetInputPort("measured")
        )
        for name in ("desired_state", "enable"):
            builder.ExportInput(self.controller.GetInputPort(name), name)
        position = LogVectorOutput(self.plant.GetOutputPort("extension"), builder, period)
        voltage = LogVectorOutput(self.controller.GetOutputPort("voltage"), builder, period)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.plant.set_extension(self.plant.GetMyMutableContextFromRoot(self.context), start)
        self.logs = [log.FindLog(self.context) for log in (position, voltage)]
        self.state = [start, 0.0]
        self.diagram.GetInputPort("enable").FixValue(self.context, [1.0])
        self.set()

    def set(self, **halves):
        for name, value in halves.items():
            self.state[("desired", "desired_rate").index(name)] = value
        self.diagram.GetInputPort("desired_state").FixValue(self.context, self.state)

    def run(self, until):
        self.simulator.AdvanceTo(until)
        position, voltage = self.logs
        return (
            position.sample_times().copy(),
            position.data()[0].copy(),
            voltage.data()[0].copy(),
        )


def tick(controller, context):
    """One update, in place; returns the voltages."""
    state = controller.EvalUniquePeriodicDiscreteUpdate(context)
    for i in range(state.num_groups()):
        context.SetDiscreteState(i, state.value(i))
    return controller.GetOutputPort("voltage").Eval(context)


def begun(controller, fix, **inputs):
    """A context in which control has begun at rest."""
    context = controller.CreateDefaultContext()
    fix(controller, context, **(AT_REST | inputs))
    tick(controller, context)
    return context


def test_default_gains_are_those_of_equation_32():
    params = PiControllerParams()
    assert params.k_p == pytest.approx(10_000.0, rel=1e-15)
    assert params.k_v == pytest.approx(2_000.0, rel=1e-15)


@pytest.mark.parametrize(("gain", "pole"), [(0.01, 10.0), (0.02, 5.0), (0.0085, 17.0)])
def test_gains_place_a_double_pole(gain, pole):
    params = PiControllerParams(gain=gain, pole=pole)
    # s^2 + K_v K s + K_p K, Eq. (21) with E4.
    roots = np.roots((1.0, params.k_v * gain, params.k_p * gain))
    np.testing.assert_allclose(roots, -pole, rtol=1e-6)


def step_error(period):
    """Largest distance of the sampled step response from the critically damped one."""
    loop = Loop(period)
    loop.run(0.1)
    loop.set(desired=1e-3)
    time, position, _ = loop.run(1.1)
    t = np.maximum(time - 0.1, 0.0)
    # s / (s + p)^2: a unit step of the reference, which the zero of R(s) lets overshoot.
    exact = 1e-3 * (1.0 - (1.0 - POLE * t) * np.exp(-POLE * t))
    return np.abs(position - exact)[time > 0.1 + 1e-9].max()


def test_step_response_converges_to_the_double_pole_with_the_period():
    errors = [step_error(period) for period in (0.005, 0.0025, 0.00125)]
    assert errors[0] < 0.15e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


def test_bumpless_start_away_from_the_reference_is_critically_damped():
    errors = []
    for period in (0.004, 0.002):
        loop = Loop(period)
        loop.set(desired=1e-3)
        time, position, _ = loop.run(1.0)
        # e'' + 2 p e' + p^2 e = 0 from rest.
        exact = 1e-3 * (1.0 - (1.0 + POLE * time) * np.exp(-POLE * time))
        errors.append(np.abs(position - exact).max())
        assert position.max() <= 1e-3 * (1.0 + 1e-3)
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_constant_disturbance_leaves_no_error():
    loop = Loop(0.005)
    plant_context = loop.plant.GetMyMutableContextFromRoot(loop.context)
    loop.plant.set_gain_scale(plant_context, 0.85)
    loop.set(desired=2e-3)
    _, position, _ = loop.run(4.0)
    assert position[-1] == pytest.approx(2e-3, abs=1e-12)


@pytest.mark.parametrize(("share", "lag"), [(0.0, 1.0), (0.3, 0.7), (1.0, 0.0)])
def test_rate_feedforward_removes_its_share_of_the_lag_behind_an_accelerating_reference(
    share, lag
):
    acceleration, period = 0.01, 1e-3
    loop = Loop(period, PiControllerParams(rate_feedforward=share))
    for t in (np.arange(2000) * period).tolist():
        loop.set(desired=0.5 * acceleration * t**2, desired_rate=acceleration * t)
        loop.run(t + 0.5 * period)
    error = 0.5 * acceleration * 2.0**2 - loop.run(2.0 + 0.5 * period)[1][-1]
    # e'' + 2 p e' + p^2 e = r'' without feedforward; sampling adds less than two periods of rate.
    assert error == pytest.approx(lag * acceleration / POLE**2, abs=0.25 * acceleration / POLE**2)


def test_voltage_saturates_at_the_limit_either_way(fix):
    controller = PiController(PiControllerParams(voltage_limit=7.0), channels=2)
    context = begun(controller, fix, desired=(0.4, 0.4), measured=(0.4, 0.4))
    fix(controller, context, desired=(0.5, 0.3))
    assert tick(controller, context).tolist() == [7.0, -7.0]


def test_overshoot_after_saturation_does_not_grow_with_its_duration():
    overshoots = []
    for distance in (0.1, 0.2, 0.4):
        loop = Loop(0.005)
        loop.run(0.1)
        loop.set(desired=distance)
        _, position, voltage = loop.run(0.1 + 10.0 * distance + 1.5)
        assert np.count_nonzero(voltage == 10.0) > 150
        overshoots.append(position.max() - distance)
        assert position[-1] == pytest.approx(distance, abs=1e-5)
    np.testing.assert_allclose(overshoots, overshoots[0], rtol=0.3, atol=1e-4)
    # Without saturation a step of the reference overshoots by e^-2 = 13.5 %.
    assert max(overshoots) < 0.05 * 0.1


def test_integral_is_not_wound_up_by_saturation(fix):
    controller = PiController(channels=1)
    context = begun(controller, fix)
    fix(controller, context, desired=(0.45,))
    for _ in range(1000):
        tick(controller, context)
    fix(controller, context, desired=(0.4,))
    assert abs(tick(controller, context)[0]) < 1e-9


def test_nothing_jumps_when_control_begins(fix):
    controller = PiController(channels=2)
    context = controller.CreateDefaultContext()
    fix(controller, context, desired=(0.42, 0.39), measured=(0.40, 0.40), enable=(1.0,))
    assert tick(controller, context).tolist() == [0.0, 0.0]
    second = tick(controller, context)
    # K_p T e = 10^4 * .01 * .02 and -.01.
    np.testing.assert_allclose(second, (2.0, -1.0), rtol=1e-9)


def test_nothing_jumps_when_control_begins_again(fix):
    controller = PiController(channels=1)
    context = begun(controller, fix)
    fix(controller, context, desired=(0.401,))
    for _ in range(20):
        tick(controller, context)
    fix(controller, context, enable=(0.0,))
    assert tick(controller, context).tolist() == [0.0]
    fix(controller, context, desired=(0.38,), enable=(1.0,))
    assert tick(controller, context).tolist() == [0.0]
    assert tick(controller, context)[0] == pytest.approx(-2.0, rel=1e-9)


@pytest.mark.parametrize("enable", [0.0, 0.5, math.nan])
def test_disabled_controller_outputs_nothing(fix, enable):
    controller = PiController(channels=1)
    context = begun(controller, fix)
    fix(controller, context, desired=(0.401,), enable=(enable,))
    for _ in range(3):
        assert tick(controller, context).tolist() == [0.0]


def test_proportional_and_integral_parts_by_hand(fix):
    controller = PiController(channels=1, period=0.02)
    context = begun(controller, fix)
    fix(controller, context, desired=(0.402,))
    # 2000 * .002, then plus 10000 * .02 * .002 once and twice.
    for expected in (4.0, 4.4, 4.8):
        assert tick(controller, context)[0] == pytest.approx(expected, rel=1e-9)


def test_rate_is_fed_forward_as_rate_over_gain(fix):
    controller = PiController(PiControllerParams(rate_feedforward=0.5), channels=1)
    context = begun(controller, fix, desired_rate=(0.0,))
    fix(controller, context, desired_rate=(0.03,))
    assert tick(controller, context)[0] == pytest.approx(0.5 * 0.03 / 0.01, rel=1e-9)


def test_friction_is_fed_forward_by_direction_and_fades_with_the_rate(fix):
    params = PiControllerParams(friction_feedforward=(0.3, 0.2), friction_rate=1e-4)
    controller = PiController(params, channels=5)
    fives = {name: np.full(5, 0.4) for name in ("desired", "measured")}
    context = begun(controller, fix, desired_rate=np.zeros(5), **fives)
    fix(controller, context, desired_rate=(1.0, 1e-4, 0.0, -1e-4, -1.0))
    expected = (0.3, 0.15, 0.0, -0.1, -0.2)
    np.testing.assert_allclose(tick(controller, context), expected, atol=1e-4)


def test_rate_of_zero_feeds_nothing_forward(fix):
    params = PiControllerParams(rate_feedforward=1.0, friction_feedforward=(0.3, 0.2))
    controller = PiController(params, channels=1)
    context = begun(controller, fix, desired_rate=(0.0,))
    # The integral, which takes up whatever is fed forward when control begins, is left at zero.
    assert context.get_discrete_state(1).value().tolist() == [0.0, 1.0]
    assert tick(controller, context).tolist() == [0.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["desired", "desired_rate", "measured"])
def test_channel_with_bad_input_outputs_nothing_and_keeps_its_integral(fix, name, bad):
    controller = PiController(PiControllerParams(rate_feedforward=1.0), channels=2)
    twos = {key: np.full(2, 0.4) for key in ("desired", "measured")}
    context = begun(controller, fix, desired_rate=np.zeros(2), **twos)
    fix(controller, context, desired=(0.401, 0.401))
    for _ in range(5):
        tick(controller, context)
    integral = context.get_discrete_state(1)[0]
    good = (twos | {"desired": (0.401, 0.401), "desired_rate": (0.0, 0.0)})[name]
    fix(controller, context, **{name: (bad, good[1])})
    voltage = tick(controller, context)
    assert voltage[0] == 0.0
    assert voltage[1] > 0.0
    assert context.get_discrete_state(1)[0] == integral
    fix(controller, context, **{name: good})
    assert tick(controller, context)[0] == pytest.approx(2000.0 * 0.001 + integral, rel=1e-9)


def test_an_error_beyond_its_limit_is_not_followed_and_leaves_the_integral(fix):
    controller = PiController(PiControllerParams(error_limit=0.02), channels=2)
    context = controller.CreateDefaultContext()
    fix(controller, context, desired=(0.41, 0.41), measured=(0.40, 0.40), enable=(1.0,))
    for _ in range(3):
        tick(controller, context)
    # The second encoder shows nothing any more, for a while.
    fix(controller, context, measured=(0.40, 0.0))
    followed, lost = zip(*(tick(controller, context) for _ in range(50)), strict=True)
    assert set(lost) == {0.0}
    assert min(followed) > 1.0
    fix(controller, context, measured=(0.40, 0.40))
    back = tick(controller, context)
    assert 0.0 < back[1] < back[0]


def test_channel_whose_input_is_bad_when_control_begins_begins_later_without_a_jump(fix):
    controller = PiController(channels=1)
    context = begun(controller, fix)
    fix(controller, context, desired=(0.401,))
    for _ in range(20):
        tick(controller, context)
    fix(controller, context, enable=(0.0,))
    tick(controller, context)
    fix(controller, context, desired=(math.nan,), enable=(1.0,))
    assert tick(controller, context).tolist() == [0.0]
    fix(controller, context, desired=(0.42,))
    assert tick(controller, context).tolist() == [0.0]


@pytest.mark.parametrize("element", range(3))
def test_each_parameter_of_the_context_moves_the_voltage(fix, element):
    controller = PiController(channels=1)
    voltages = []
    for scale in (1.0, 0.5):
        context = begun(controller, fix)
        gains = context.get_mutable_numeric_parameter(0)
        gains[element] = gains[element] * scale
        # Large enough to saturate where the limit is asked for.
        fix(controller, context, desired=(0.402 if element < 2 else 0.5,))
        tick(controller, context)
        voltages.append(tick(controller, context)[0])
    assert voltages[0] > voltages[1]


def test_voltage_is_held_between_samples():
    loop = Loop(0.01)
    loop.set(desired=1e-3)
    loop.run(0.051)
    context = loop.controller.GetMyContextFromRoot(loop.context)
    before = loop.controller.GetOutputPort("voltage").Eval(context).copy()
    loop.set(desired=5e-3)
    loop.run(0.059)
    np.testing.assert_array_equal(loop.controller.GetOutputPort("voltage").Eval(context), before)


# Plants that differ


def test_a_channel_with_another_gain_gets_the_voltage_for_the_same_speed(fix, read):
    params = PiControllerParams(rate_feedforward=1.0, gain_share=(1.0, 0.8))
    controller = PiController(params, channels=2)
    context = controller.CreateDefaultContext()
    fix(controller, context, desired=(0.4, 0.4), measured=(0.4, 0.4), enable=(1.0,))
    for _ in range(2):  # the first one is bumpless
        context.SetDiscreteState(controller.EvalUniquePeriodicDiscreteUpdate(context))
    fix(controller, context, desired=(0.401, 0.401), desired_rate=(0.002, 0.002))
    context.SetDiscreteState(controller.EvalUniquePeriodicDiscreteUpdate(context))
    first, second = read(controller, context)["voltage"]
    assert first == pytest.approx(2000.0 * 0.001 + 0.002 / 0.01)
    assert second == pytest.approx(first / 0.8)
    context.SetDiscreteState(controller.EvalUniquePeriodicDiscreteUpdate(context))
    later = read(controller, context)["voltage"] - [first, second]
    assert later[1] == pytest.approx(later[0] / 0.8)  # the integral's gain too


@pytest.mark.parametrize("share", [(1.0,), (1.0, 0.0), (1.0, math.nan), (1.0, -1.0)])
def test_shares_that_no_gain_has_are_refused(share):
    with pytest.raises(ValueError, match="gain_share must"):
        PiController(PiControllerParams(gain_share=share), channels=2)
