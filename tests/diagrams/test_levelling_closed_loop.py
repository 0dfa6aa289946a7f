"""Station and controller together: start, estimate, levelling, logs, and what must not happen."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM, make_job_sources
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.position_loops import longest_period
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    LevellingScenario,
)
from parapod.systems.core.errors import ScenarioError, UnreachablePosture
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
)

BACKENDS = tuple(PLATFORM.plants)
BEGIN = 0.5  # of the levelling [s]
IDEAL = {
    "encoder_resolution_mm": 0.0,
    "imu_noise": False,
    "accel_bias_mg": 0.0,
    "gyro_bias_deg_s": 0.0,
}


def scenario_of(backend="kinematic", ground=(1.0, -1.5), ideal=False, seed=0):
    scenario = LevellingScenario(backend=backend, seed=seed, ground=GroundScenario(*ground))
    scenario.job.estimate_at = BEGIN
    if ideal:
        scenario.machine.sensors = SensorScenario(**IDEAL)
        scenario.machine.actuators.gain_error = 0.0
    return scenario


def level_error(posture, height_mm=477.0):
    """Roll, pitch [deg] and height [mm] away from the level posture."""
    return np.abs(posture - (0.0, 0.0, 1e-3 * height_mm)) * (*np.degrees([1.0, 1.0]), 1e3)


# Start


@pytest.mark.parametrize(("backend", "seed"), [("kinematic", 0), ("multibody", 1)])
def test_control_begins_with_the_estimate_and_without_a_bump(record, backend, seed):
    scenario = scenario_of(backend, seed=seed)
    names = ("legs.voltage", "ground_valid", "truth.extension")
    signals = record(ClosedLoop(PLATFORM, scenario, log=names), BEGIN + 0.3)
    voltage, extension = signals["legs.voltage"], signals["truth.extension"]
    before = signals["ground_valid"][:, 0] < 0.5
    assert signals.time[before][-1] == pytest.approx(BEGIN, abs=0.02)
    np.testing.assert_array_equal(voltage[before], 0.0)
    np.testing.assert_array_equal(extension[before], extension[:1].repeat(before.sum(), axis=0))
    first = voltage[~before][:3]
    assert np.abs(first).max() < 0.2
    assert voltage[-1].any()
    # The fastest move there is stays below the speed at which legs follow the reference.
    assert np.abs(np.diff(extension, axis=0)).max() < 2e-4
    assert np.abs(extension[~before][:5] - extension[0]).max() < 1e-4


@pytest.mark.parametrize(
    ("backend", "ground"),
    [("multibody", (2.0, 3.0)), ("kinematic", (-4.0, 1.0)), ("kinematic", (0.0, -5.0))],
)
def test_ground_is_estimated_with_ideal_sensors(record, backend, ground):
    names = ("ground_estimated", "ground_valid")
    loop = ClosedLoop(PLATFORM, scenario_of(backend, ground, ideal=True), log=names)
    signals = record(loop, BEGIN + 0.05)
    assert signals["ground_valid"][-1] == 1.0
    estimate = np.degrees(signals["ground_estimated"][-1])
    np.testing.assert_allclose(estimate, ground, rtol=0.0, atol=0.02)


@pytest.mark.parametrize(
    ("backend", "ground", "height_mm"),
    [("multibody", (1.0, -1.5), 560.0), ("kinematic", (9.0, 0.0), 477.0)],
)
def test_unreachable_level_posture_stops_the_simulation_before_a_leg_moves(
    backend, ground, height_mm
):
    scenario = scenario_of(backend, ground, ideal=True)
    scenario.job.height_mm = height_mm
    loop = ClosedLoop(PLATFORM, scenario, log=("truth.extension", "legs.voltage"))
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    loop.reset(context)
    simulator.Initialize()
    with pytest.raises(UnreachablePosture) as refusal:
        simulator.AdvanceTo(BEGIN + 2.0)
    assert refusal.value.leg in (1, 2, 3, 4)
    assert refusal.value.missing > 0.0
    assert context.get_time() < BEGIN + 0.1
    signals = loop.recording(context)
    np.testing.assert_array_equal(signals["legs.voltage"], 0.0)
    assert np.ptp(signals["truth.extension"], axis=0).max() == 0.0
    station = loop.station
    extension = station.GetOutputPort("truth.extension").Eval(
        station.GetMyContextFromRoot(context)
    )
    np.testing.assert_array_equal(extension, signals["truth.extension"][0])


# Levelling


@pytest.mark.parametrize(
    ("law", "angle", "height"), [("exact", 0.01, 0.1), ("differential", 0.05, 0.5)]
)
def test_both_feedforward_laws_level_the_platform(record, law, angle, height):
    scenario = scenario_of(ground=(2.0, 3.0), ideal=True)
    scenario.control.feedforward = law
    signals = record(ClosedLoop(PLATFORM, scenario, log=("truth.posture",)), BEGIN + 6.0)
    error = level_error(signals["truth.posture"][-1])
    assert error[:2].max() < angle
    assert error[2] < height


def test_both_backends_take_the_same_way(record):
    names = ("truth.posture", "truth.extension")
    runs = [
        record(ClosedLoop(PLATFORM, scenario_of(backend, ideal=True), log=names), BEGIN + 1.5)
        for backend in BACKENDS
    ]
    posture, extension = (np.abs(runs[0][name] - runs[1][name])[30:] for name in names)
    assert np.degrees(posture[:, :2]).max() < 0.05
    assert posture[:, 2].max() < 3e-4
    assert extension.max() < 3e-4


class WildCommand(LeafSystem):
    """Jumps between postures, most of them out of reach."""

    def __init__(self, period=0.25):
        super().__init__()
        self._period = period
        rng = np.random.default_rng(0)
        self._postures = rng.uniform((-0.3, -0.3, 0.3), (0.3, 0.3, 0.65), (16, 3))
        self.DeclareVectorInputPort("ground_estimated", 2)
        self.DeclareVectorInputPort("ground_valid", 1)
        self.DeclareVectorOutputPort("posture_command", 3, self._calc, {self.time_ticket()})

    def _calc(self, context, output):
        step = int(context.get_time() / self._period + 1e-9)
        output.SetFromVector(self._postures[step % len(self._postures)])


@pytest.mark.parametrize("period", [0.25, 2.0])
def test_clamped_commands_keep_the_legs_inside_their_stroke(record, period):
    scenario = scenario_of(ideal=True)
    names = ("truth.extension", "extension_desired_state", "legs.voltage", "posture_command")
    loop = ClosedLoop(
        PLATFORM,
        scenario,
        controller=make_controller(scenario, on_unreachable="clamp"),
        sources=(WildCommand(period), *make_job_sources(scenario)),
        log=names,
    )
    signals = record(loop, BEGIN + 8.0)
    low, high = DRAWN.extension_min, DRAWN.extension_max
    # Some overshoot of a leg that follows is no fault of the reference.
    for name, margin in (("extension_desired_state", 1e-4), ("truth.extension", 5e-4)):
        assert np.isfinite(signals[name]).all()
        extension = signals[name][:, :4]
        assert extension.min() > low - margin, name
        assert extension.max() < high + margin, name
    # The faster the commands jump, the more of the time goes into stopping.
    assert np.ptp(signals["truth.extension"], axis=0).max() > 5e-3 * min(1.0, period)
    assert np.abs(signals["legs.voltage"]).max() <= scenario.tuned_control.voltage_limit


def test_commands_out_of_reach_stop_the_simulation_where_they_are_not_clamped():
    scenario = scenario_of(ideal=True)
    sources = (WildCommand(), *make_job_sources(scenario))
    loop = ClosedLoop(PLATFORM, scenario, sources=sources, log=())
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    with pytest.raises(UnreachablePosture):
        simulator.AdvanceTo(BEGIN + 3.0)


# Logs and diagrams


@pytest.mark.parametrize("names", [("truth.posture", "legs.voltage"), ()])
def test_chosen_ports_are_logged_alone(record, names):
    signals = record(ClosedLoop(PLATFORM, scenario_of(), log=names), 0.05)
    assert set(signals) == set(names)
    assert (signals.time.size > 0) == bool(names)


def test_log_is_empty_again_after_a_reset():
    loop = ClosedLoop(PLATFORM, scenario_of(), log=("truth.posture",))
    simulator = Simulator(loop)
    context, lengths = simulator.get_mutable_context(), []
    for _ in range(2):
        loop.reset(context)
        simulator.Initialize()
        simulator.AdvanceTo(0.2)
        lengths.append(len(loop.recording(context).time))
    assert lengths[0] == lengths[1] > 2


def test_graph_names_the_controllers_systems():
    loop = ClosedLoop(PLATFORM, scenario_of(), log=())
    graph = loop.GetGraphvizString()
    systems = [system.get_name() for system in loop.controller.GetSystems()]
    assert len(systems) == 6
    assert [name for name in systems if name not in graph] == []


# The controller alone, with measurements that fail


class Controller:
    """A controller that holds a posture, fed by hand."""

    GROUND = np.radians((1.0, -1.5))

    def __init__(self):
        self.scenario = scenario_of()
        self.limit = self.scenario.tuned_control.voltage_limit
        self.diagram = make_controller(self.scenario)
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        extension = np.full(4, 0.41)
        roll, pitch, _ = forward_kinematics(DRAWN, extension, self.GROUND)
        up = (-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll))
        self.good = {
            "legs.extension": extension,
            "imu.gyro": np.zeros(3),
            "imu.accel": 9.81 * np.array(up),
            "posture_command": np.array((0.0, 0.0, 0.477)),
            "estimate_ground": np.zeros(1),
        }
        for name in self.good:
            self.restore(name)

    def set(self, name, value):
        self.diagram.GetInputPort(name).FixValue(self.context, value)

    def restore(self, name):
        self.set(name, self.good[name])

    def read(self, name):
        return np.array(self.diagram.GetOutputPort(name).Eval(self.context))

    def run(self, duration):
        """Voltages at every period."""
        voltages = []
        for _ in range(round(duration / self.scenario.control.period)):
            self.simulator.AdvanceTo(self.context.get_time() + self.scenario.control.period)
            voltages.append(self.read("legs.voltage"))
        return np.array(voltages)

    def start(self):
        self.run(0.5)
        self.set("estimate_ground", np.ones(1))
        self.run(0.5)


@pytest.mark.parametrize("name", ["legs.extension", "imu.gyro", "imu.accel", "posture_command"])
@pytest.mark.parametrize(
    ("elements", "value"), [(slice(None), np.nan), (slice(1, 2), np.inf)], ids=["all", "one"]
)
def test_voltages_stay_finite_and_limited_when_a_measurement_fails(name, value, elements):
    controller = Controller()
    controller.start()
    assert controller.read("legs.voltage").any()
    broken = controller.good[name].copy()
    broken[elements] = value
    controller.set(name, broken)
    during = controller.run(0.5)
    controller.restore(name)
    after = controller.run(0.5)
    for voltage in (during, after):
        assert np.isfinite(voltage).all()
        assert np.abs(voltage).max() <= controller.limit
    assert np.isfinite(controller.read("ground_estimated")).all()
    assert np.isfinite(controller.read("attitude_estimated")).all()


def test_failed_encoder_stops_its_leg_alone():
    controller = Controller()
    controller.start()
    broken = controller.good["legs.extension"].copy()
    broken[1] = np.nan
    controller.set("legs.extension", broken)
    voltage = controller.run(0.2)[2:]
    np.testing.assert_array_equal(voltage[:, 1], 0.0)
    assert (np.abs(voltage[:, [0, 2, 3]]) > 0.0).all()


@pytest.mark.parametrize("name", ["legs.extension", "imu.accel"])
def test_control_waits_for_good_measurements(name):
    controller = Controller()
    controller.set(name, np.full(controller.good[name].size, np.nan))
    controller.run(0.2)
    controller.set("estimate_ground", np.ones(1))
    if name == "legs.extension":
        np.testing.assert_array_equal(controller.run(0.3), 0.0)
        assert controller.read("ground_valid") == 0.0
    controller.restore(name)
    assert np.isfinite(controller.run(0.5)).all()
    assert controller.read("ground_valid") == 1.0


def test_controller_that_holds_still_asks_for_the_extensions_of_the_command():
    controller = Controller()
    controller.start()
    controller.run(6.0)
    expected = inverse_kinematics(DRAWN, (0.0, 0.0, 0.477), controller.GROUND)
    np.testing.assert_allclose(
        controller.read("ground_estimated"), controller.GROUND, rtol=0.0, atol=1e-6
    )
    extension, rate = np.split(controller.read("extension_desired_state"), 2)
    np.testing.assert_allclose(extension, expected, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)


def test_reset_does_not_ask_the_scenario_it_is_given_for_the_backend(record):
    loop = ClosedLoop(PLATFORM, LevellingScenario(backend="multibody"), log=("truth.posture",))
    other = LevellingScenario(backend="kinematic")
    other.ground.roll_deg, other.ground.pitch_deg = -1.0, 2.0
    signals = record(loop, 0.02, other)
    np.testing.assert_allclose(
        np.degrees(signals["truth.posture"][:, :2]), [[-1.0, 2.0]] * 3, atol=1e-3
    )


# Settings that do not fit together


@pytest.mark.parametrize("pole", [5.0, 10.0, 25.0, 50.0])
def test_a_period_too_long_for_the_pole_is_refused_with_what_would_do(pole):
    scenario = scenario_of()
    scenario.control.pole, scenario.control.period = pole, min(0.05, 1.1 * longest_period(pole))
    if scenario.control.period < longest_period(pole):
        ClosedLoop(PLATFORM, scenario, log=())
        return
    with pytest.raises(ScenarioError, match=r"must be 0\.\d+ s or less") as refused:
        ClosedLoop(PLATFORM, scenario, log=())
    assert refused.value.key == "control.period"
    scenario.control.period = float(str(refused.value).split("must be ")[1].split(" s")[0])
    ClosedLoop(PLATFORM, scenario, log=())


@pytest.mark.parametrize("pole", [8.0, 25.0])
def test_with_the_longest_period_of_a_pole_the_platform_levels_without_ringing(record, pole):
    scenario = scenario_of(ideal=True)
    scenario.control.pole, scenario.control.period = pole, min(0.05, longest_period(pole))
    signals = record(ClosedLoop(PLATFORM, scenario, log=("truth.posture",)), BEGIN + 6.0)
    assert (level_error(signals["truth.posture"][-50:]) < (0.05, 0.05, 0.5)).all()
