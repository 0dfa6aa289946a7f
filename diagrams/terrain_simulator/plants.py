"""Plants behind the terrain simulator's station: rigid bodies, kinematics, mock."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    MatrixGain,
    Multiplexer,
    PassThrough,
    Saturation,
    ZeroOrderHold,
)

from parapod.diagrams.drawing import draw, publish, remove_visuals
from parapod.diagrams.multibody import add_discrete_plant
from parapod.diagrams.ports import Behind
from parapod.diagrams.simulated import add_status, ports_of_drives
from parapod.diagrams.terrain_simulator.leg import LegUnderTest
from parapod.diagrams.terrain_simulator.model import LegOnSlide, add_bench, add_leg_on_slide
from parapod.diagrams.terrain_simulator.ports import PARTS
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.core.switching import switched
from parapod.systems.core.vectors import Array
from parapod.systems.sensors.noise import NoiseSource
from parapod.systems.terrain_simulator.belt import BeltSurface
from parapod.systems.terrain_simulator.cells import ForceCells
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


@dataclass(frozen=True)
class Simulation:
    """A simulated bench and the handles that put it at its beginning.

    Attributes:
        sliders: the drives of the sliders.
        stand: puts the plant where a walk begins, in a root context.
        noise: noise of the force cells.
        parts: further systems that experiments reach, by name.
    """

    sliders: PositionServo
    stand: Callable[[Context, TerrainBenchScenario], None] = lambda root, scenario: None
    noise: NoiseSource | None = None
    parts: dict[str, Any] = field(default_factory=dict)

    def reset(self, root_context: Context, scenario: TerrainBenchScenario) -> None:
        """Puts the bench where its walk begins.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its walk's beginning and seed are taken; what is built in stays.
        """
        self.sliders.set_position(root_context, beginning(scenario))
        if self.noise is not None:
            context = self.noise.GetMyMutableContextFromRoot(root_context)
            self.noise.set_seed(context, scenario.seed)
        self.stand(root_context, scenario)


def beginning(scenario: TerrainBenchScenario) -> Array:
    """Places of the sliders (3) where the walk begins [m]."""
    return slider_places(scenario.machine.geometry, scenario.walk.at(0.0).pose[0])


def slider_params(scenario: TerrainBenchScenario) -> VelocityServoParams:
    """Parameters of the sliders' drives, with their rail."""
    sliders, geometry = scenario.machine.sliders, scenario.machine.geometry
    return VelocityServoParams(
        resolution=1e-3 * sliders.encoder_resolution_mm,
        time_constant=1e-3 * sliders.time_constant_ms,
        max_velocity=sliders.max_velocity_m_s,
        acceleration=sliders.max_acceleration_m_s2 * (1.0 + _SLACK),
        stop_min=geometry.slider_min,
        stop_max=geometry.slider_max,
    )


def make_servo(scenario: TerrainBenchScenario) -> PositionServo:
    """Drives of the sliders, at rest where the walk begins."""
    period, arrival = scenario.control.period, scenario.machine.sliders.arrival_ms
    return PositionServo(
        slider_params(scenario),
        3,
        period,
        min(scenario.plant.time_step, period),
        beginning(scenario),
        None if arrival is None else 1e-3 * arrival,
    )


