"""Plants behind the machining centres' station: rigid bodies, kinematics, mock."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.plant import Propeller, PropellerInfo
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain

from parapod.diagrams.drawing import publish, remove_visuals
from parapod.diagrams.machining_centre.drawing import add_colours, add_drawing
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.machining_centre.ports import PARTS
from parapod.diagrams.machining_centre.scenario import CentreScenario, Plan
from parapod.diagrams.multibody import add_discrete_plant, drive_joints
from parapod.diagrams.ports import Behind
from parapod.diagrams.simulated import add_status, ports_of_drives
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


@dataclass(frozen=True)
class Plant:
    """Signals of a plant for the sensors and the truth.

    Attributes:
        switches: ports of the closed locks and clamps.
        signals: ports by name: pose, feet, joints, leg_force, clamp_gap, loop_error.
        stand: puts the centre at rest, in a root context, where a plan begins.
        between_steps: see `Behind`.
    """

    switches: Switches
    signals: dict[str, OutputPort]
    stand: Callable[[Context, Plan], None]
    between_steps: Callable[[Context], None] | None = None


class Legs(NamedTuple):
    """Lengths of the legs as they are: those of the drives' encoders with their errors.

    Attributes:
        position: lengths (2n) [m].
        next_state: lengths and rates (4n) one step ahead [m, m/s].
        error: source of the errors (2n) [m].
    """

    position: OutputPort
    next_state: OutputPort
    error: ConstantVectorSource


type PlantMaker = Callable[
    [DiagramBuilder, CentreScenario, Legs, DrillingProcess, Meshcat | None], Plant
]


def _add_legs(builder: DiagramBuilder, scenario: CentreScenario, drives: PositionServo) -> Legs:
    errors, count = scenario.length_errors, scenario.machine.geometry.legs
    source = add(builder, ConstantVectorSource(errors), "length_error")
    rest = add(builder, MatrixGain(np.eye(2 * count, count)), "length_and_rate_error")
    connect(builder, source.get_output_port(), rest.get_input_port())
    legs_shown = []
    for name, error in (("position", source), ("next_state", rest)):
        port = drives.GetOutputPort(name)
        total = add(builder, Adder(2, port.size()), f"true_{name}")
        connect(builder, port, total.get_input_port(0))
        connect(builder, error.get_output_port(), total.get_input_port(1))
        legs_shown.append(total.get_output_port())
    return Legs(legs_shown[0], legs_shown[1], source)


def _add_multibody_plant(
    builder: DiagramBuilder,
    scenario: CentreScenario,
    legs: Legs,
    drilling: DrillingProcess,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant of rigid bodies, whose legs are held to where the drives are."""
    geometry, plan = scenario.machine.geometry, scenario.plan
    plant, scene_graph = add_discrete_plant(builder, scenario.plant.time_step, "lagged")
    stiffness = 1e6 * scenario.machine.legs.stiffness_N_um
    pose, feet = plan.beginning
    gains = PdControllerGains(p=stiffness, d=_DAMPING * stiffness)
    model = add_centre(plant, geometry, gains, feet, scenario.machine.bodies)
    plant.SetDefaultPositions(model.positions(pose, feet))
    control = scenario.control.period
    force = drive_joints(builder, plant, model.limbs, legs.next_state, sampled_every=control)
    truth = add(builder, CentreTruth(model))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    connect(builder, plant.get_state_output_port(), truth.GetInputPort("state"))
    _load(builder, scenario, model, drilling)
    switches = add(
        builder,
        Switches(geometry, period=control, delay=1e-3 * scenario.plant.switching_ms),
    )
    connect(builder, truth.GetOutputPort("feet"), switches.GetInputPort("feet"))
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "centre")
    locking = Locking(model, switches, plan.job.panel)
    names = ("pose", "feet", "joints", "clamp_gap", "loop_error")
    signals = {name: truth.GetOutputPort(name) for name in names} | {"leg_force": force}

    def stand(root_context: Context, plan: Plan) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.stand(context, *plan.beginning)

    return Plant(switches, signals, stand, locking.obey)


