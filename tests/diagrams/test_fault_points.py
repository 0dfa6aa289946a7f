"""Injectors in a diagram: none where no fault can come, and no trace of those that are idle."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.faults import FaultPoints
from parapod.diagrams.levelling_platform.controller import make_supervised_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlatformFault,
)
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.fault_detection import RULES, Finding
from parapod.systems.levelling_platform.scripts import OperatorScript, Step
from parapod.systems.levelling_platform.supervisor import Phase

PERIOD = 0.01
NEVER = 3000.0
UNTIL = 1.5  # end of a run [s]
POSTURE = (0.0, 0.0, 0.477)
PORTS = (
    "legs.extension",
    "imu.gyro",
    "imu.accel",
    "legs.limits",
    "legs.voltage",
    "posture_command",
)
IDLE = [PlatformFault(at=NEVER, target=name) for name in PORTS]
DRIVING = [Step(Phase.TRANSPORT, 0.1, drive=(0.3, 0.0))]


def scenario_of(faults=(), seed=3, backend="kinematic"):
    scenario = LevellingScenario(
        backend=backend, seed=seed, ground=GroundScenario(1.0, -1.5), faults=list(faults)
    )
    scenario.job.estimate_at = 0.5
    return scenario


def on_wheels(faults=()):
    return LevellingScenario(
        backend="kinematic", job=JobScenario(start="wheels"), faults=list(faults)
    )


def make_deployment(scenario, steps, posture, **options):
    """The platform with its supervisor and an operator."""
    return ClosedLoop(
        PLATFORM,
        scenario,
        controller=make_supervised_controller(scenario),
        sources=[OperatorScript(steps, posture, scenario.control.period)],
        **options,
    )


def injectors_of(diagram):
    return {s.get_name() for s in diagram.GetSystems() if s.get_name().startswith("fault.")}


def assert_same(signals, others):
    for name, samples in others.items():
        np.testing.assert_array_equal(signals[name], samples, err_msg=name)


# Nothing where nothing is wanted


def test_without_faults_a_port_is_seen_as_it_is():
    builder = DiagramBuilder()
    source = add(builder, ConstantVectorSource(np.full(4, 0.4)))
    faults = FaultPoints(builder, PLATFORM.targets, PERIOD)
    assert (
        faults.seen(source.get_output_port(), PLATFORM.table["legs.extension"])
        is source.get_output_port()
    )
    assert builder.GetSystems() == [source]
    assert faults.injectors == faults.ports() == {}


def test_faults_of_other_ports_add_nothing_to_this_one():
    builder = DiagramBuilder()
    source = add(builder, ConstantVectorSource(np.full(4, 0.4)))
    faults = FaultPoints(
        builder,
        PLATFORM.targets,
        PERIOD,
        [PlatformFault(target="imu.gyro")],
        injectable=["imu.accel"],
    )
    assert (
        faults.seen(source.get_output_port(), PLATFORM.table["legs.extension"])
        is source.get_output_port()
    )
    assert builder.GetSystems() == [source]


def test_diagrams_without_faults_have_no_injectors():
    for loop in (
        ClosedLoop(PLATFORM, scenario_of(), log=()),
        make_deployment(on_wheels(), (), POSTURE, log=()),
    ):
        assert injectors_of(loop) == set()
        assert not loop.HasSubsystemNamed("ages")
        assert loop.faults.injectors == {}


@pytest.mark.parametrize("target", PORTS)
def test_a_fault_adds_the_injector_of_its_port_alone(target):
    fault = PlatformFault(target=target)
    for loop in (
        ClosedLoop(PLATFORM, scenario_of([fault]), log=()),
        make_deployment(on_wheels([fault]), (), POSTURE, log=()),
        make_deployment(on_wheels(), (), POSTURE, log=(), injectable=[target]),
    ):
        assert injectors_of(loop) == {f"fault.{target}"}


def test_faults_of_the_supply_go_through_the_voltages_injector():
    loop = ClosedLoop(PLATFORM, scenario_of([PlatformFault(target="supply")]), log=())
    assert injectors_of(loop) == {"fault.legs.voltage"}


# Idle


@pytest.fixture(scope="module")
def faultless(record):
    return record(ClosedLoop(PLATFORM, scenario_of()), UNTIL)


@pytest.fixture(scope="module")
def idle_loop():
    return ClosedLoop(PLATFORM, scenario_of(IDLE))


def test_idle_injectors_change_no_bit_of_a_closed_loop(record, idle_loop, faultless):
    signals = record(idle_loop, UNTIL)
    assert_same(signals, faultless)
    assert faultless["legs.voltage"].any()
    for name in PORTS:
        assert not signals[f"fault.{name}.extra_age"].any()
        assert not signals[f"fault.{name}.changed"].any()


def test_idle_injectors_change_no_bit_of_a_deployment(record):
    plain = record(make_deployment(on_wheels(), DRIVING, POSTURE), UNTIL)
    injectable = make_deployment(on_wheels(), DRIVING, POSTURE, injectable=PORTS)
    assert_same(record(injectable, UNTIL), plain)
    assert plain["wheels.velocity"].any()


# Faults that come later


def test_faults_set_by_a_reset_act_and_the_next_reset_takes_them_back(
    record, idle_loop, faultless
):
    stuck = PlatformFault(at=1.0, target="legs.extension", index=1, kind="stuck")
    faulty = record(idle_loop, UNTIL, scenario_of([stuck]))
    # Up to the fault nothing differs, and it is logged from its first sample on.
    for name, samples in faultless.items():
        np.testing.assert_array_equal(faulty[name][:100], samples[:100], err_msg=name)
    seen, truth = faulty["legs.extension"], faulty["truth.extension"]
    assert np.ptp(seen[101:, 1]) == 0.0
    assert np.ptp(truth[101:, 1]) > 5e-4
    assert faulty["fault.legs.extension.changed"][-1] == 1.0
    assert not faulty["fault.imu.gyro.changed"].any()
    assert_same(record(idle_loop, UNTIL, scenario_of()), faultless)
    assert_same(record(idle_loop, UNTIL), faultless)


def test_the_same_faults_built_in_or_set_later_do_the_same(record, idle_loop):
    garbage = [PlatformFault(at=0.8, target="imu.gyro", index=0, kind="garbage", duration=0.2)]
    built = record(ClosedLoop(PLATFORM, scenario_of(garbage)), UNTIL)
    assert_same(record(idle_loop, UNTIL, scenario_of(garbage)), built)
    assert built["fault.imu.gyro.changed"][-1] == 1.0


@pytest.mark.parametrize("target", ["imu.gyro", "legs.limits", "posture_command"])
def test_a_port_without_an_injector_is_refused_by_its_name(target):
    loop = ClosedLoop(PLATFORM, scenario_of([PlatformFault(at=NEVER)]), log=())
    context = loop.CreateDefaultContext()
    with pytest.raises(ScenarioError, match=rf"port {target} .*without an injector") as refused:
        loop.reset(context, scenario_of([PlatformFault(target=target)]))
    assert refused.value.key == "faults"


def test_what_is_set_is_checked_as_in_a_scenario(idle_loop):
    context = idle_loop.CreateDefaultContext()
    with pytest.raises(ScenarioError, match=r"faults\.0\.index = 7 is outside"):
        idle_loop.faults.set_faults(context, [PlatformFault(index=7)])


@pytest.mark.parametrize(
    ("target", "finding"),
    [
        ("legs.extension", Finding.LEGS_STALE),
        ("imu.gyro", Finding.IMU_STALE),
        ("imu.accel", Finding.IMU_STALE),
    ],
)
def test_devices_that_publish_nothing_grow_old(record, target, finding):
    """A controller sees more than the age that the station shows."""
    off = PlatformFault(at=0.2, target=target, kind="off")
    loop = make_deployment(on_wheels([off]), (), POSTURE, log=("findings",))
    findings = record(loop, 0.4)["findings"]
    first = PERIOD * int(np.argmax(findings[:, finding] > 0.5))
    assert 0.2 < first <= 0.2 + RULES[finding].deadline


def test_a_command_can_fail_on_its_way_to_the_legs(record):
    off = PlatformFault(at=0.8, target="supply", kind="off")
    signals = record(ClosedLoop(PLATFORM, scenario_of([off])), UNTIL)
    assert not signals["legs.voltage"][81:].any()
    assert np.ptp(signals["truth.extension"][84:], axis=0).max() == 0.0


# The stop


@pytest.mark.parametrize("backend", PLATFORM.plants)
def test_a_stop_cuts_the_actuators_supply(backend):
    scenario = scenario_of(backend=backend)
    scenario.plant.leg_model = "reduced"
    builder = DiagramBuilder()
    station = add(builder, Station(PLATFORM, scenario))
    for i in range(station.num_input_ports()):
        builder.ExportInput(station.get_input_port(i), station.get_input_port(i).get_name())
    log = LogVectorOutput(station.GetOutputPort("truth.extension"), builder, PERIOD)
    whole = builder.Build()
    simulator = Simulator(whole)
    context = simulator.get_mutable_context()
    station.reset(context)

    def ways(until, **inputs):
        for spec in PLATFORM.inputs:
            value = inputs.get(spec.name.replace(".", "_"), 0.0)
            whole.GetInputPort(spec.name).FixValue(context, np.full(spec.size, value))
        simulator.AdvanceTo(until)
        samples = log.FindLog(context).data()
        return np.abs(samples[:, -1] - samples[:, -10])

    assert (ways(0.15, legs_voltage=-2.0) > 5e-4).all()
    assert (ways(0.35, legs_voltage=-2.0, legs_stop=1.0) < 1e-9).all()
    assert (ways(0.5, legs_voltage=-2.0) > 5e-4).all()
