import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams, Stepper

PARAMS = LinearActuatorParams()
# Room to run: no end stop is met.
FREE = replace(PARAMS, stop_min=-100.0, stop_max=100.0)
K = 0.01  # Eq. (18)
COULOMB_SPEED = PARAMS.coulomb_friction / PARAMS.viscous_friction
# A foot's share of the weight seen by the actuator (section 5.2): 125 N times 5.9.
FOOT_LOAD = 740.0


def start(actuator, fix, voltage, load=None, extension=0.42):
    simulator = Simulator(actuator)
    context = simulator.get_mutable_context()
    n = actuator.channels
    fix(actuator, context, voltage=np.broadcast_to(voltage, n))
    if load is not None:
        fix(actuator, context, load_force=np.broadcast_to(load, n))
    actuator.set_extension(context, extension)
    return simulator, context


def run(actuator, fix, duration, voltage, load=None, extension=0.42):
    simulator, context = start(actuator, fix, voltage, load, extension)
    simulator.AdvanceTo(duration - 0.25 * actuator.time_step)
    return tuple(actuator.GetOutputPort(name).Eval(context) for name in ("extension", "velocity"))


def stepped(params, state, voltage, load, duration, parts):
    stepper = Stepper(params, duration / parts)
    for _ in range(parts):
        state = stepper.step(params.motor_constant, *state, voltage, load)
    return state


def steady_speed(voltage, load, params=FREE):
    return stepped(params, (0.0, 0.0), voltage, load, 40.0 * 0.01, 1)[1]


def test_gain_is_that_of_equation_18():
    assert PARAMS.gain == pytest.approx(0.01, rel=1e-15)


@pytest.mark.parametrize("voltage", [-10.0, -0.3, 0.01, 7.0])
def test_integrator_moves_by_gain_times_voltage_times_time(fix, voltage):
    params = replace(FREE, model="integrator")
    actuator = LinearActuator(params, channels=2, time_step=0.01)
    extension, velocity = run(actuator, fix, 0.5, voltage, load=5e4, extension=0.0)
    np.testing.assert_allclose(extension, K * voltage * 0.5, rtol=1e-13)
    np.testing.assert_allclose(velocity, K * voltage, rtol=1e-13)


@pytest.mark.parametrize("voltage", [2.0, 5.0, 10.0, -2.0, -5.0, -10.0])
def test_unloaded_speed_is_gain_times_voltage_minus_coulomb_friction(voltage):
    expected = K * voltage - math.copysign(COULOMB_SPEED, voltage)
    assert steady_speed(voltage, 0.0) == pytest.approx(expected, rel=1e-14)


def test_speed_rises_as_the_exact_solution_of_equation_15():
    limit = K * 6.0 - COULOMB_SPEED
    tau = PARAMS.inertia / PARAMS.viscous_friction
    assert tau == pytest.approx(0.01, rel=1e-15)
    for t in (1e-4, 3e-3, 0.01, 0.2):
        position, velocity = stepped(FREE, (0.0, 0.0), 6.0, 0.0, t, 1)
        assert velocity == pytest.approx(limit * -math.expm1(-t / tau), rel=1e-12)
        expected = limit * (t + tau * math.expm1(-t / tau))
        assert position == pytest.approx(expected, rel=1e-9)


def test_equation_15_holds_along_the_motion():
    h = 1e-5
    stepper = Stepper(FREE, h)
    state, voltage, load = (0.0, 0.02), 3.0, 200.0
    for _ in range(20):
        ahead = stepper.step(FREE.motor_constant, *state, voltage, load)
        acceleration = (ahead[1] - state[1]) / h
        middle = 0.5 * (ahead[1] + state[1])
        resistance = FREE.coulomb_friction + load / FREE.screw_efficiency
        force = FREE.inertia * acceleration + FREE.viscous_friction * middle + resistance
        assert force == pytest.approx(FREE.motor_constant * voltage, rel=1e-6)
        state = ahead


def random_cases(count, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield (
            (float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.1, 0.1))),
            float(rng.uniform(-12.0, 12.0)),
            float(rng.uniform(-2000.0, 2000.0)),
            float(10.0 ** rng.uniform(-4.0, -1.0)),
        )


