"""The station without a machine: what is commanded is what is measured."""

import io

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.devices import Parts
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.ports import Behind
from parapod.diagrams.station import Station
from parapod.sims.lab.discovery import find_entry
from parapod.sims.levelling_platform.level import Level
from parapod.sims.levelling_platform.levelling import measured_posture
from parapod.sims.output.options import RunOptions
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.core.errors import WiringError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.plane import to_platform

PERIOD = LevellingScenario().control.period
GAIN = LinearActuatorParams().gain
GRAVITY = 9.81  # of the simulated plants [m/s^2]
START = LevellingScenario().initial_extensions[0]


class Mock:
    """A mock's station, of which whole periods pass."""

    def __init__(self, machine):
        self.machine, self.steps = machine, 0
        self.set, self.read = machine.set, machine.read
        self.set("wheels.brake", 0.0)

    def run(self, steps):
        self.steps += steps
        # Half a period beyond the last one, so that its update is among them.
        self.machine.simulator.AdvanceTo((self.steps - 0.5) * PERIOD)


@pytest.fixture
def make_mock(make_machine):
    """make_mock(scenario): see `Mock`."""
    return lambda scenario: Mock(make_machine(scenario))


@pytest.fixture
def mock(make_mock):
    return make_mock(LevellingScenario(backend="mock"))


def test_it_begins_at_the_jobs_extension_and_rest(mock):
    np.testing.assert_array_equal(mock.read("legs.extension"), START)
    for name in ("legs.velocity", "imu.gyro", "wheels.position", "wheels.velocity"):
        assert not mock.read(name).any(), name


def test_a_reset_takes_another_jobs_extension(mock):
    other = LevellingScenario(backend="mock")
    other.job.initial_extension_mm = 395.0
    mock.machine.reset(other)
    np.testing.assert_array_equal(mock.read("legs.extension"), 0.395)


def test_all_outputs_are_finite_and_no_device_has_a_fault_or_is_late(mock):
    mock.set("legs.voltage", [1.0, -1.0, 2.0, -2.0])
    mock.run(20)
    assert all(np.isfinite(mock.read(spec.name)).all() for spec in PLATFORM.outputs)
    assert not mock.read("status.fault").any()
    assert not mock.read("status.age").any()


# Legs


def test_legs_extend_at_their_gain_times_the_voltage_from_the_first_period_on(mock):
    voltage = np.array([1.0, -0.5, 0.001, 0.0])
    mock.set("legs.voltage", voltage)
    for _ in range(10):
        before = mock.read("legs.extension")
        mock.run(1)
        moved = mock.read("legs.extension") - before
        np.testing.assert_allclose(moved, GAIN * voltage * PERIOD, atol=1e-15)
        np.testing.assert_allclose(mock.read("legs.velocity"), GAIN * voltage, atol=1e-15)


def test_legs_know_no_gain_errors_friction_or_seed(make_mock):
    scenario = LevellingScenario(backend="mock", seed=3)
    scenario.machine.actuators.gain_error, scenario.machine.actuators.coulomb_friction = (
        0.5,
        20000.0,
    )
    mock = make_mock(scenario)
    mock.set("legs.voltage", 0.01)
    mock.run(1)
    np.testing.assert_allclose(mock.read("legs.velocity"), GAIN * 0.01, rtol=1e-12)


def test_voltages_are_those_of_the_supply_at_most(make_mock):
    scenario = LevellingScenario(backend="mock")
    scenario.machine.actuators.supply_voltage = 5.0
    mock = make_mock(scenario)
    mock.set("legs.voltage", [9.0, -9.0, np.nan, 5.0])
    mock.run(1)
    np.testing.assert_allclose(mock.read("legs.velocity"), GAIN * np.array([5, -5, 0, 5]))


def test_legs_end_at_their_stops(mock):
    mock.set("legs.voltage", [12.0, -12.0, 12.0, -12.0])
    mock.run(100)
    params = LinearActuatorParams()
    ends = [params.stop_max, params.stop_min] * 2
    np.testing.assert_array_equal(mock.read("legs.extension"), ends)


def test_a_stop_cuts_the_supply_until_it_is_taken_back(mock):
    mock.set("legs.voltage", 2.0)
    mock.run(5)
    mock.set("legs.stop", 1.0)
    stood = mock.read("legs.extension")
    mock.run(5)
    np.testing.assert_array_equal(mock.read("legs.extension"), stood)
    assert not mock.read("legs.velocity").any()
    mock.set("legs.stop", 0.0)
    mock.run(1)
    np.testing.assert_allclose(mock.read("legs.extension"), stood + GAIN * 2.0 * PERIOD)


# Limit switches


def switches(mock):
    """Extended, retracted, ground contact, each of four legs."""
    return mock.read("legs.limits").reshape(3, 4)


def test_all_feet_stand_and_no_stroke_is_at_its_end_at_the_beginning(mock):
    np.testing.assert_array_equal(switches(mock), [[0.0] * 4, [0.0] * 4, [1.0] * 4])


