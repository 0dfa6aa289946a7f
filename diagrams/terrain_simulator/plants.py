"""Plants behind the terrain simulator's station: rigid bodies and kinematics, with the drives."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PdControllerGains
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    MatrixGain,
    Multiplexer,
    Saturation,
    ZeroOrderHold,
)

from parapod.diagrams.drawing import draw_model, publish, remove_visuals
from parapod.diagrams.multibody import add_plant, arrival, lead_joints, mean_force, moving
from parapod.diagrams.ports import Behind
from parapod.diagrams.pushes import after, push_bodies, pushes_in
from parapod.diagrams.simulated import Plant, Rest, Simulation
from parapod.diagrams.terrain_simulator.leg import LegUnderTest
from parapod.diagrams.terrain_simulator.model import LegOnSlide, add_bench, add_leg_on_slide
from parapod.diagrams.terrain_simulator.ports import PARTS, ports_of_joints
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.switching import switched
from parapod.systems.core.vectors import Array
from parapod.systems.sensors.noise import NoiseSource
from parapod.systems.terrain_simulator.belt import BeltSurface
from parapod.systems.terrain_simulator.cells import ForceCells
from parapod.systems.terrain_simulator.force_balance import FootBalance, TreadBalance
from parapod.systems.terrain_simulator.kinematics import slider_places
from parapod.systems.terrain_simulator.model import (
    BenchModel,
    BenchPositions,
    BenchTruth,
    PlatePose,
)
from parapod.systems.terrain_simulator.walk import BenchWalk

# Damping of a slider with its drive by its stiffness [s] (assumption).
_DAMPING = 0.002
# Lag of the belt behind its command [s], and what it comes to at most [m/s] (assumptions).
_BELT = VelocityServoParams(resolution=0.0, time_constant=0.01, max_velocity=4.0)
# Period at which its drive takes commands [s].
_BELT_PERIOD = 0.01
# Share by which a drive may exceed an acceleration that is met exactly [-].
_SLACK = 0.01
_SOURCES = 3  # cells, each with noise of its own


type Simulated = Simulation[TerrainBenchScenario, TerrainBenchScenario]


def beginning(scenario: TerrainBenchScenario) -> Array:
    """Places of the sliders (3) where the walk begins [m]."""
    return slider_places(scenario.machine.geometry, scenario.walk.at(0.0).pose[0])


def make_sliders(scenario: TerrainBenchScenario, is_exact: bool = False) -> PositionServo:
    """Drives of the sliders with their rail, at rest where the walk begins.

    Args:
        scenario: its sliders, rail and period are taken.
        is_exact: true if they have neither lag nor counts.
    """
    sliders, geometry = scenario.machine.sliders, scenario.machine.geometry
    params = VelocityServoParams(
        resolution=1e-3 * sliders.encoder_resolution_mm,
        time_constant=1e-3 * sliders.time_constant_ms,
        max_velocity=sliders.max_velocity_m_s,
        acceleration=sliders.max_acceleration_m_s2 * (1.0 + _SLACK),
        stop_min=geometry.slider_min,
        stop_max=geometry.slider_max,
    )
    period, start, arrival = scenario.control.period, beginning(scenario), sliders.arrival_ms
    if is_exact:
        return PositionServo(params.exact(), 3, period, position=start)
    step = min(scenario.plant.time_step, period)
    return PositionServo(
        params, 3, period, step, start, None if arrival is None else 1e-3 * arrival
    )


def _put_sliders(
    drives: PositionServo, root_context: Context, scenario: TerrainBenchScenario
) -> None:
    drives.set_position(root_context, beginning(scenario))


def simulation_of(builder: DiagramBuilder, scenario: TerrainBenchScenario) -> Simulated:
    """A bench whose parts are put where a scenario's walk begins."""
    return Simulation(builder, lambda scenario: scenario, scenario)


