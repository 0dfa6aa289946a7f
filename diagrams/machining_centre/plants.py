"""Plants behind the machining centres' station: rigid bodies and kinematics, with the drives."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.plant import Propeller, PropellerInfo
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain

from parapod.diagrams.disturbances import rising_ground
from parapod.diagrams.drawing import publish, remove_visuals
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.machining_centre.ports import PARTS
from parapod.diagrams.machining_centre.scenario import CentreScenario, Plan
from parapod.diagrams.machining_centre.view import add_colours, add_drawing
from parapod.diagrams.multibody import add_plant, arrival, drive_joints, lead_joints
from parapod.diagrams.pads import PADS
from parapod.diagrams.ports import Behind
from parapod.diagrams.pushes import after, push_bodies, pushes_in
from parapod.diagrams.simulated import Plant, Rest, Simulation
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.machining_centre.drilling import DrillingProcess
from parapod.systems.machining_centre.locking import Locking
from parapod.systems.machining_centre.model import CentreModel, CentreTruth
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.machining_centre.posture import CentrePosture
from parapod.systems.machining_centre.statics import CentreStatics
from parapod.systems.machining_centre.switches import Switches

# Damping of a leg with its screw and drive by its stiffness [s] (assumption).
_DAMPING = 0.01


@dataclass(frozen=True, eq=False)
class Beginning:
    """Beginning of a scenario.

    Attributes:
        plan: job; its beginning is that of platform and feet.
        errors: errors of the encoders' lengths (2n) [m].
        encoded: lengths (2n) that the encoders measure [m].
    """

    plan: Plan
    errors: NDArray[np.float64]
    encoded: NDArray[np.float64]

    @classmethod
    def from_scenario(cls, scenario: CentreScenario) -> "Beginning":
        """Works out the beginning of a scenario."""
        errors, plan = scenario.length_errors, scenario.plan
        return cls(plan, errors, leg_lengths(scenario.machine.geometry, *plan.beginning) - errors)


class Legs(NamedTuple):
    """Lengths of the legs as they are: those of the drives' encoders with their errors.

    Attributes:
        position: lengths (2n) [m].
        arrival: lengths and rates (4n) at the end of the drives' step [m, m/s].
    """

    position: OutputPort
    arrival: OutputPort


type PlantMaker = Callable[
    [DiagramBuilder, CentreScenario, Legs, DrillingProcess, Switches, Meshcat | None],
    Plant[Beginning],
]


def _add_legs(
    simulation: Simulation[CentreScenario, Beginning],
    drives: PositionServo,
    accuracy: float | None,
) -> Legs:
    """Adds the errors of the encoders to the lengths of the drives."""
    builder, errors = simulation.builder, simulation.beginning.errors
    count = errors.size
    source = add(builder, ConstantVectorSource(errors), "length_error")
    rest = add(builder, MatrixGain(np.eye(2 * count, count)), "length_and_rate_error")
    connect(builder, source.get_output_port(), rest.get_input_port())
    legs_shown = []
    for port, error in (
        (drives.GetOutputPort("position"), source),
        (arrival(drives, accuracy), rest),
    ):
        total = add(builder, Adder(2, port.size()), f"true_{port.get_name()}")
        connect(builder, port, total.get_input_port(0))
        connect(builder, error.get_output_port(), total.get_input_port(1))
        legs_shown.append(total.get_output_port())

    def put(root_context: Context, beginning: Beginning) -> None:
        context = source.GetMyMutableContextFromRoot(root_context)
        source.get_mutable_source_value(context).SetFromVector(beginning.errors)

    simulation.on_put(put)
    return Legs(*legs_shown)


def add_multibody_plant(
    builder: DiagramBuilder,
    scenario: CentreScenario,
    legs: Legs,
    drilling: DrillingProcess,
    switches: Switches,
    meshcat: Meshcat | None,
) -> Plant[Beginning]:
    """Adds the plant of rigid bodies, whose legs are held to where the drives are."""
    geometry, plan = scenario.machine.geometry, scenario.plan
    settings = scenario.plant
    plant, scene_graph = add_plant(builder, settings.time_step, "lagged", settings.accuracy)
    stiffness = 1e6 * scenario.machine.legs.stiffness_N_um
    pose, feet = plan.beginning
    gains = PdControllerGains(p=stiffness, d=_DAMPING * stiffness)
    rising = rising_ground(builder, scenario.disturbances, geometry.limbs)
    model = add_centre(
        plant, geometry, gains, feet, scenario.machine.bodies, ground_gives=rising is not None
    )
    if rising is not None:
        lead_joints(builder, plant, plant.GetModelInstanceByName(PADS), rising)
    plant.SetDefaultPositions(model.positions(pose, feet))
    control = scenario.control.period
    step = settings.time_step
    force = drive_joints(builder, plant, model.limbs, legs.arrival, step, control)
    truth = add(builder, CentreTruth(model))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    connect(builder, plant.get_state_output_port(), truth.GetInputPort("state"))
    thrust = _add_thrust(builder, scenario, model, drilling)
    pushed = pushes_in(builder, plant, scenario.disturbances, model.platform)
    weigh = push_bodies(builder, plant, scene_graph, pushed, meshcat, [thrust])
    connect(builder, truth.GetOutputPort("feet"), switches.GetInputPort("feet"))
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "centre")
    locking = Locking(model, switches, plan.job.panel)
    names = ("pose", "feet", "joints", "clamp_gap", "loop_error")
    signals = {name: truth.GetOutputPort(name) for name in names} | {"leg_force": force}

    def put(root_context: Context, beginning: Beginning) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.stand(context, *beginning.plan.beginning)

    return Plant(signals, put, after(locking.obey, weigh), model)


def _add_thrust(
    builder: DiagramBuilder,
    scenario: CentreScenario,
    model: CentreModel,
    drilling: DrillingProcess,
) -> OutputPort:
    """Thrust and torque of the material on the platform, along the drill."""
    process, plant = scenario.plan.job.process, model.plant
    ratio = process.torque / process.thrust if process.thrust > 0.0 else 0.0
    info = PropellerInfo(model.platform.index(), RigidTransform(), 1.0, ratio)
    drill = add(builder, Propeller([info]), "drill")
    thrust = add(builder, MatrixGain(np.array([[1.0, 0.0]])), "thrust")
    connect(builder, drilling.GetOutputPort("tool_force"), thrust.get_input_port())
    connect(builder, thrust.get_output_port(), drill.get_command_input_port())
    connect(builder, plant.get_body_poses_output_port(), drill.get_body_poses_input_port())
    return drill.get_spatial_forces_output_port()


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: CentreScenario,
    legs: Legs,
    drilling: DrillingProcess,
    switches: Switches,
    meshcat: Meshcat | None,
) -> Plant[Beginning]:
    """Adds the plant without dynamics, and with `meshcat` a drawing of it."""
    geometry, plan, period = scenario.machine.geometry, scenario.plan, scenario.control.period
    pose, feet = plan.beginning
    posture = add(builder, CentrePosture(geometry, period, pose, feet))
    statics = add(builder, CentreStatics(geometry, plan.job.process.masses))
    for name in ("locks_closed", "clamps_closed"):
        connect(builder, switches.GetOutputPort(name), posture.GetInputPort(name))
    connect(builder, posture.GetOutputPort("feet"), switches.GetInputPort("feet"))
    connect(builder, legs.position, posture.GetInputPort("position"))
    for name, source in (
        ("pose", posture),
        ("feet", posture),
        ("clamps_closed", switches),
        ("tool_force", drilling),
    ):
        connect(builder, source.GetOutputPort(name), statics.GetInputPort(name))
    none = add(builder, ConstantVectorSource(np.zeros(geometry.limbs)), "no_gaps")
    signals = {name: posture.GetOutputPort(name) for name in ("pose", "feet", "joints")}
    signals["leg_force"] = statics.GetOutputPort("leg_force")
    signals |= dict.fromkeys(("clamp_gap", "loop_error"), none.get_output_port())
    if meshcat is not None:
        add_drawing(builder, geometry, signals["pose"], signals["feet"], meshcat)

    def put(root_context: Context, beginning: Beginning) -> None:
        posture.stand(root_context, *beginning.plan.beginning)

    return Plant(signals, put)


def add_simulated(
    add_plant: PlantMaker,
    builder: DiagramBuilder,
    scenario: CentreScenario,
    meshcat: Meshcat | None,
) -> Behind:
    """Adds drives, a plant, switches, the drill, currents and status.

    Args:
        add_plant: adds the plant.
        builder: builder of the station.
        scenario: the scenario to build.
        meshcat: draws the machine there; None for no drawing.
    """
    geometry, period = scenario.machine.geometry, scenario.control.period
    simulation = Simulation(builder, Beginning.from_scenario, scenario)
    is_kinematic = scenario.backend == "kinematic"
    # Only samples of kinematics count: twice as often as the command.
    step = 0.5 * period if is_kinematic else scenario.plant.time_step
    servo = make_drives(scenario, simulation.beginning, step)
    drives = simulation.add_drives(servo, "legs", _put_drives)
    legs = _add_legs(simulation, drives, scenario.plant.accuracy)
    job = scenario.plan.job
    drilling = add(builder, DrillingProcess(job.process, job.panel, job.speeds.feed, period))
    # Feet of bodies are where the panel has them.
    panel, delay = (job.panel if is_kinematic else None), 1e-3 * scenario.plant.switching_ms
    switches = add_switches(simulation, Switches(geometry, panel, period, delay))
    plant = add_plant(builder, scenario, legs, drilling, switches, meshcat)
    simulation.add_plant(plant)
    connect(builder, plant.signals["pose"], drilling.GetInputPort("pose"))
    if meshcat is not None:
        locks, clamps = (simulation.outputs[f"{part}.closed"] for part in ("locks", "clamps"))
        add_colours(builder, geometry, (locks, clamps), meshcat)
    per_current = scenario.machine.legs.force_per_current_N_A
    simulation.add_current("legs", plant.signals["leg_force"], per_current)
    simulation.outputs["tool.force"] = drilling.GetOutputPort("tool_force")
    simulation.outputs["truth.tip_height"] = drilling.GetOutputPort("tip_height")
    return simulation.behind(PARTS)


def _put_drives(drives: PositionServo, root_context: Context, beginning: Beginning) -> None:
    drives.set_position(root_context, beginning.encoded)


def make_drives(
    scenario: CentreScenario, beginning: Beginning, step: float | None = None
) -> PositionServo:
    """The legs' drives, with their stroke; exact ones without a step.

    Args:
        scenario: its legs and period are taken.
        beginning: beginning at which they are.
        step: step of their model [s]; None: they have neither lag nor counts nor errors.
    """
    legs, geometry = scenario.machine.legs, scenario.machine.geometry
    params = VelocityServoParams(
        resolution=1e-3 * legs.encoder_resolution_mm,
        time_constant=1e-3 * legs.time_constant_ms,
        max_velocity=1e-3 * legs.max_velocity_mm_s,
        stop_min=geometry.stroke_min,
        stop_max=geometry.stroke_max,
    )
    period, start = scenario.control.period, beginning.encoded
    if step is None:
        lengths = start + beginning.errors
        return PositionServo(params.exact(), geometry.legs, period, position=lengths)
    arrival = None if legs.arrival_ms is None else 1e-3 * legs.arrival_ms
    return PositionServo(params, geometry.legs, period, step, start, arrival)


def add_switches[B](simulation: Simulation[CentreScenario, B], switches: Switches) -> Switches:
    """Adds locks and clamps."""
    add(simulation.builder, switches)
    for part in ("locks", "clamps"):
        simulation.inputs[f"{part}.command"] = switches.GetInputPort(f"{part}_command")
        simulation.outputs[f"{part}.closed"] = switches.GetOutputPort(f"{part}_closed")
    return switches


def mirror(mock: Simulation[CentreScenario, CentreScenario], scenario: CentreScenario) -> Rest:
    """Legs are at their commands a period later, and so are locks and clamps."""
    geometry = scenario.machine.geometry
    mock.add_drives(make_drives(scenario, Beginning.from_scenario(scenario)), "legs")
    # All feet are always on this one.
    panel = Panel(math.inf, geometry.foot_height)
    switches = add_switches(mock, Switches(geometry, panel, scenario.control.period))
    feet = ConstantVectorSource(np.tile(panel.foothold(0.0, 0.0), geometry.limbs))
    somewhere = add(mock.builder, feet, "somewhere")
    connect(mock.builder, somewhere.get_output_port(), switches.GetInputPort("feet"))
    return {}