def _load(
    builder: DiagramBuilder,
    scenario: CentreScenario,
    model: CentreModel,
    drilling: DrillingProcess,
) -> None:
    """Puts thrust and torque of the material on the platform, along the drill."""
    process, plant = scenario.plan.job.process, model.plant
    ratio = process.torque / process.thrust if process.thrust > 0.0 else 0.0
    info = PropellerInfo(model.platform.index(), RigidTransform(), 1.0, ratio)
    drill = add(builder, Propeller([info]), "drill")
    thrust = add(builder, MatrixGain(np.array([[1.0, 0.0]])), "thrust")
    connect(builder, drilling.GetOutputPort("tool_force"), thrust.get_input_port())
    connect(builder, thrust.get_output_port(), drill.get_command_input_port())
    connect(builder, plant.get_body_poses_output_port(), drill.get_body_poses_input_port())
    applied = plant.get_applied_spatial_force_input_port()
    connect(builder, drill.get_spatial_forces_output_port(), applied)


def _add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: CentreScenario,
    legs: Legs,
    drilling: DrillingProcess,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant without dynamics, and with `meshcat` a drawing of it."""
    geometry, plan, period = scenario.machine.geometry, scenario.plan, scenario.control.period
    pose, feet = plan.beginning
    posture = add(builder, CentrePosture(geometry, period, pose, feet))
    delay = 1e-3 * scenario.plant.switching_ms
    switches = add(builder, Switches(geometry, plan.job.panel, period, delay))
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

    def stand(root_context: Context, plan: Plan) -> None:
        posture.stand(root_context, plan.beginning.pose, plan.beginning.feet)

    return Plant(switches, signals, stand)


@dataclass(frozen=True)
class Simulation:
    """A simulated centre and the handles that put it at its beginning.

    Attributes:
        plant: the plant.
        drives: the legs' drives.
        legs: their true lengths.
    """

    plant: Plant
    drives: PositionServo
    legs: Legs

    def reset(self, root_context: Context, scenario: CentreScenario) -> None:
        """Puts the centre where its job begins.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its plan's beginning is taken; what is built in stays.
        """
        errors, error = scenario.length_errors, self.legs.error
        self.drives.set_position(root_context, _encoded(scenario))
        error.get_mutable_source_value(
            error.GetMyMutableContextFromRoot(root_context)
        ).SetFromVector(errors)
        self.plant.stand(root_context, scenario.plan)


def _add_simulated(
    add_plant: PlantMaker,
    drive_step: float,
    builder: DiagramBuilder,
    scenario: CentreScenario,
    meshcat: Meshcat | None,
) -> Behind:
    """Adds drives, a plant, the drill, currents and status.

    Args:
        add_plant: adds the plant.
        drive_step: step of the drives' model [s].
        builder: builder of the station.
        scenario: the scenario to build.
        meshcat: draws the machine there; None for no drawing.
    """
    geometry, plan, period = scenario.machine.geometry, scenario.plan, scenario.control.period
    arrival = scenario.machine.legs.arrival_ms
    servo = PositionServo(
        drive_params(scenario),
        geometry.legs,
        period,
        drive_step,
        _encoded(scenario),
        None if arrival is None else 1e-3 * arrival,
    )
    drives = add(builder, servo, "drives")
    legs = _add_legs(builder, scenario, drives)
    job = plan.job
    drilling = add(builder, DrillingProcess(job.process, job.panel, job.speeds.feed, period))
    plant = add_plant(builder, scenario, legs, drilling, meshcat)
    connect(builder, plant.signals["pose"], drilling.GetInputPort("pose"))
    if meshcat is not None:
        switch_states = [
            plant.switches.GetOutputPort(f"{name}_closed") for name in ("locks", "clamps")
        ]
        add_colours(builder, geometry, (switch_states[0], switch_states[1]), meshcat)
    per_newton = 1.0 / scenario.machine.legs.force_per_current_N_A
    current = add(builder, MatrixGain(per_newton * np.eye(geometry.legs)), "motor_current")
    connect(builder, plant.signals["leg_force"], current.get_input_port())
    inputs, outputs = ports_of_drives(drives, "position_command")
    inputs |= {
        f"{part}.command": plant.switches.GetInputPort(f"{part}_command")
        for part in ("locks", "clamps")
    }
    outputs |= {
        f"{part}.closed": plant.switches.GetOutputPort(f"{part}_closed")
        for part in ("locks", "clamps")
    }
    outputs |= {
        "legs.current": current.get_output_port(),
        "tool.force": drilling.GetOutputPort("tool_force"),
        "truth.tip_height": drilling.GetOutputPort("tip_height"),
    }
    outputs |= {f"truth.{name}": port for name, port in plant.signals.items()}
    outputs |= add_status(builder, PARTS)
    simulation = Simulation(plant, drives, legs)
    return Behind(
        inputs, outputs, simulation.reset, between_steps=plant.between_steps, handle=simulation
    )


def add_bodies(
    builder: DiagramBuilder, scenario: CentreScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the centre as rigid bodies with closed loops, locks and clamps, and its drives."""
    step = scenario.plant.time_step
    return _add_simulated(_add_multibody_plant, step, builder, scenario, meshcat)


