"""The station through its ports: the same for every backend, honest about the machine behind."""

import math
from functools import cache

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    LevellingScenario,
)
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.sensors.imu import ImuParams

BACKENDS = tuple(PLATFORM.plants)
PERIOD = LevellingScenario().control.period
IMU_PERIOD = 8.0 / 819.2
REAR, FRONT = [0, 1], [2, 3]
# Of the leg that carries most on the default ground, so that its corner follows it.
LOADED = 2


def scenario_of(backend, ground=(2.0, 3.0), seed=0, **plant):
    scenario = LevellingScenario(backend=backend, seed=seed, ground=GroundScenario(*ground))
    for key, value in plant.items():
        setattr(scenario.plant, key, value)
    return scenario


def perfect(scenario):
    """The same scenario without anything random."""
    scenario.machine.sensors = SensorScenario(0.0, False, 0.0, 0.0)
    scenario.machine.actuators.gain_error = 0.0
    return scenario


def swing_arm(machine, angle, duration=0.5, turn=0.0):
    """A command that does not jump."""
    steps = round(duration / PERIOD)
    for k in range(1, steps + 1):
        share = 0.5 - 0.5 * math.cos(math.pi * k / steps)
        machine.set("arm.position_command", [turn, share * angle])
        machine.run(PERIOD)


def parameter(machine, system):
    """The numbers drawn for a system of the station."""
    part = machine.station.GetSubsystemByName(system)
    return part.GetMyContextFromRoot(machine.context).get_numeric_parameter(0).CopyToVector()


def joints(machine, *names):
    """Angles and rates of the multibody plant's joints."""
    plant = machine.station.behind.handle.plant.model.plant
    context = plant.GetMyContextFromRoot(machine.context)
    found = [plant.GetJointByName(name) for name in names]
    return np.array([(j.get_angle(context), j.get_angular_rate(context)) for j in found]).T


@pytest.fixture(scope="module")
def shared(make_machine):
    """shared(backend): one machine a backend on its default ground, at its beginning again."""
    made = cache(lambda backend: make_machine(scenario_of(backend)))
    return lambda backend: begun(made(backend))


@pytest.fixture(scope="module")
def exact(make_machine):
    """exact(backend): the same without anything random."""
    made = cache(lambda backend: make_machine(perfect(scenario_of(backend))))
    return lambda backend: begun(made(backend))


def begun(machine):
    machine.reset()
    return machine


def corner_heights(posture, ground):
    """Heights of the hips above the ground's plane."""
    roll, pitch, height = posture
    R_WF = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix()
    n = RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()[:, 2]
    hips = np.array([(-leg.l_x, -leg.l_y, -leg.l_z) for leg in DRAWN.legs])
    return height + hips @ R_WF.T @ n


@pytest.mark.parametrize(
    ("backend", "leg_model"),
    [("multibody", "full"), ("multibody", "reduced"), ("kinematic", "full")],
)
def test_every_output_is_finite_from_the_start_and_after_steps(make_machine, backend, leg_model):
    machine = make_machine(scenario_of(backend, leg_model=leg_model))
    for _ in range(2):
        for spec in (*PLATFORM.outputs, *PLATFORM.truth):
            assert np.isfinite(machine.read(spec.name)).all(), spec.name
        machine.run(0.05)


# Reset


SIGNALS = ("imu.gyro", "imu.accel", "imu.mag", "truth.extension", "truth.posture")


def run_of(machine):
    """Everything that is drawn from the seed, and a short moving run."""
    machine.set("legs.voltage", [1.0, -1.0, 1.0, -1.0])
    signals = machine.record(0.1, *SIGNALS, period=PERIOD)
    drawn = {name: parameter(machine, name) for name in ("linear_actuator", "imu")}
    return drawn | dict(zip(SIGNALS, signals, strict=True))


@pytest.mark.parametrize("backend", BACKENDS)
def test_another_seed_gives_other_gains_biases_and_noise(shared, backend):
    one = run_of(shared(backend))
    biases = {one["imu"].tobytes()}
    machine = shared(backend)
    for seed in (1, 2, 3):
        machine.reset(scenario_of(backend, seed=seed))
        other = run_of(machine)
        biases.add(other["imu"].tobytes())
        for name in set(one) - {"imu"}:
            assert not np.array_equal(other[name], one[name]), name
    # Biases have one size and random signs, so two seeds may share them.
    assert len(biases) > 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_gains_stay_within_the_stated_error(shared, backend):
    nominal = LinearActuatorParams().motor_constant
    machine = shared(backend)
    for seed in range(5):
        scenario = scenario_of(backend, seed=seed)
        machine.reset(scenario)
        scale = parameter(machine, "linear_actuator") / nominal
        assert np.abs(scale - 1.0).max() <= scenario.machine.actuators.gain_error
        assert len(set(scale.tolist())) == 4