def add_bodies(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the bench as rigid bodies with closed loops, the leg on its slide, and the drives."""
    simulation, period = simulation_of(builder, scenario), scenario.control.period
    settings = scenario.plant
    plant, scene_graph = add_plant(builder, settings.time_step, "lagged", settings.accuracy)
    machine, leg = scenario.machine, scenario.leg.under_test
    stiffness = 1e6 * machine.sliders.stiffness_N_um
    gains = PdControllerGains(p=stiffness, d=_DAMPING * stiffness)
    legs_held: list[LegOnSlide] = []

    def add_more() -> None:
        legs_held.append(_add_leg(plant, scenario, leg, scene_graph))

    model = add_bench(
        plant, machine.geometry, gains, add_more, machine.sliders.max_force_N, machine.bodies
    )
    (on_slide,) = legs_held
    leg_ends = [] if settings.accuracy is None else _freed(plant, on_slide)
    stand = _Stand(model, on_slide, leg)
    stand.set_default(scenario.walk)
    sliders = simulation.add_drives(make_sliders(scenario), "sliders", _put_sliders)
    ends = arrival(sliders, settings.accuracy)
    step = min(settings.time_step, period)
    reference = moving(builder, plant, ends, step)
    lead_joints(builder, plant, model.rail, reference.now)
    sampled = add(builder, ZeroOrderHold(period, 3), "slider_force")
    force = plant.get_net_actuation_output_port(model.rail)
    if settings.accuracy is not None:
        force = mean_force(builder, plant, [model.rail], reference.during, step)
    connect(builder, force, sampled.get_input_port())
    column = ConstantVectorSource(np.array((scenario.walk.hip[0], 0.0)))
    place = add(builder, column, "column").get_output_port()
    lead_joints(builder, plant, on_slide.column, place)
    _move_tread(simulation, _add_belt(simulation, scenario), plant, model)
    brake, foot_force = add_leg_ports(simulation, scenario, plant, on_slide, place)
    _add_cells(simulation, scenario, plant, model, foot_force)
    pushed = pushes_in(builder, plant, scenario.disturbances, model.body("plate"))
    weigh = push_bodies(builder, plant, scene_graph, pushed, meshcat)
    truth = add(builder, BenchTruth(model))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    signals = {name: truth.GetOutputPort(name) for name in ("pose", "loop_error")}
    signals["slider_force"] = sampled.get_output_port()
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "bench")
    slide, is_braked = plant.GetJointByName("slide", on_slide.slide), brake.get_output_port()

    def between_steps(root_context: Context) -> None:
        """Holds the slide while it is braked: a joint is locked by what does not step."""
        context = plant.GetMyMutableContextFromRoot(root_context)
        for end in leg_ends:
            end.check(context)
        signal: Any = is_braked.EvalBasicVector(brake.GetMyContextFromRoot(root_context))
        request = switched(signal[0]) is not False
        if request != slide.is_locked(context):
            (slide.Lock if request else slide.Unlock)(context)

    def put(root_context: Context, scenario: TerrainBenchScenario) -> None:
        stand.put(plant.GetMyMutableContextFromRoot(root_context), scenario.walk)

    simulation.add_plant(Plant(signals, put, after(between_steps, weigh), model))
    _add_current(simulation, scenario)
    return simulation.behind(PARTS)


class _Ends(NamedTuple):
    """Ends of a joint of the leg that a continuous plant goes without.

    CENIC of Drake 1.58 fails when the foot leaves the plate, if more than one joint between the
    world and the foot has ends; the slide keeps its own.
    """

    joint: Joint
    low: float
    high: float

    def check(self, context: Context) -> None:
        """Refuses to go on with a joint beyond its ends.

        Raises:
            ScenarioError: names the joint.
        """
        q = self.joint.GetOnePosition(context)
        if not self.low <= q <= self.high:
            raise ScenarioError(
                f"the leg's '{self.joint.name()}' comes to an end of its way, at {q:.3g} of "
                f"{self.low:.3g} to {self.high:.3g}, which a plant with plant.accuracy does not "
                "have; plant.accuracy must be null here",
                "plant.accuracy",
            )


def _freed(plant: MultibodyPlant, on_slide: LegOnSlide) -> list[_Ends]:
    """Takes the ends away from the joints of the leg, which are to be watched in their place."""
    ends = []
    for joint in map(plant.get_joint, plant.GetJointIndices(on_slide.leg.instance)):
        if joint.num_positions() != 1:
            continue
        (low,), (high,) = joint.position_lower_limits(), joint.position_upper_limits()
        if np.isfinite(low) or np.isfinite(high):
            ends.append(_Ends(joint, low, high))
            joint.set_position_limits(np.array((-np.inf,)), np.array((np.inf,)))
    return ends


def _add_leg(
    plant: MultibodyPlant,
    scenario: TerrainBenchScenario,
    leg: LegUnderTest,
    scene_graph: SceneGraph | None = None,
) -> LegOnSlide:
    machine = scenario.machine
    ends = machine.hip_min_mm / 1e3, machine.hip_max_mm / 1e3
    return add_leg_on_slide(plant, leg, scenario.hip.mass_kg, ends, scene_graph)


@dataclass(frozen=True)
class _Stand:
    """Puts bench and leg where a walk begins."""

    model: BenchModel
    on_slide: LegOnSlide
    leg: LegUnderTest

    def set_default(self, walk: BenchWalk) -> None:
        plant = self.model.plant
        plant.SetDefaultPositions(self.positions(walk))

    def put(self, context: Context, walk: BenchWalk) -> None:
        plant = self.model.plant
        plant.SetPositions(context, self.positions(walk))
        plant.SetVelocities(context, np.zeros(plant.num_velocities()))

    def positions(self, walk: BenchWalk) -> Array:
        plant, start = self.model.plant, walk.at(0.0)
        positions = np.zeros(plant.num_positions())
        positions[self.model.order] = self.model.positions(start.pose[0])
        leg = self.leg.reach(start.foot[0], float(start.pose[0, 2]))
        positions[list(self.order)] = (*walk.hip, *self.leg.all_joints(leg))
        return positions

    @property
    def order(self) -> tuple[int, ...]:
        """Indices of column, slide and the leg's joints among the plant's positions."""
        return self.on_slide.order(self.model.plant)


def _add_current(simulation: Simulated, scenario: TerrainBenchScenario) -> None:
    force = simulation.outputs["truth.slider_force"]
    simulation.add_current("sliders", force, scenario.machine.sliders.force_per_current_N_A)


def _add_belt(simulation: Simulated, scenario: TerrainBenchScenario) -> VelocityServo:
    """The belt's drive."""
    period = max(scenario.control.period, _BELT_PERIOD)
    step = min(scenario.plant.time_step, scenario.control.period)
    return simulation.add_drives(VelocityServo(_BELT, 1, period, step), "belt")


def _move_tread(
    simulation: Simulated, drive: VelocityServo, plant: MultibodyPlant, model: BenchModel
) -> None:
    """Moves the surface of a bench that has a belt."""
    if not model.geometry.belt:
        return
    builder = simulation.builder
    states = add(builder, Demultiplexer(2, 1), "belt_state")
    connect(builder, drive.GetOutputPort("state"), states.get_input_port(0))
    surface = add(builder, BeltSurface(model.body("tread").scoped_name().get_full()))
    connect(builder, states.get_output_port(1), surface.GetInputPort("velocity"))
    connect(builder, surface.get_output_port(), plant.get_surface_speeds_input_port())


class OnSlide(NamedTuple):
    """Slide and leg, as the rest of a plant needs them.

    Attributes:
        brake: shows the slide's brake.
        foot_force: force (2) of the ground on the foot, x and z [N]; to be sampled.
    """

    brake: System
    foot_force: OutputPort


def add_leg_ports(
    simulation: Simulated,
    scenario: TerrainBenchScenario,
    plant: MultibodyPlant,
    on_slide: LegOnSlide,
    column: OutputPort,
) -> OnSlide:
    """Adds the drives of slide and leg in a plant of bodies, and the ground's force on the foot.

    Args:
        simulation: takes the ports of slide and leg.
        scenario: its `control.period`, `hip` and leg are taken.
        plant: finalized; holds the leg on its slide.
        on_slide: the leg there.
        column: place and velocity (2) that the column is led to.

    Returns:
        What the rest of the plant needs of them.
    """
    builder, inputs, outputs = simulation.builder, simulation.inputs, simulation.outputs
    period, largest = scenario.control.period, np.array([scenario.hip.max_force_N])
    force = add(builder, Saturation(-largest, largest), "hip_force")
    hold = add(builder, ZeroOrderHold(period, 1), "hip_force_held")
    connect(builder, force.get_output_port(), hold.get_input_port())
    connect(builder, hold.get_output_port(), plant.get_actuation_input_port(on_slide.slide))
    brake = add(builder, ZeroOrderHold(period, 1), "hip_brake")
    inputs |= {
        "hip.force_command": force.get_input_port(),
        "hip.brake": brake.get_input_port(),
    }
    state = add(builder, Demultiplexer(2, 1), "hip_state")
    connect(builder, plant.get_state_output_port(on_slide.slide), state.get_input_port(0))
    outputs |= {
        "hip.position": state.get_output_port(0),
        "hip.velocity": state.get_output_port(1),
    }
    # The leg's joints and drives in the order of its ports, among all joints that it has.
    joints, instance = on_slide.leg.joints, on_slide.leg.instance
    n, size = len(joints), plant.num_velocities(instance)
    velocities = plant.GetVelocitiesFromArray(instance, np.arange(float(plant.num_velocities())))
    order = [int(np.flatnonzero(velocities == joint.velocity_start())[0]) for joint in joints]
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices(instance)]
    driven = [joints.index(actuator.joint()) for actuator in actuators]
    limits = np.array(scenario.leg.under_test.max_torque)
    torque = add(builder, Saturation(-limits, limits), "leg_torque")
    sampled = add(builder, ZeroOrderHold(period, n), "leg_torque_held")
    select = add(builder, MatrixGain(np.eye(n)[driven]), "leg_drives")
    for source, sink in (
        (torque.get_output_port(), sampled.get_input_port()),
        (sampled.get_output_port(), select.get_input_port()),
        (select.get_output_port(), plant.get_actuation_input_port(instance)),
    ):
        connect(builder, source, sink)
    inputs["leg.torque_command"] = torque.get_input_port()
    rows = np.eye(2 * size)
    for name, order_shown in (("position", order), ("velocity", [size + i for i in order])):
        part = add(builder, MatrixGain(rows[order_shown]), f"leg_{name}")
        connect(builder, plant.get_state_output_port(instance), part.get_input_port())
        outputs[f"leg.{name}"] = part.get_output_port()
    if plant.time_step() == 0.0:
        foot_force = _add_foot_balance(builder, scenario, plant, on_slide, column)
        sampled = add(builder, ZeroOrderHold(period, 2), "foot_force")
        connect(builder, foot_force, sampled.get_input_port())
        outputs["truth.foot_force"] = sampled.get_output_port()
        return OnSlide(brake, foot_force)
    # The ground's force on the foot is what moves column and slide besides their drives.
    contact = add(builder, Multiplexer([1, 1]), "foot_force")
    for i, of in enumerate((on_slide.column, on_slide.slide)):
        port = plant.get_generalized_contact_forces_output_port(of)
        connect(builder, port, contact.get_input_port(i))
    outputs["truth.foot_force"] = contact.get_output_port(0)
    return OnSlide(brake, contact.get_output_port(0))


