"""Plants behind the walking chair's station: rigid bodies and statics, with their drives.

Rigid bodies of another engine are in `parapod.diagrams.walking_chair.mujoco`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.disturbances import rising_ground
from parapod.diagrams.drawing import draw, draw_model, publish, remove_visuals
from parapod.diagrams.multibody import add_plant, arrival, drive_joints, lead_joints
from parapod.diagrams.pads import PADS
from parapod.diagrams.ports import Behind
from parapod.diagrams.pushes import push_bodies, pushes_in
from parapod.diagrams.simulated import Plant, Rest, Simulation
from parapod.diagrams.walking_chair.model import BranchDrive, add_chair, add_passenger
from parapod.diagrams.walking_chair.ports import PARTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.walking_chair.gait import Walk, starting_lengths
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT
from parapod.systems.walking_chair.kinematic_chair import KinematicChair
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import ChairModel, ChairPose, ChairTruth


@dataclass(frozen=True, eq=False)
class Beginning:
    """Beginning of a scenario, in the quantities that the parts of the machine are set to.

    Attributes:
        lengths: lengths of the branches (4, 3) [m].
        body: centre of the body (3) in the world [m].
        passenger: person on the seat.
        gain: gains of the drives (12) [-].
        offset: velocities of the drives at a command of zero (12) [m/s].
    """

    lengths: NDArray[np.float64]
    body: NDArray[np.float64]
    passenger: Passenger
    gain: NDArray[np.float64]
    offset: NDArray[np.float64]

    @classmethod
    def from_scenario(cls, walk: Walk, scenario: ChairScenario) -> Self:
        """Works out the beginning of a scenario.

        Args:
            walk: the walk that begins.
            scenario: its passenger, drives' errors and seed are taken.
        """
        # One stream for both: their order is part of what a seed means.
        random = np.random.default_rng(scenario.seed)
        error, offset = (
            scenario.machine.drives.gain_error,
            1e-3 * scenario.machine.drives.offset_mm_s,
        )
        return cls(
            lengths=starting_lengths(scenario.machine.geometry, walk),
            body=np.asarray(walk.motion(scenario.machine.geometry, 0.0).body.position),
            passenger=scenario.passenger.passenger,
            gain=1.0 + random.uniform(-error, error, len(BRANCHES)),
            offset=random.uniform(-offset, offset, len(BRANCHES)),
        )


@dataclass(frozen=True)
class ChairPlant(Plant[Beginning]):
    """Plant of the chair; its signals are all of the truth but positions.

    Attributes:
        seat: exchanges the passenger, in a root context.
    """

    seat: Callable[[Context, Passenger], None] = lambda root_context, passenger: None


type PlantMaker = Callable[
    [DiagramBuilder, ChairScenario, Beginning, VelocityServo, Meshcat | None], ChairPlant
]


def add_designed_chair(
    plant: MultibodyPlant,
    scenario: ChairScenario,
    passenger: Passenger,
    giving: SceneGraph | None = None,
) -> ChairModel:
    """Adds the chair of a scenario to a plant, and finalizes it; see `add_chair`."""
    machine, drives = scenario.machine, scenario.machine.drives
    branch = BranchDrive(drives.stiffness, drives.max_force_N)
    return add_chair(plant, passenger, machine.geometry, machine.bodies, branch, giving)


def make_statics(scenario: ChairScenario, beginning: Beginning) -> KinematicChair:
    """The chair of a scenario in closed form, at its beginning."""
    machine = scenario.machine
    return KinematicChair(
        machine.geometry,
        machine.masses,
        beginning.passenger,
        scenario.control.period,
        beginning.body[:2],
        machine.drives.stiffness,
    )


def add_multibody_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    beginning: Beginning,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> ChairPlant:
    """Adds the plant of rigid bodies, whose branches are held to where the drives are."""
    settings = scenario.plant
    plant, scene_graph = add_plant(
        builder, settings.time_step, settings.contact_approximation, settings.accuracy
    )
    rising = rising_ground(builder, scenario.disturbances, LEG_COUNT)
    giving = None if rising is None else scene_graph
    model = add_designed_chair(plant, scenario, beginning.passenger, giving)
    plant.SetDefaultPositions(model.standing_positions(beginning.lengths, beginning.body))
    ends = arrival(drives, settings.accuracy)
    force = drive_joints(builder, plant, model.legs, ends, settings.time_step)
    truth = add(builder, ChairTruth(model))
    if rising is not None:
        lead_joints(builder, plant, plant.GetModelInstanceByName(PADS), rising)
        connect(builder, rising, truth.GetInputPort("rising"))
    contact = plant.get_contact_results_output_port()
    connect(builder, contact, truth.GetInputPort("contact_results"))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    exchanged = (model.passenger,)
    pushed = pushes_in(builder, plant, scenario.disturbances, model.body, exchanged)
    weigh = push_bodies(builder, plant, scene_graph, pushed, meshcat)
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "chair")
    names = ("body_position", "body_attitude", "contact_force", "foot_height", "loop_error")
    signals = {name: truth.GetOutputPort(name) for name in names} | {"force": force}

    def stand(root_context: Context, beginning: Beginning) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.stand(context, beginning.lengths, beginning.body, beginning.passenger)

    def seat(root_context: Context, passenger: Passenger) -> None:
        model.seat(plant.GetMyMutableContextFromRoot(root_context), passenger)

    return ChairPlant(signals, stand, weigh, model, seat)


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    beginning: Beginning,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> ChairPlant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    statics = make_statics(scenario, beginning)
    chair = add(builder, statics)
    connect(builder, drives.GetOutputPort("position"), chair.GetInputPort("position"))
    names = ("body_position", "body_attitude", "contact_force", "foot_height", "force")
    signals = {name: chair.GetOutputPort(name) for name in names}
    no_loops = add(builder, ConstantVectorSource(np.zeros(2 * LEG_COUNT)), "no_loops")
    signals["loop_error"] = no_loops.get_output_port()
    if meshcat is not None:
        add_drawing(builder, scenario, drives.GetOutputPort("position"), chair, meshcat)

    def stand(root_context: Context, beginning: Beginning) -> None:
        chair.stand(root_context, beginning.body[:2], beginning.passenger)

    return ChairPlant(signals, stand, seat=chair.seat)


def add_drawing(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    position: OutputPort,
    chair: KinematicChair,
    meshcat: Meshcat | None,
    path: str = "chair",
) -> None:
    """Draws the bodies where the statics have them; the passenger is moved on the seat.

    Args:
        builder: builder of the diagram that holds `chair`.
        scenario: its passenger is drawn.
        position: lengths of the branches (12) [m].
        chair: statics with these lengths.
        meshcat: scene in which to draw; None: poses are all that is asked for.
        path: its path in the scene.
    """
    empty = replace(scenario.passenger.passenger, mass=0.0)
    signals = {"position": position, "body_pose": chair.GetOutputPort("body_pose")}
    scene_graph, _ = draw_model(
        builder,
        path,
        lambda plant: ChairPose(add_designed_chair(plant, scenario, empty)),
        signals,
    )
    if scenario.passenger.mass_kg > 0.0:
        figure = MultibodyPlant(time_step=1.0)
        figure.RegisterAsSourceForSceneGraph(scene_graph)
        add_passenger(figure, scenario.passenger.passenger)
        draw(builder, figure, chair.GetOutputPort("passenger_pose"), scene_graph)
    publish(builder, scene_graph, meshcat, path)


def add_simulated(
    add_plant: PlantMaker,
    builder: DiagramBuilder,
    scenario: ChairScenario,
    meshcat: Meshcat | None,
) -> Behind:
    """Adds drives, a plant, currents and status.

    Args:
        add_plant: adds the plant.
        builder: builder of the station.
        scenario: the scenario to build.
        meshcat: draws the machine there; None for no drawing.
    """
    begin = partial(Beginning.from_scenario, scenario.walk)
    simulation = Simulation(builder, begin, scenario)
    # Only samples of the statics count: twice as often as the command.
    is_static = scenario.backend == "kinematic"
    step = 0.5 * scenario.control.period if is_static else scenario.plant.time_step
    beginning = simulation.beginning
    drives = simulation.add_drives(make_drives(scenario, beginning, step), "legs", _put_drives)
    plant = add_plant(builder, scenario, beginning, drives, meshcat)
    simulation.add_plant(plant)
    per_current = scenario.machine.drives.force_per_current
    simulation.add_current("legs", plant.signals["force"], per_current)
    simulation.outputs["truth.position"] = drives.GetOutputPort("position")
    return simulation.behind(PARTS)


def _put_drives(drives: VelocityServo, root_context: Context, beginning: Beginning) -> None:
    drives.set_position(root_context, beginning.lengths.ravel())
    drives.set_imperfection(root_context, beginning.gain, beginning.offset)


def make_drives(
    scenario: ChairScenario, beginning: Beginning | None = None, step: float | None = None
) -> VelocityServo:
    """The twelve drives, with the stroke of each; exact ones without a beginning.

    Args:
        scenario: its drives, period and strokes are taken.
        beginning: their lengths and imperfections; None: they are at the beginning of
            the walk, without lag, counts and errors.
        step: step of their model [s]; None for the period.
    """
    drives, strokes = scenario.machine.drives, scenario.machine.geometry.leg.strokes
    params = VelocityServoParams(
        resolution=1e-3 * drives.encoder_resolution_mm,
        time_constant=1e-3 * drives.time_constant_ms,
        max_velocity=1e-3 * drives.max_velocity_mm_s,
        stop_min=tuple(strokes[:, 0].tolist()) * LEG_COUNT,
        stop_max=tuple(strokes[:, 1].tolist()) * LEG_COUNT,
    )
    count, period = len(BRANCHES), scenario.control.period
    if beginning is None:
        start = starting_lengths(scenario.machine.geometry, scenario.walk)
        return VelocityServo(params.exact(), count, period, position=start.ravel())
    return VelocityServo(
        params,
        count,
        period,
        step,
        position=beginning.lengths.ravel(),
        gain=beginning.gain,
        offset=beginning.offset,
    )


def mirror(mock: Simulation[ChairScenario, ChairScenario], scenario: ChairScenario) -> Rest:
    """Branches move at their commanded velocities; motors draw no current."""
    mock.add_drives(make_drives(scenario), "legs")
    return {}