# Legs


@pytest.mark.parametrize("backend", BACKENDS)
def test_platform_stands_still_without_voltage(shared, backend):
    machine = shared(backend)
    machine.reset(scenario_of(backend, ground=(4.0, -3.0)))
    extension, posture = machine.read("truth.extension"), machine.read("truth.posture")
    machine.run(1.0)
    # Self-locking: to the last bit.
    np.testing.assert_array_equal(machine.read("truth.extension"), extension)
    moved = np.abs(machine.read("truth.posture") - posture)
    assert (moved < (1e-4, 1e-4, 1e-4)).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_driven_leg_extends_at_its_gain_and_lowers_its_corner(exact, backend):
    machine = exact(backend)
    machine.run(0.1)
    extension, posture = machine.read("truth.extension"), machine.read("truth.posture")
    voltage = np.zeros(4)
    voltage[LOADED] = 1.0
    machine.set("legs.voltage", voltage)
    machine.run(0.5)
    moved = machine.read("truth.extension") - extension
    params = LinearActuatorParams()
    # Friction takes its share of a volt.
    share = 1.0 - params.coulomb_friction / params.motor_constant
    assert moved[LOADED] == pytest.approx(0.5 * share * params.gain, rel=0.05)
    assert np.delete(moved, LOADED).tolist() == [0.0] * 3
    ground = machine.station.scenario.ground.inclination
    sunk = corner_heights(posture, ground) - corner_heights(machine.read("truth.posture"), ground)
    assert sunk[LOADED] > 1e-3
    assert int(np.argmax(sunk)) == LOADED


@pytest.mark.parametrize("backend", BACKENDS)
def test_platform_is_lowered_faster_than_it_is_lifted(exact, backend):
    machine = exact(backend)
    machine.run(0.5 * PERIOD)  # out of step with all updates
    moved = []
    for voltage in (1.0, -1.0):
        start = machine.read("truth.extension")
        machine.set("legs.voltage", voltage)
        machine.run(0.1)
        machine.set("legs.voltage", 0.0)
        machine.run(0.1)
        moved.append(machine.read("truth.extension") - start)
    down, up = moved
    assert (up < 0.0).all()
    assert (down > -up).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_voltage_beyond_the_supply_is_saturated(exact, backend):
    reached = []
    for voltage in (12.0, 100.0, 10.0):
        machine = exact(backend)
        machine.set("legs.voltage", -voltage)
        machine.run(0.1)
        reached.append(machine.read("truth.extension"))
    np.testing.assert_array_equal(reached[0], reached[1])
    assert (reached[0] < reached[2]).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_legs_stop_at_their_end_stops_and_close_the_end_switches(exact, backend):
    params = LinearActuatorParams()
    machine = exact(backend)
    machine.set("legs.voltage", -12.0)
    machine.run(0.5)
    np.testing.assert_array_equal(machine.read("truth.extension"), [params.stop_min] * 4)
    assert machine.read("legs.limits")[:8].tolist() == [0.0] * 4 + [1.0] * 4


@pytest.mark.parametrize("backend", BACKENDS)
def test_measured_extensions_are_the_true_ones_in_whole_counts(shared, backend):
    machine = shared(backend)
    machine.set("legs.voltage", [1.0, -1.0, 0.5, -0.5])
    measured, true = machine.record(0.1, "legs.extension", "truth.extension", period=PERIOD)
    count = 1e-3 * machine.station.scenario.machine.sensors.encoder_resolution_mm
    counts = measured / count
    np.testing.assert_allclose(counts, np.round(counts), rtol=0.0, atol=1e-6)
    assert np.abs(measured - true).max() <= 0.5 * count * (1.0 + 1e-9)
    assert np.abs(measured - true).max() > 0.0