def _add_foot_balance(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    plant: MultibodyPlant,
    on_slide: LegOnSlide,
    column: OutputPort,
) -> OutputPort:
    """The ground's force (2) on the foot in a continuous plant, to be sampled."""
    period = scenario.control.period
    step = min(scenario.plant.time_step, period)
    slide = plant.GetJointByName("slide", on_slide.slide)
    balance = add(builder, FootBalance(plant, slide, on_slide.leg.instance, period))
    for name, port in (
        ("state", plant.get_state_output_port()),
        ("contact_results", plant.get_contact_results_output_port()),
        ("column_force", mean_force(builder, plant, [on_slide.column], column, step)),
        ("slide_force", plant.get_net_actuation_output_port(on_slide.slide)),
    ):
        connect(builder, port, balance.GetInputPort(name))
    return balance.get_output_port()


def _add_cells(
    simulation: Simulated,
    scenario: TerrainBenchScenario,
    plant: MultibodyPlant,
    model: BenchModel,
    foot_force: OutputPort,
) -> None:
    """The force cells and their noise."""
    builder, cells_set = simulation.builder, scenario.machine.cells
    joint = plant.GetJointByName("cells", model.carried)
    x, z = model.geometry.p_OP
    index = plant.GetJointIndices().index(joint.index())
    forces = plant.get_reaction_forces_output_port()
    if plant.time_step() == 0.0:
        index, period = 0, scenario.control.period
        balance = add(builder, TreadBalance(plant, joint, period))
        contacts = plant.get_contact_results_output_port()
        connect(builder, plant.get_state_output_port(), balance.GetInputPort("state"))
        connect(builder, contacts, balance.GetInputPort("contact_results"))
        connect(builder, foot_force, balance.GetInputPort("foot_force"))
        forces = balance.get_output_port()
    geometry = scenario.machine.cells_geometry
    cells = add(builder, ForceCells(geometry, index, (-x, -z), cells_set.noise_N))
    noise = _add_noise(simulation, scenario)
    connect(builder, noise.get_output_port(), cells.GetInputPort("noise"))
    connect(builder, forces, cells.GetInputPort("reaction_forces"))
    hold = add(builder, ZeroOrderHold(scenario.control.period, _SOURCES), "cells_held")
    connect(builder, cells.GetOutputPort("force"), hold.get_input_port())
    simulation.outputs["cells.force"] = hold.get_output_port()