def test_switches_close_at_the_ends_of_the_stroke(mock):
    mock.set("legs.voltage", [12.0, -12.0, 0.0, 0.0])
    end = LevellingScenario().machine.actuators.switches.extended
    for _ in range(100):
        is_there = mock.read("legs.extension")[0] >= end
        assert switches(mock)[0].tolist() == [is_there, 0.0, 0.0, 0.0]
        mock.run(1)
    assert is_there
    np.testing.assert_array_equal(switches(mock)[0], [1.0, 0.0, 0.0, 0.0])
    mock.run(100)
    np.testing.assert_array_equal(switches(mock)[1], [0.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize("leg", range(4))
def test_with_one_leg_of_another_length_the_other_diagonal_carries(mock, leg):
    mock.set("legs.voltage", np.eye(4)[leg] * 12.0)
    mock.run(40)
    up = set(np.flatnonzero(switches(mock)[2] == 0.0))
    assert up
    assert up <= {leg, (leg + 2) % 4}


# Inertial sensor


def test_a_level_platform_feels_gravity_straight_up(mock):
    np.testing.assert_allclose(mock.read("imu.accel"), [0.0, 0.0, GRAVITY], atol=1e-5)


def test_gravity_is_seen_from_the_posture_that_the_legs_say(mock):
    mock.set("legs.voltage", [1.0, 1.0, -1.0, -1.0])
    mock.run(50)
    mock.set("legs.voltage", 0.0)
    mock.run(2)
    extension = mock.read("legs.extension")
    roll, pitch, _ = forward_kinematics(DRAWN, extension, (0.0, 0.0), (0, 1, 2))
    assert abs(pitch) > 0.01
    seen = to_platform((0.0, 0.0, GRAVITY), roll, pitch)
    np.testing.assert_allclose(mock.read("imu.accel"), seen, atol=1e-2)
    assert not mock.read("imu.gyro").any()


def test_the_gyro_is_the_rate_of_the_posture(mock):
    mock.set("legs.voltage", [1.0, 1.0, -1.0, -1.0])
    mock.run(1)

    def pitch():
        x, _, z = mock.read("imu.accel")
        return -np.arctan2(x, z)

    before = pitch()
    steps = 5
    mock.run(steps)
    rate = (pitch() - before) / (steps * PERIOD)
    assert abs(rate) > 1e-3
    np.testing.assert_allclose(mock.read("imu.gyro"), [0.0, rate, 0.0], atol=0.02 * abs(rate))


# Wheels


def test_wheels_turn_as_commanded_from_the_first_period_on(mock):
    command = np.array([1.0, -2.0, 0.25, 0.0])
    mock.set("wheels.velocity_command", command)
    mock.run(1)
    np.testing.assert_allclose(mock.read("wheels.velocity"), command, atol=1e-7)
    before = mock.read("wheels.position")
    mock.run(10)
    moved = mock.read("wheels.position") - before
    np.testing.assert_allclose(moved, 10 * PERIOD * command, atol=1e-8)


def test_the_brake_stops_the_wheels_at_once(mock):
    mock.set("wheels.velocity_command", 3.0)
    mock.run(5)
    mock.set("wheels.brake", 1.0)
    mock.run(1)
    assert not mock.read("wheels.velocity").any()
    stood = mock.read("wheels.position")
    mock.run(5)
    np.testing.assert_array_equal(mock.read("wheels.position"), stood)


# The job


def test_a_job_on_the_mock_holds_its_bounds():
    default = find_entry("level").default_scenario
    overrides = (
        "backend=mock",
        "job.initial_extension_mm=405",
        "job.estimate_at=1.5",
        "job.settled_after=2",
        "job.waypoints=[{time: 2, roll_deg: 0.3, height_mm: -3}]",
        "job.arm={start: 0.5, duration: 0.5}",
        "job.end=4",
    )
    scenario = load_scenario(LevellingScenario, default, None, overrides)
    result = Level("level").execute(scenario, RunOptions(console=Console(file=io.StringIO())))
    assert result.passed, result.broken
    assert result.backend == "mock"
    keys = {metric.key for metric in result.metrics}
    assert {"roll_error_deg", "pitch_error_deg", "height_error_mm", "settling_time_s"} <= keys
    # Nothing is hidden in a mock, so there is nothing to compare with the truth.
    assert not any("ground" in key or "lift" in key for key in keys)
    assert result.notes[0].startswith("posture as measured: ")


def test_heights_before_there_is_a_ground_are_not_known():
    rows = 3
    signals = {
        "ground_estimated": np.zeros((rows, 2)),
        "ground_valid": np.array([[0.0], [1.0], [1.0]]),
        "attitude_estimated": np.zeros((rows, 2)),
        "legs.extension": np.full((rows, 4), 0.41),
        "foot_offsets_estimated": np.zeros((rows, 4)),
    }
    height = measured_posture(signals, LevellingScenario())[:, 2]
    assert np.isnan(height[0])
    assert np.isfinite(height[1:]).all()


def test_what_stands_behind_the_ports_is_told_by_its_kind():
    behind = Station(PLATFORM, LevellingScenario(backend="mock")).behind
    with pytest.raises(WiringError, match="this backend has Simulation, not Parts, behind"):
        behind.handle_as(Parts)
    parts = Parts({})
    with pytest.raises(WiringError, match="this backend has Parts, not Station, behind"):
        Behind({}, {}, handle=parts).handle_as(Station)
    assert Behind({}, {}, handle=parts).handle_as(Parts) is parts