@pytest.mark.parametrize("backend", BACKENDS)
def test_ideal_encoders_tell_the_true_extensions_and_rates(exact, backend):
    machine = exact(backend)
    machine.set("legs.voltage", [1.0, -1.0, 0.5, -0.5])
    machine.run(0.1 + 0.5 * PERIOD)  # out of step with all updates
    before = machine.read("truth.extension")
    np.testing.assert_array_equal(machine.read("legs.extension"), before)
    (rate,) = machine.record(0.2, "legs.velocity", period=PERIOD)
    change = machine.read("truth.extension") - before
    np.testing.assert_allclose(0.2 * rate.mean(axis=0), change, rtol=0.01)


@pytest.mark.parametrize("backend", BACKENDS)
def test_standing_legs_close_the_contact_switches_and_no_end_switch(shared, backend):
    machine = shared(backend)
    machine.run(0.1)
    assert machine.read("legs.limits").tolist() == [0.0] * 8 + [1.0] * 4


# Inertial sensor


def gravity_in_platform(machine):
    posture = machine.read("truth.posture")
    R_WF = RollPitchYaw(*posture[:2], 0.0).ToRotationMatrix().matrix()
    return R_WF.T @ (0.0, 0.0, 9.81)


@pytest.mark.parametrize("backend", BACKENDS)
def test_ideal_inertial_sensor_at_rest_reads_gravity_in_the_platforms_frame(exact, backend):
    machine = exact(backend)
    machine.run(0.5)
    np.testing.assert_allclose(
        machine.read("imu.accel"), gravity_in_platform(machine), rtol=0.0, atol=2e-4
    )
    np.testing.assert_allclose(machine.read("imu.gyro"), 0.0, rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_inertial_sensor_measures_from_its_first_sample(exact, backend):
    machine = exact(backend)
    np.testing.assert_allclose(
        machine.read("imu.accel"), gravity_in_platform(machine), rtol=0.0, atol=0.1
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_inertial_sensor_at_rest_reads_gravity_within_bias_and_noise(shared, backend):
    machine = shared(backend)
    machine.run(0.3)
    accel, gyro = machine.record(0.7, "imu.accel", "imu.gyro", period=PERIOD)
    params, to_deviation = ImuParams(), math.sqrt(0.5 / IMU_PERIOD)
    drawn = parameter(machine, "imu")
    for reading, expected, density, drift, count in (
        (
            accel,
            gravity_in_platform(machine) + drawn[3:],
            params.accel_noise_density,
            params.accel_bias_instability,
            params.accel_resolution,
        ),
        (
            gyro,
            drawn[:3],
            params.gyro_noise_density,
            params.gyro_bias_instability,
            params.gyro_resolution,
        ),
    ):
        sigma = math.hypot(density * to_deviation, count / math.sqrt(12.0))
        mean_error = np.abs(reading.mean(axis=0) - expected)
        assert (mean_error < 4.0 * (sigma / math.sqrt(len(reading)) + drift)).all()
        assert (np.abs(reading - expected) < 5.0 * (sigma + drift)).all()
        assert (reading.std(axis=0) > 0.5 * sigma).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_gyro_integrates_to_the_change_of_attitude(exact, backend):
    machine = exact(backend)
    machine.run(0.1)
    before = machine.read("truth.posture")
    machine.set("legs.voltage", [1.0, 1.0, -1.0, -1.0])  # pitch alone
    (gyro,) = machine.record(0.3, "imu.gyro", period=PERIOD)
    machine.set("legs.voltage", 0.0)
    (rest,) = machine.record(0.1, "imu.gyro", period=PERIOD)
    turned = PERIOD * np.concatenate((gyro, rest))[:, 1].sum()
    change = machine.read("truth.posture")[1] - before[1]
    assert abs(change) > 5e-3
    assert turned == pytest.approx(change, rel=0.05)


@pytest.mark.parametrize("backend", BACKENDS)
def test_ages_are_never_negative_and_stay_below_the_devices_periods(shared, backend):
    machine = shared(backend)
    # A step that falls in with neither the sensor's nor the controller's period.
    (age,) = machine.record(0.3, "status.age", period=0.0007)
    assert (age >= 0.0).all()
    assert (age < (1e-12, IMU_PERIOD, PERIOD, 1e-12)).all()
    assert (age[:, 1:3].max(axis=0) > (0.9 * IMU_PERIOD, 0.9 * PERIOD)).all()
    assert not machine.read("status.fault").any()


# Arm and wheels


def test_arm_follows_its_command(shared):
    machine = shared("multibody")
    swing_arm(machine, 0.5)
    machine.run(0.5)
    ((turntable, arm), rates) = joints(machine, "turntable", "arm")
    assert arm == pytest.approx(0.5, abs=0.01)
    assert turntable == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(rates, 0.0, rtol=0.0, atol=0.01)


def test_jump_of_the_arms_command_leaves_the_platform_on_its_feet(shared):
    machine = shared("multibody")
    machine.run(0.2)
    before = machine.read("truth.posture")
    machine.set("arm.position_command", [0.0, 0.2])
    machine.run(1.0)
    (_, arm), _ = joints(machine, "turntable", "arm")
    assert arm == pytest.approx(0.2, abs=0.01)
    assert np.abs(machine.read("truth.posture") - before).max() < 2e-3


@pytest.mark.parametrize("backend", BACKENDS)
def test_arm_that_swings_forward_shifts_the_load_to_the_front(shared, backend):
    machine = shared(backend)
    machine.run(0.2)
    before = machine.read("truth.contact_force")
    swing_arm(machine, math.pi / 4.0)
    machine.run(0.2)
    shift = machine.read("truth.contact_force") - before
    assert shift.sum() == pytest.approx(0.0, abs=0.5)
    assert (shift[FRONT] > 1.0).all()
    assert (shift[REAR] < -1.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_turned_turntable_swings_the_arm_to_the_left(shared, backend):
    machine = shared(backend)
    for k in range(1, 51):
        machine.set("arm.position_command", [0.5 * math.pi * k / 50.0, 0.0])
        machine.run(PERIOD)
    before = machine.read("truth.contact_force")
    swing_arm(machine, math.pi / 4.0, turn=0.5 * math.pi)
    machine.run(0.2)
    shift = machine.read("truth.contact_force") - before
    left = [i for i, leg in enumerate(DRAWN.legs) if leg.l_y < 0.0]
    right = [i for i, leg in enumerate(DRAWN.legs) if leg.l_y > 0.0]
    assert (shift[left] > 1.0).all()
    assert (shift[right] < -1.0).all()


WHEELS = tuple(f"wheel_{i}" for i in range(1, 5))


def test_rolling_wheels_follow_their_velocities_and_hold_with_the_brake(make_machine):
    machine = make_machine(scenario_of("multibody", wheels="rolling"))
    velocities = [2.0, -1.0, 0.5, 3.0]
    machine.set("wheels.brake", 0.0)
    machine.set("wheels.velocity_command", velocities)
    machine.run(0.5 + 0.5 * PERIOD)
    before, _ = joints(machine, *WHEELS)
    machine.run(0.2)
    angles, _ = joints(machine, *WHEELS)
    np.testing.assert_allclose((angles - before) / 0.2, velocities, rtol=0.01)
    np.testing.assert_allclose(machine.read("wheels.velocity"), velocities, rtol=0.01, atol=0.02)
    np.testing.assert_allclose(angles, machine.read("wheels.position"), rtol=0.0, atol=0.05)
    machine.set("wheels.brake", 1.0)
    machine.run(0.7)
    held, rates = joints(machine, *WHEELS)
    np.testing.assert_allclose(rates, 0.0, rtol=0.0, atol=1e-3)
    machine.run(0.3)
    np.testing.assert_allclose(joints(machine, *WHEELS)[0], held, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(held, machine.read("wheels.position"), rtol=0.0, atol=1e-2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_wheel_encoders_answer_with_braked_wheels(shared, backend):
    machine = shared(backend)
    machine.run(0.05)
    np.testing.assert_array_equal(machine.read("wheels.position"), np.zeros(4))
    np.testing.assert_array_equal(machine.read("wheels.velocity"), np.zeros(4))


@pytest.mark.parametrize("backend", BACKENDS)
def test_commanded_wheels_of_braked_machines_do_not_move_the_platform(shared, backend):
    machine = shared(backend)
    machine.run(0.2)
    posture = machine.read("truth.posture")
    machine.set("wheels.brake", 0.0)
    machine.set("wheels.velocity_command", 5.0)
    machine.run(0.3)
    np.testing.assert_allclose(machine.read("truth.posture"), posture, rtol=0.0, atol=1e-6)
    assert np.isfinite(machine.read("wheels.position")).all()