def _add_noise(simulation: Simulated, scenario: TerrainBenchScenario) -> NoiseSource:
    """Noise of the force cells, by the seed of a beginning."""
    source = NoiseSource(_SOURCES, scenario.control.period, scenario.seed)
    noise = add(simulation.builder, source, "cell_noise")

    def put(root_context: Context, scenario: TerrainBenchScenario) -> None:
        noise.set_seed(noise.GetMyMutableContextFromRoot(root_context), scenario.seed)

    simulation.on_put(put)
    return noise


def resting(scenario: TerrainBenchScenario) -> Rest:
    """Measurements of a leg that stands still off the plate, whatever its drives do."""
    walk = scenario.walk
    start = walk.at(0.0)
    stands = scenario.leg.under_test.reach(start.foot[0], float(start.pose[0, 2]))
    return {"hip.position": walk.hip[1], "leg.position": stands}


def add_kinematics(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the bench as closed-form kinematics, and its drives; no leg stands on the plate.

    The leg rests above it, the slide is held, no force acts.
    """
    simulation = simulation_of(builder, scenario)
    noise = _add_noise(simulation, scenario)
    scale = MatrixGain(scenario.machine.cells.noise_N * np.eye(_SOURCES))
    cells = add(builder, scale, "cells")
    connect(builder, noise.get_output_port(), cells.get_input_port())
    add_plate(simulation, scenario)
    simulation.outputs["cells.force"] = cells.get_output_port()
    simulation.rest(ports_of_joints(scenario.leg.ports), resting(scenario))
    if meshcat is not None:
        hip = add(builder, ConstantVectorSource(np.array(scenario.walk.hip)), "hip_drawn")
        outputs = simulation.outputs
        signals = (outputs["truth.pose"], hip.get_output_port(), outputs["leg.position"])
        add_drawing(builder, scenario, signals, meshcat)
    return simulation.behind(PARTS)


def add_plate(simulation: Simulated, scenario: TerrainBenchScenario) -> None:
    """Adds a bench without dynamics, and the ports of all but slide, leg and cells.

    Args:
        simulation: takes the ports.
        scenario: its bench is added.
    """
    builder = simulation.builder
    sliders = simulation.add_drives(make_sliders(scenario), "sliders", _put_sliders)
    _add_belt(simulation, scenario)
    none = add(builder, ConstantVectorSource(np.zeros(3)), "no_force")
    pair = add(builder, ConstantVectorSource(np.zeros(2)), "no_gaps")
    pose = add(builder, PlatePose(scenario.machine.geometry))
    connect(builder, sliders.GetOutputPort("position"), pose.GetInputPort("position"))
    signals = {"pose": pose.get_output_port(), "slider_force": none.get_output_port()}
    signals |= dict.fromkeys(("foot_force", "loop_error"), pair.get_output_port())
    simulation.add_plant(Plant(signals, lambda root_context, scenario: None))
    _add_current(simulation, scenario)


def mirror(mock: Simulated, scenario: TerrainBenchScenario) -> Rest:
    """Sliders are at their commands a period later, and so is the belt; the leg rests."""
    mock.add_drives(make_sliders(scenario, is_exact=True), "sliders")
    _add_belt(mock, scenario)
    return resting(scenario)


def add_drawing(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    outputs_shown: tuple[OutputPort, OutputPort, OutputPort],
    meshcat: Meshcat | None,
    path: str = "bench",
) -> None:
    """Draws bench and leg where they are.

    Args:
        builder: builder of the diagram that holds the ports' systems.
        scenario: its bench and leg are drawn.
        outputs_shown: pose of the plate (3), column and height of the hip (2), joints of the leg
            (n).
        meshcat: the scene; None: poses are all that is asked for.
        path: its path in the scene.
    """
    leg = scenario.leg.under_test

    def add_model(plant: MultibodyPlant) -> System:
        legs_held: list[LegOnSlide] = []
        model = add_bench(
            plant,
            scenario.machine.geometry,
            add_more=lambda: legs_held.append(_add_leg(plant, scenario, leg)),
            bodies=scenario.machine.bodies,
        )
        order = legs_held[0].order(plant)
        return BenchPositions(model, order, scenario.leg.ports, leg.all_joints)

    signals = dict(zip(("pose", "hip", "leg"), outputs_shown, strict=True))
    scene_graph, _ = draw_model(builder, path, add_model, signals)
    publish(builder, scene_graph, meshcat, path)