def add_bodies(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the bench as rigid bodies with closed loops, the leg on its slide, and the drives."""
    walk, period = scenario.walk, scenario.control.period
    step = scenario.plant.time_step
    plant, scene_graph = add_discrete_plant(builder, step, "lagged")
    stiffness = 1e6 * scenario.machine.sliders.stiffness_N_um
    gains = PdControllerGains(p=stiffness, d=_DAMPING * stiffness)
    legs_held: list[LegOnSlide] = []
    leg = scenario.leg.under_test

    def add_more() -> None:
        legs_held.append(_add_leg(plant, scenario, leg, scene_graph))

    machine = scenario.machine
    model = add_bench(
        plant, machine.geometry, gains, add_more, machine.sliders.max_force_N, machine.bodies
    )
    (on_slide,) = legs_held
    stand = _Stand(model, on_slide, leg)
    stand.set_default(walk)
    sliders = add(builder, make_servo(scenario), "sliders")
    connect(
        builder,
        sliders.GetOutputPort("next_state"),
        plant.get_desired_state_input_port(model.rail),
    )
    force = plant.get_net_actuation_output_port(model.rail)
    sampled = add(builder, ZeroOrderHold(period, 3), "slider_force")
    connect(builder, force, sampled.get_input_port())
    inputs, outputs = ports_of_drives(sliders, "position_command", "sliders")
    outputs |= _current(builder, scenario, sampled.get_output_port())
    column = add(builder, ConstantVectorSource(np.array((walk.hip[0], 0.0))), "column")
    connect(builder, column.get_output_port(), plant.get_desired_state_input_port(on_slide.column))
    belt_inputs, belt_outputs = _add_belt(builder, scenario, plant, model)
    inputs |= belt_inputs
    outputs |= belt_outputs
    brake = add_leg_ports(builder, scenario, plant, on_slide, leg, inputs, outputs)
    noise = _add_cells(builder, scenario, plant, model, outputs)
    truth = add(builder, BenchTruth(model))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    outputs |= {f"truth.{name}": truth.GetOutputPort(name) for name in ("pose", "loop_error")}
    outputs["truth.slider_force"] = sampled.get_output_port()
    outputs |= add_status(builder, PARTS)
    _show(builder, plant, scene_graph, meshcat)
    slide, is_braked = plant.GetJointByName("slide", on_slide.slide), brake.get_output_port()

    def between_steps(root_context: Context) -> None:
        """Holds the slide while it is braked: a joint is locked by what does not step."""
        context = plant.GetMyMutableContextFromRoot(root_context)
        signal: Any = is_braked.EvalBasicVector(brake.GetMyContextFromRoot(root_context))
        request = switched(signal[0]) is not False
        if request != slide.is_locked(context):
            (slide.Lock if request else slide.Unlock)(context)

    def put(root_context: Context, scenario: TerrainBenchScenario) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        stand.put(context, scenario.walk)

    simulation = Simulation(sliders, put, noise, {"plant": plant, "model": model})
    return Behind(
        inputs, outputs, simulation.reset, between_steps=between_steps, handle=simulation
    )


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


def _current(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, force: OutputPort
) -> dict[str, OutputPort]:
    """Currents of the sliders' motors by the forces of their drives."""
    per_newton = 1.0 / scenario.machine.sliders.force_per_current_N_A
    current = add(builder, MatrixGain(per_newton * np.eye(3)), "slider_current")
    connect(builder, force, current.get_input_port())
    return {"sliders.current": current.get_output_port()}


def _add_belt(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    plant: MultibodyPlant | None = None,
    model: BenchModel | None = None,
) -> tuple[dict[str, InputPort], dict[str, OutputPort]]:
    """The belt's drive, and in a plant of bodies the surface that it moves."""
    period = max(scenario.control.period, _BELT_PERIOD)
    step = min(scenario.plant.time_step, scenario.control.period)
    drive = add(builder, VelocityServo(_BELT, 1, period, step), "belt")
    if plant is not None and model is not None and model.geometry.belt:
        states = add(builder, Demultiplexer(2, 1), "belt_state")
        connect(builder, drive.GetOutputPort("state"), states.get_input_port(0))
        body = model.body("tread").scoped_name().get_full()
        surface = add(builder, BeltSurface(body))
        connect(builder, states.get_output_port(1), surface.GetInputPort("velocity"))
        connect(builder, surface.get_output_port(), plant.get_surface_speeds_input_port())
    return ports_of_drives(drive, "velocity_command", "belt")


def add_leg_ports(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    plant: MultibodyPlant,
    on_slide: LegOnSlide,
    leg: LegUnderTest,
    inputs: dict[str, InputPort],
    outputs: dict[str, OutputPort],
) -> System:
    """Adds the drives of slide and leg in a plant of bodies, and the ground's force on the foot.

    Args:
        builder: builder of the station.
        scenario: its `control.period` and `hip` are taken.
        plant: finalized; holds the leg on its slide.
        on_slide: the leg there.
        leg: the leg alone.
        inputs: ports of the station, to which those of slide and leg are added.
        outputs: the same for outputs.

    Returns:
        What shows the slide's brake.
    """
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
    limits = np.array(leg.max_torque)
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
    # The ground's force on the foot is what moves column and slide besides their drives.
    contact = add(builder, Multiplexer([1, 1]), "foot_force")
    for i, of in enumerate((on_slide.column, on_slide.slide)):
        port = plant.get_generalized_contact_forces_output_port(of)
        connect(builder, port, contact.get_input_port(i))
    outputs["truth.foot_force"] = contact.get_output_port(0)
    return brake


def _add_cells(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    plant: MultibodyPlant,
    model: BenchModel,
    outputs: dict[str, OutputPort],
) -> NoiseSource:
    """The force cells and their noise."""
    period = scenario.control.period
    joint = plant.GetJointByName("cells", model.carried)
    x, z = model.geometry.p_OP
    cells = add(
        builder,
        ForceCells(
            scenario.machine.cells_geometry,
            plant.GetJointIndices().index(joint.index()),
            (-x, -z),
            scenario.machine.cells.noise_N,
        ),
    )
    noise = add(builder, NoiseSource(_SOURCES, period, scenario.seed), "cell_noise")
    connect(builder, noise.get_output_port(), cells.GetInputPort("noise"))
    forces = plant.get_reaction_forces_output_port()
    connect(builder, forces, cells.GetInputPort("reaction_forces"))
    hold = add(builder, ZeroOrderHold(period, _SOURCES), "cells_held")
    connect(builder, cells.GetOutputPort("force"), hold.get_input_port())
    outputs["cells.force"] = hold.get_output_port()
    return noise


def _show(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    meshcat: Meshcat | None,
) -> None:
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "bench")


