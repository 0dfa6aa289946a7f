"""Continuous plants under error control: their drives, their forces, their simulators."""

import numpy as np
import pytest
from pydrake.multibody.tree import (
    PdControllerGains,
    PrismaticJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import DiagramBuilder, EventStatus
from pydrake.systems.primitives import TrajectorySource, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial

import parapod
from parapod.diagrams.multibody import add_plant, lead_joints, mean_force, moving
from parapod.diagrams.simulators import simulator_of
from parapod.diagrams.station import Station
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.systems.core.errors import ScenarioError

STEP, SPEED, STIFFNESS, LAG = 1e-3, 0.1, 1e5, 0.01  # s, m/s, N/m, damping by stiffness [s]


def driven_slider(builder):
    """A continuous plant with a driven slider of 1 kg, and the slider's model instance."""
    plant, _ = add_plant(builder, STEP, "lagged", 1e-3)
    model = plant.AddModelInstance("slider")
    inertia = SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.1))
    body = plant.AddRigidBody("slider", model, inertia)
    along = np.array((1.0, 0.0, 0.0))
    joint = plant.AddJoint(PrismaticJoint("slider", plant.world_frame(), body.body_frame(), along))
    drive = plant.AddJointActuator("slider", joint)
    drive.set_controller_gains(PdControllerGains(p=STIFFNESS, d=LAG * STIFFNESS))
    plant.Finalize()
    return plant, model