@pytest.mark.parametrize("efficiency", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("parts", [2, 7])
def test_step_does_not_depend_on_how_it_is_split(efficiency, parts):
    params = replace(FREE, screw_efficiency=efficiency)
    for state, voltage, load, duration in random_cases(300, seed=0):
        whole = stepped(params, state, voltage, load, duration, 1)
        split = stepped(params, state, voltage, load, duration, parts)
        np.testing.assert_allclose(split, whole, rtol=0.0, atol=1e-14)


def test_step_that_stops_the_rod_does_not_depend_on_how_it_is_split():
    stopped = 0
    for state, _, load, duration in random_cases(300, seed=1):
        whole = stepped(FREE, state, 0.02, load, duration, 1)
        split = stepped(FREE, state, 0.02, load, duration, 2)
        np.testing.assert_allclose(split, whole, rtol=0.0, atol=1e-14)
        stopped += whole[1] == 0.0
    assert stopped > 20


def test_step_into_an_end_stop_does_not_depend_on_how_it_is_split():
    for velocity, voltage in ((0.05, 5.0), (-0.05, -5.0), (0.0, 12.0)):
        start_at = 0.459 if voltage > 0.0 else 0.381
        whole = stepped(PARAMS, (start_at, velocity), voltage, 0.0, 0.1, 1)
        split = stepped(PARAMS, (start_at, velocity), voltage, 0.0, 0.1, 2)
        assert split == whole


@pytest.mark.parametrize("duration", [0.01, 0.001])
def test_rod_that_turns_back_at_an_end_stop_within_a_step_is_late_by_less_than_a_step(duration):
    # .02 mm before the stop at .1 m/s, with full voltage back: the impact is not located.
    state = (PARAMS.stop_max - 2e-5, 0.1)
    steps = round(0.03 / duration)
    coarse = stepped(PARAMS, state, -12.0, 0.0, 0.03, steps)
    fine = stepped(PARAMS, state, -12.0, 0.0, 0.03, 30_000)
    assert abs(coarse[0] - fine[0]) < abs(K * 12.0) * duration
    assert coarse[0] <= PARAMS.stop_max


@pytest.mark.parametrize("load", [-1e5, -FOOT_LOAD, 0.0, FOOT_LOAD, 1e5])
def test_without_voltage_no_load_moves_it(fix, load):
    actuator = LinearActuator(channels=1)
    extension, velocity = run(actuator, fix, 0.1, 0.0, load=load)
    assert extension == 0.42
    assert velocity == 0.0


@pytest.mark.parametrize("voltage", [-0.049, 0.0, 0.049, -0.051, 0.051])
def test_voltage_moves_it_outside_friction_alone(fix, voltage):
    # 1000 N of friction are .05 V at 2e4 N/V.
    extension, velocity = run(LinearActuator(channels=1), fix, 0.1, voltage)
    if abs(voltage) < 0.05:
        assert (extension, velocity) == (0.42, 0.0)
    else:
        assert (extension[0] - 0.42) * voltage > 0.0


def test_moving_rod_stops_by_friction_and_stays():
    state = (0.0, 0.05)
    position, velocity = stepped(FREE, state, 0.0, 0.0, 1.0, 1)
    assert velocity == 0.0
    assert 0.0 < position < 0.05 * FREE.inertia / FREE.viscous_friction
    assert stepped(FREE, (position, 0.0), 0.0, 0.0, 1.0, 3) == (position, 0.0)


def test_efficient_screw_is_driven_back_by_the_load_and_a_poor_one_is_not():
    load = 1e4
    for efficiency, along in ((0.5, 0.0), (0.3, 0.0), (0.8, 0.75)):
        params = replace(FREE, screw_efficiency=efficiency)
        speed = steady_speed(0.0, load, params)
        drive = max(0.0, along * load - FREE.coulomb_friction)
        assert speed == pytest.approx(-drive / FREE.viscous_friction, rel=1e-12)


def test_load_against_the_motion_costs_load_over_efficiency_and_one_along_it_nothing():
    for load, voltage in ((FOOT_LOAD, 5.0), (-FOOT_LOAD, -5.0)):
        expected = abs(K * voltage) - COULOMB_SPEED - 2.0 * FOOT_LOAD / FREE.viscous_friction
        assert abs(steady_speed(voltage, load)) == pytest.approx(expected, rel=1e-12)
        assert steady_speed(-voltage, load) == pytest.approx(-steady_speed(voltage, 0.0))


@pytest.mark.parametrize("load", [-FOOT_LOAD, 0.0, FOOT_LOAD])
def test_gain_stays_within_15_percent_of_the_nominal_from_2_to_10_volts(load):
    for voltage in np.linspace(2.0, 10.0, 10).tolist():
        for signed in (voltage, -voltage):
            assert steady_speed(signed, load) / signed == pytest.approx(K, rel=0.15)


@pytest.mark.parametrize("model", ["dynamic", "integrator"])
@pytest.mark.parametrize("voltage", [12.1, 1e6, math.inf])
def test_voltage_saturates_at_the_supply(fix, model, voltage):
    actuator = LinearActuator(replace(FREE, model=model), channels=2)
    signs = np.array((1.0, -1.0))
    beyond = run(actuator, fix, 0.05, voltage * signs, extension=0.0)
    at_supply = run(actuator, fix, 0.05, 12.0 * signs, extension=0.0)
    np.testing.assert_array_equal(beyond, at_supply)


@pytest.mark.parametrize("model", ["dynamic", "integrator"])
def test_end_stops_hold_the_rod_and_let_it_go(fix, model):
    params = replace(PARAMS, model=model)
    actuator = LinearActuator(params, channels=2)
    simulator, context = start(actuator, fix, (12.0, -12.0), load=0.0)
    simulator.AdvanceTo(2.0)
    extension = actuator.GetOutputPort("extension").Eval(context)
    assert extension.tolist() == [params.stop_max, params.stop_min]
    assert actuator.GetOutputPort("velocity").Eval(context).tolist() == [0.0, 0.0]
    fix(actuator, context, voltage=(-2.0, 2.0))
    simulator.AdvanceTo(2.1)
    released = actuator.GetOutputPort("extension").Eval(context)
    assert released[0] < params.stop_max - 1e-3
    assert released[1] > params.stop_min + 1e-3


def test_without_inertia_the_limit_speed_is_taken_at_once():
    params = replace(FREE, inertia=0.0)
    position, velocity = stepped(params, (0.0, 0.0), 5.0, 0.0, 0.01, 1)
    assert velocity == pytest.approx(K * 5.0 - COULOMB_SPEED, rel=1e-14)
    assert position == pytest.approx(0.01 * velocity, rel=1e-14)
    assert stepped(params, (0.0, velocity), 0.0, 0.0, 0.01, 1) == (0.0, 0.0)


def test_without_inertia_the_rod_turns_back_at_once():
    params = replace(FREE, inertia=0.0)
    light = replace(FREE, inertia=1e-6)
    for velocity, voltage in ((0.05, -5.0), (-0.05, 5.0)):
        expected = stepped(light, (0.0, velocity), voltage, 0.0, 0.01, 1)
        turned = stepped(params, (0.0, velocity), voltage, 0.0, 0.01, 1)
        np.testing.assert_allclose(turned, expected, rtol=0.0, atol=1e-9)


def test_gain_scale_scales_the_integrators_speed_channel_by_channel(fix, read):
    actuator = LinearActuator(replace(FREE, model="integrator"), channels=3)
    context = actuator.CreateDefaultContext()
    fix(actuator, context, voltage=(1.0, 1.0, 1.0))
    actuator.set_gain_scale(context, (0.85, 1.0, 1.15))
    speeds = read(actuator, context)["next_state"][3:]
    np.testing.assert_allclose(speeds, K * np.array((0.85, 1.0, 1.15)), rtol=1e-14)


def test_channels_do_not_influence_each_other(fix):
    many = LinearActuator(FREE, channels=3)
    voltage, load = np.array((4.0, -2.0, 0.0)), np.array((100.0, -300.0, 50.0))
    together = run(many, fix, 0.05, voltage, load)
    for i in range(3):
        alone = run(LinearActuator(FREE, channels=1), fix, 0.05, voltage[i], load[i])
        np.testing.assert_array_equal([v[i] for v in together], [v[0] for v in alone])


def test_state_one_step_ahead_is_the_state_one_step_later(fix):
    actuator = LinearActuator(channels=2)
    simulator, context = start(actuator, fix, (5.0, -3.0), load=(0.0, 500.0))
    simulator.AdvanceTo(0.0105)
    ahead = actuator.GetOutputPort("next_state").Eval(context)
    simulator.AdvanceTo(0.0115)
    now = [actuator.GetOutputPort(name).Eval(context) for name in ("extension", "velocity")]
    np.testing.assert_array_equal(ahead, np.concatenate(now))


def test_nan_voltage_is_none_and_nan_load_is_none(fix):
    actuator = LinearActuator(channels=2)
    bad = run(actuator, fix, 0.05, (math.nan, 5.0), load=(0.0, math.nan))
    good = run(actuator, fix, 0.05, (0.0, 5.0), load=(0.0, 0.0))
    np.testing.assert_array_equal(bad, good)


def test_rods_rest_in_the_middle_of_the_stops_by_default(read, fix):
    actuator = LinearActuator()
    context = actuator.CreateDefaultContext()
    fix(actuator, context, voltage=np.zeros(4))
    np.testing.assert_allclose(read(actuator, context)["extension"], 0.42, rtol=1e-15)


def test_derivatives_through_a_change_of_direction_agree_with_differences():
    # A step in which the rod stops and leaves backwards.
    state, voltage, load, duration = (0.0, 0.004), -2.0, 0.0, 0.02
    stepper = Stepper(FREE, duration)
    assert stepper.step(FREE.motor_constant, *state, voltage, load)[1] < 0.0
    x = InitializeAutoDiff(np.array((*state, voltage))).flatten()
    exact = [value.derivatives() for value in stepper.step(FREE.motor_constant, *x, load)]
    for i, step in enumerate((1e-6, 1e-7, 1e-5)):
        ahead, behind = np.array((*state, voltage)), np.array((*state, voltage))
        ahead[i] += step
        behind[i] -= step
        difference = np.subtract(
            stepper.step(FREE.motor_constant, *ahead.tolist(), load),
            stepper.step(FREE.motor_constant, *behind.tolist(), load),
        ) / (2.0 * step)
        np.testing.assert_allclose([row[i] for row in exact], difference, rtol=0.0, atol=1e-7)


# Stop


def stopped(fix, stop, voltage=5.0, duration=0.3, **settings):
    """Extension and velocity after a while at a voltage; the stop is not connected if None."""
    actuator = LinearActuator(FREE, time_step=0.01)
    simulator, context = start(actuator, fix, voltage, extension=0.0, **settings)
    if stop is not None:
        fix(actuator, context, stop=(stop,))
    simulator.AdvanceTo(duration - 0.25 * actuator.time_step)
    return actuator, context, simulator


def state_of(actuator, context):
    return [actuator.GetOutputPort(n).Eval(context).tolist() for n in ("extension", "velocity")]


@pytest.mark.parametrize("stop", [math.nan, math.inf, -math.inf, -1.0, 1e300])
def test_a_stop_that_is_neither_on_nor_off_cuts_the_supply(fix, stop):
    assert state_of(*stopped(fix, stop)[:2]) == state_of(*stopped(fix, 1.0)[:2])


@pytest.mark.parametrize("stop", [0.0, 0.5])
def test_a_stop_that_is_not_above_a_half_and_one_that_is_not_connected_change_nothing(fix, stop):
    without = state_of(*stopped(fix, None)[:2])
    assert state_of(*stopped(fix, stop)[:2]) == without
    assert without[1][0] > 0.04


@pytest.mark.parametrize("voltage", [5.0, -12.0, math.nan])
@pytest.mark.parametrize("load", [None, FOOT_LOAD, -FOOT_LOAD])
def test_a_stop_is_zero_volts_whatever_is_commanded(fix, voltage, load):
    """From a moving rod, so that friction brings it to rest."""
    states = []
    for commanded, stop in ((voltage, 1.0), (0.0, 0.0)):
        actuator, context, simulator = stopped(fix, 0.0, 5.0, load=load)
        fix(actuator, context, voltage=np.full(4, commanded), stop=(stop,))
        simulator.AdvanceTo(0.31)
        states.append(state_of(actuator, context))
        simulator.AdvanceTo(0.8)
        states.append(state_of(actuator, context))
    assert states[:2] == states[2:]
    assert states[1][1] == [0.0] * 4


def test_an_actuator_goes_on_when_the_stop_ends(fix):
    actuator, context, simulator = stopped(fix, 1.0)
    assert state_of(actuator, context) == [[0.0] * 4, [0.0] * 4]
    fix(actuator, context, stop=(0.0,))
    simulator.AdvanceTo(0.6)
    assert min(state_of(actuator, context)[1]) > 0.04