def _add_resting(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    inputs: dict[str, InputPort],
    outputs: dict[str, OutputPort],
) -> None:
    """A leg that stands still whatever its drives do, off the plate, and its slide."""
    walk, n = scenario.walk, scenario.leg.ports
    ignored = {"hip.force_command": 1, "hip.brake": 1, "leg.torque_command": n}
    for name, size in ignored.items():
        sink = add(builder, PassThrough(size), name.replace(".", "_"))
        inputs[name] = sink.get_input_port()
    start = walk.at(0.0)
    stands = scenario.leg.under_test.reach(start.foot[0], float(start.pose[0, 2]))
    resting: dict[str, ArrayLike] = {
        "hip.position": [walk.hip[1]],
        "hip.velocity": [0.0],
        "leg.position": stands,
        "leg.velocity": np.zeros(n),
    }
    for name, value in resting.items():
        source = add(
            builder, ConstantVectorSource(np.array(value)), name.replace(".", "_") + "_resting"
        )
        outputs[name] = source.get_output_port()


def add_kinematics(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the bench as closed-form kinematics, and its drives; no leg stands on the plate.

    The leg rests above it, the slide is held, no force acts.
    """
    period, servo = scenario.control.period, make_servo(scenario)
    noise = add(builder, NoiseSource(_SOURCES, period, scenario.seed), "cell_noise")
    scaled_noise = add(
        builder, MatrixGain(scenario.machine.cells.noise_N * np.eye(_SOURCES)), "cells"
    )
    connect(builder, noise.get_output_port(), scaled_noise.get_input_port())
    behind = _add_led(builder, scenario, servo, scaled_noise.get_output_port(), meshcat)
    simulation = replace(behind.handle_as(Simulation), noise=noise)
    return replace(behind, reset=simulation.reset, handle=simulation)


def add_mock(
    builder: DiagramBuilder, scenario: TerrainBenchScenario, meshcat: Meshcat | None = None
) -> Behind:
    """Adds what mirrors commands to measurements, exactly and without dynamics.

    Sliders are at their commands a period later, and so is the belt; the leg rests, no
    force acts. There are no `truth` ports: nothing is hidden.

    Args:
        builder: builder of the station.
        scenario: its period, drives' limits and beginning are taken.
        meshcat: not used; there is nothing to draw.
    """
    exact = replace(slider_params(scenario), resolution=0.0, time_constant=1e-9)
    servo = PositionServo(exact, 3, scenario.control.period, position=beginning(scenario))
    none = add(builder, ConstantVectorSource(np.zeros(_SOURCES)), "cells")
    behind = _add_led(builder, scenario, servo, none.get_output_port(), None)
    outputs = {n: p for n, p in behind.outputs.items() if not n.startswith("truth.")}
    return replace(behind, outputs=outputs)


def _add_led(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    servo: PositionServo,
    cells: OutputPort,
    meshcat: Meshcat | None,
) -> Behind:
    """A bench without dynamics behind its drives, and a leg that rests."""
    inputs, outputs = add_plate(builder, scenario, servo, cells)
    _add_resting(builder, scenario, inputs, outputs)
    if meshcat is not None:
        hip = add(builder, ConstantVectorSource(np.array(scenario.walk.hip)), "hip_drawn")
        outputs_shown = (outputs["truth.pose"], hip.get_output_port(), outputs["leg.position"])
        add_drawing(builder, scenario, outputs_shown, meshcat)
    simulation = Simulation(servo)
    return Behind(inputs, outputs, simulation.reset, handle=simulation)


def add_plate(
    builder: DiagramBuilder,
    scenario: TerrainBenchScenario,
    servo: PositionServo,
    cells: OutputPort,
) -> tuple[dict[str, InputPort], dict[str, OutputPort]]:
    """Adds a bench without dynamics; returns the ports of all but slide and leg.

    Args:
        builder: builder of the station.
        scenario: its bench is added.
        servo: drives of the sliders.
        cells: forces of the cells (3).
    """
    sliders = add(builder, servo, "sliders")
    inputs, outputs = ports_of_drives(sliders, "position_command", "sliders")
    belt_inputs, belt_outputs = _add_belt(builder, scenario)
    none = add(builder, ConstantVectorSource(np.zeros(3)), "no_force")
    pair = add(builder, ConstantVectorSource(np.zeros(2)), "no_gaps")
    pose = add(builder, PlatePose(scenario.machine.geometry))
    connect(builder, sliders.GetOutputPort("position"), pose.GetInputPort("position"))
    outputs |= belt_outputs | _current(builder, scenario, none.get_output_port())
    outputs |= {
        "cells.force": cells,
        "truth.pose": pose.get_output_port(),
        "truth.slider_force": none.get_output_port(),
        "truth.foot_force": pair.get_output_port(),
        "truth.loop_error": pair.get_output_port(),
    }
    return inputs | belt_inputs, outputs | add_status(builder, PARTS)


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
    plant = MultibodyPlant(time_step=1e-3)
    scene_graph = add(builder, SceneGraph(), f"drawing_of_{path}")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    legs_held: list[LegOnSlide] = []
    leg = scenario.leg.under_test
    model = add_bench(
        plant,
        scenario.machine.geometry,
        add_more=lambda: legs_held.append(_add_leg(plant, scenario, leg)),
        bodies=scenario.machine.bodies,
    )
    drawn_positions = BenchPositions(
        model, legs_held[0].order(plant), scenario.leg.ports, leg.all_joints
    )
    positions = add(builder, drawn_positions, f"positions_of_{path}")
    for port, name in zip(outputs_shown, ("pose", "hip", "leg"), strict=True):
        connect(builder, port, positions.GetInputPort(name))
    draw(builder, plant, positions.get_output_port(), scene_graph)
    publish(builder, scene_graph, meshcat, path)