def lateness(is_led):
    """Time by which a drive trails a motion whose value at the beginning of a step counts [s]."""
    builder = DiagramBuilder()
    plant, model = driven_slider(builder)
    way = PiecewisePolynomial.FirstOrderHold([0.0, 10.0], np.array([[0.0, 10.0 * SPEED]]))
    source = builder.AddSystem(TrajectorySource(way, 1)).get_output_port()
    if is_led:
        lead_joints(builder, plant, model, source)
    else:
        builder.Connect(source, plant.get_desired_state_input_port(model))
    simulator = simulator_of(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetVelocities(context, [SPEED])
    simulator.AdvanceTo(1.0)
    return 1.0 - plant.GetPositions(context)[0] / SPEED


def test_a_drive_that_moves_trails_by_no_more_than_a_step():
    assert lateness(is_led=True) == pytest.approx(STEP, rel=0.02)


def test_drake_takes_the_damper_of_a_drive_with_the_wrong_sign():
    """Once it does not, `lead_joints` may leave desired velocities as they are."""
    assert lateness(is_led=False) == pytest.approx(STEP + 2.0 * LAG, rel=0.02)


START, ACCELERATION = 0.3, 5.0  # m, m/s^2


@pytest.mark.parametrize(
    ("substeps", "sampled"), [(1, ()), (2, ()), (4, ()), (3.3, ()), (1, (1.7e-3,))]
)
def test_a_plant_moves_as_its_drives_do_however_many_steps_the_integrator_takes(substeps, sampled):
    builder = DiagramBuilder()
    plant, model = driven_slider(builder)
    times = np.array([0.0, 2.0])
    shape = PiecewisePolynomial.CubicHermite(
        times,
        START + 0.5 * ACCELERATION * times[np.newaxis] ** 2,
        ACCELERATION * times[np.newaxis],
    )
    # Where the drives are at the end of their step.
    way = shape.slice(0, 1)
    way.shiftRight(-STEP)
    source = builder.AddSystem(TrajectorySource(way, 1)).get_output_port()
    held = builder.AddSystem(ZeroOrderHold(STEP, 2))
    builder.Connect(source, held.get_input_port())
    for period in sampled:
        other = builder.AddSystem(ZeroOrderHold(period, 2))
        builder.Connect(source, other.get_input_port())
    reference = moving(builder, plant, held.get_output_port(), STEP, sampled)
    lead_joints(builder, plant, model, reference.now)
    force = mean_force(builder, plant, [model], reference.during, STEP)
    sampled = builder.AddSystem(ZeroOrderHold(STEP, 1))
    builder.Connect(force, sampled.get_input_port())
    simulator = simulator_of(builder.Build())
    simulator.get_mutable_integrator().set_maximum_step_size(STEP / substeps)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(context, [START])
    rows = []

    def look(root_context):
        own = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root_context))
        context = sampled.GetMyContextFromRoot(root_context)
        (mean,) = sampled.get_output_port().Eval(context)
        rows.append((root_context.get_time(), *own, mean))
        return EventStatus.DidNothing()

    simulator.set_monitor(look)
    simulator.AdvanceTo(0.2)
    time, position, velocity, mean = np.array(rows).T
    late = START + 0.5 * ACCELERATION * time**2 - position
    assert np.abs(late).max() < 0.1 * ACCELERATION * time[-1] * STEP
    late, velocity, mean, time = (each[len(rows) // 2 :] for each in (late, velocity, mean, time))
    # By what the drive yields to the inertia of 1 kg, and a share of the integrator's step.
    assert late == pytest.approx(ACCELERATION / STIFFNESS, abs=3e-5)
    assert velocity == pytest.approx(ACCELERATION * time, rel=5e-3)
    assert mean == pytest.approx(ACCELERATION, rel=0.05)


@pytest.mark.parametrize("accuracy", [None, 1e-3])
def test_a_loop_is_integrated_as_its_scenario_says(accuracy):
    scenario = parapod.scenario("level", backend="multibody")
    scenario.plant.accuracy = accuracy
    integrator = parapod.closed_loop(scenario).simulator().get_integrator()
    names = [name for name, _ in integrator.GetStatisticsSummary()]
    assert any(name.startswith("cenic") for name in names) == (accuracy is not None)
    if accuracy is not None:
        assert integrator.get_target_accuracy() == accuracy
        assert integrator.get_maximum_step_size() == scenario.plant.time_step


def test_a_platform_that_stands_still_presses_on_the_ground_as_evenly_as_with_steps():
    """Though its inertial sensor, sampled off the drives' steps, cuts those of the integrator."""
    scenario = parapod.scenario("compare-engines")
    scenario.plant.accuracy = 1e-3
    loop = parapod.closed_loop(scenario)
    simulator = loop.simulator()
    simulator.AdvanceTo(0.9)  # the legs wait for the estimate
    force = loop.recording(simulator.get_context())["truth.contact_force"]
    assert force[40:].std(axis=0).max() < 0.5
    assert force[40:].mean(axis=0).min() > 100.0


def walked(accuracy):
    scenario = parapod.scenario("bench-walk", backend="multibody")
    scenario.plant.accuracy, scenario.machine.cells.noise_N = accuracy, 0.0
    loop = parapod.closed_loop(scenario)
    simulator = loop.simulator()
    simulator.AdvanceTo(1.2)  # a step or two
    return loop.recording(simulator.get_context())


def test_forces_by_the_balance_of_momentum_are_those_that_steps_report():
    reported, balanced = walked(None), walked(1e-3)
    for name, most in (("truth.foot_force", 15.0), ("cells.force", 5.0)):
        difference = balanced[name] - reported[name]
        assert np.sqrt((difference**2).mean(axis=0)).max() < most
    upwards = [run["truth.foot_force"][:, 1] for run in (reported, balanced)]
    assert max(upwards[0]) > 300.0
    assert upwards[1].mean() == pytest.approx(upwards[0].mean(), rel=2e-3)


def test_a_leg_that_comes_to_an_end_of_its_way_is_refused():
    scenario = TerrainBenchScenario()
    scenario.plant.accuracy = 1e-3
    station = Station(TERRAIN_BENCH, scenario)
    root = station.CreateDefaultContext()
    for port in TERRAIN_BENCH.inputs:
        station.GetInputPort(port.name).FixValue(root, np.full(port.size, port.idle))
    plant = station.behind.handle.plant.model.plant
    station.monitor(root)
    knee = plant.GetJointByName("knee")
    knee.set_angle(plant.GetMyMutableContextFromRoot(root), 0.1)
    with pytest.raises(ScenarioError, match=r"'knee' comes to an end .* must be null") as raised:
        station.monitor(root)
    assert raised.value.key == "plant.accuracy"