def add_kinematics(
    builder: DiagramBuilder, scenario: CentreScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the centre as closed-form kinematics, and its drives."""
    # Only samples of this plant count: twice as often as the command.
    step = 0.5 * scenario.control.period
    return _add_simulated(_add_kinematic_plant, step, builder, scenario, meshcat)


def _encoded(scenario: CentreScenario) -> NDArray[np.float64]:
    """Lengths (2n) that the encoders measure where the job begins [m]."""
    lengths = leg_lengths(scenario.machine.geometry, *scenario.plan.beginning)
    return lengths - scenario.length_errors


def drive_params(scenario: CentreScenario) -> VelocityServoParams:
    """Parameters of the legs' drives, with their stroke."""
    legs, geometry = scenario.machine.legs, scenario.machine.geometry
    return VelocityServoParams(
        resolution=1e-3 * legs.encoder_resolution_mm,
        time_constant=1e-3 * legs.time_constant_ms,
        max_velocity=1e-3 * legs.max_velocity_mm_s,
        stop_min=geometry.stroke_min,
        stop_max=geometry.stroke_max,
    )


def add_mock(
    builder: DiagramBuilder, scenario: CentreScenario, meshcat: Meshcat | None = None
) -> Behind:
    """Adds what mirrors commands to measurements, exactly and without dynamics.

    Legs are at their commands, locks and clamps too, a period later; the motors
    draw no current. There are no `truth` ports: nothing is hidden.

    Args:
        builder: builder of the station.
        scenario: its period, drives' limits and beginning are taken.
        meshcat: not used; there is nothing to draw.
    """
    geometry, period = scenario.machine.geometry, scenario.control.period
    exact = replace(drive_params(scenario), resolution=0.0, time_constant=1e-9)
    start: NDArray[np.float64] = leg_lengths(geometry, *scenario.plan.beginning)
    drives = add(builder, PositionServo(exact, geometry.legs, period, position=start), "drives")
    # All feet are always on this one.
    panel = Panel(math.inf, geometry.foot_height)
    switches = add(builder, Switches(geometry, panel, period))
    feet = np.tile(panel.foothold(0.0, 0.0), geometry.limbs)
    somewhere = add(builder, ConstantVectorSource(feet), "somewhere")
    connect(builder, somewhere.get_output_port(), switches.GetInputPort("feet"))
    current = add(builder, ConstantVectorSource(np.zeros(geometry.legs)), "motor_current")
    inputs, outputs = ports_of_drives(drives, "position_command")
    for part in ("locks", "clamps"):
        inputs[f"{part}.command"] = switches.GetInputPort(f"{part}_command")
        outputs[f"{part}.closed"] = switches.GetOutputPort(f"{part}_closed")
    outputs |= {"legs.current": current.get_output_port()} | add_status(builder, PARTS)
    return Behind(inputs, outputs)
