"""Multibody plants as all machines simulate them, and the ground that they stand on."""

import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from pydrake.geometry import AddContactMaterial, HalfSpace, ProximityProperties, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain, ZeroOrderHold

from parapod.diagrams.simulators import ErrorControl
from parapod.diagrams.wiring import add, connect, first_of, split_states
from parapod.systems.actuators.holding_force import HoldingForce
from parapod.systems.actuators.moving_reference import MovingReference
from parapod.systems.actuators.pi_servo import PiServo
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServo


def add_plant(
    builder: DiagramBuilder,
    time_step: float,
    contact_approximation: str,
    accuracy: float | None = None,
) -> tuple[MultibodyPlant, SceneGraph]:
    """Adds a plant with point contact and its scene graph.

    The output ports of a discrete plant are not sampled: that would make every step an
    unrestricted update, which copies the whole state of the diagram. Whoever feeds one of them
    back samples that one.

    Args:
        builder: builder of the diagram.
        time_step: time step of the plant, and the longest one under error control [s].
        contact_approximation: Drake's discrete contact approximation.
        accuracy: accuracy of error control, with which the plant is continuous, see
            `ErrorControl` [m, rad]; None for a discrete plant.
    """
    if accuracy is not None:
        # Before the plant: then it comes first where derivatives are asked for.
        add(builder, ErrorControl(accuracy, time_step))
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=time_step if accuracy is None else 0.0,
            contact_model="point",
            discrete_contact_approximation=contact_approximation,
            use_sampled_output_ports=False,
        ),
        builder,
    )
    return plant, scene_graph


def arrival(drives: VelocityServo | PositionServo | PiServo, accuracy: float | None) -> OutputPort:
    """Positions and velocities of drives at the end of their step, where a plant is to arrive.

    The step of a discrete plant begins as that of the drives does: with the state before it. A
    continuous plant is integrated once the drives' state is that of the end.

    Args:
        drives: drives that take steps as long as the plant's, or between whose steps it is
            integrated.
        accuracy: accuracy of the plant's error control; None for a discrete plant.
    """
    return drives.GetOutputPort("next_state" if accuracy is None else "state")


class Reference(NamedTuple):
    """Positions and velocities (2n) that joints follow, as their plant needs them.

    Attributes:
        now: to lead the joints to.
        during: those by which the drives' forces are known, in the step that ends.
    """

    now: OutputPort
    during: OutputPort


def moving(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    ends: OutputPort,
    step: float,
    sampled_every: Sequence[float] = (),
) -> Reference:
    """References that move between the steps of drives in a continuous plant.

    The steps of a discrete plant are those of the drives; it is led to the ends as they are.

    Args:
        builder: builder of the diagram that holds the plant.
        plant: the plant.
        ends: positions (n) and then velocities (n) at the end of the drives' step, see `arrival`.
        step: step of the drives [s].
        sampled_every: periods of what else is sampled, and not at whole steps of the drives [s].
    """
    if plant.time_step() > 0.0:
        return Reference(ends, ends)
    drives = MovingReference(ends.size() // 2, step, sampled_every)
    reference = add(builder, drives, f"moving_{ends.get_name()}")
    connect(builder, ends, reference.GetInputPort("arrival"))
    return Reference(reference.GetOutputPort("now"), reference.GetOutputPort("during"))


def lead_joints(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    instance: ModelInstanceIndex,
    desired_state: OutputPort,
) -> None:
    """Has the implicit drives of a model instance follow positions and velocities.

    In a continuous plant a drive follows q_d + (d / p) v_d at rest, which is the same force:
    CENIC of Drake 1.58 takes the damper's d v_d with the wrong sign, and a drive that moves would
    be late by 2 d / p.

    Args:
        builder: builder of the diagram that holds the plant.
        plant: finalized.
        instance: model instance whose actuators have gains.
        desired_state: positions (n) and then velocities (n) of its actuators.
    """
    if plant.time_step() == 0.0:
        name = plant.GetModelInstanceName(instance)
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices(instance))
        gains = [actuator.get_controller_gains() for actuator in actuators]
        count = len(gains)
        both = np.eye(2 * count)
        both[:count, count:] = np.diag([gain.d / gain.p for gain in gains])
        both[count:] = 0.0
        folded = add(builder, MatrixGain(both), f"{name}_led_to")
        connect(builder, desired_state, folded.get_input_port())
        desired_state = folded.get_output_port()
    connect(builder, desired_state, plant.get_desired_state_input_port(instance))


def drive_joints(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    instances: Sequence[ModelInstanceIndex],
    desired_state: OutputPort,
    step: float,
    sampled_every: float | None = None,
) -> OutputPort:
    """Has the plant's implicit drives follow servos; returns the forces with which they hold.

    These are those of the sample before: drives measure them, and the next commands may
    depend on them.

    Args:
        builder: builder of the diagram that holds the plant.
        plant: finalized; its actuators have gains, and those of the instances come first.
        instances: model instances whose joints are driven; all have the same number of joints.
        desired_state: positions and then velocities of all servos at the end of their step, see
            `arrival`.
        step: step of the servos [s].
        sampled_every: period of the forces' samples [s]; None for the step.
    """
    reference = moving(builder, plant, desired_state, step)
    parts = split_states(builder, "leg_states", reference.now, len(instances))
    for port, instance in zip(parts, instances, strict=True):
        lead_joints(builder, plant, instance, port)
    count = sum(plant.num_actuators(instance) for instance in instances)
    holding = add(builder, ZeroOrderHold(sampled_every or step, count), "holding_force")
    force = first_of(builder, plant.get_net_actuation_output_port(), count, "efforts")
    if plant.time_step() == 0.0:
        force = mean_force(builder, plant, instances, reference.during, step)
    connect(builder, force, holding.get_input_port())
    return holding.get_output_port()


def mean_force(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    instances: Sequence[ModelInstanceIndex],
    desired_state: OutputPort,
    step: float,
) -> OutputPort:
    """Forces of implicit drives in a continuous plant, to be sampled; see `HoldingForce`.

    Args:
        builder: builder of the diagram that holds the plant.
        plant: finalized; continuous.
        instances: model instances whose actuators are meant.
        desired_state: positions and then velocities that all of them follow.
        step: step of the servos, whose mean it is [s].
    """
    actuators = [
        plant.get_joint_actuator(index)
        for instance in instances
        for index in plant.GetJointActuatorIndices(instance)
    ]
    joints, gains = zip(*((a.joint(), a.get_controller_gains()) for a in actuators), strict=True)
    force = HoldingForce(
        plant.num_multibody_states(),
        [joint.position_start() for joint in joints],
        [plant.num_positions() + joint.velocity_start() for joint in joints],
        [gain.p for gain in gains],
        [gain.d for gain in gains],
        [actuator.effort_limit() for actuator in actuators],
        step,
    )
    add(builder, force, f"mean_force_of_{plant.GetModelInstanceName(instances[0])}")
    connect(builder, plant.get_state_output_port(), force.GetInputPort("state"))
    connect(builder, desired_state, force.GetInputPort("desired_state"))
    return force.get_output_port()


def add_ground(parser: Parser, size: int = 1) -> ModelInstanceIndex:
    """Adds the body `ground`, a plane drawn as a ruled slab; it is to be welded somewhere.

    The plane is not in the file: URDF has none, and SDFormat takes ten times as long to parse.

    Args:
        parser: parser of the plant, which knows the models of `parapod.urdf`.
        size: factor by which the slab is drawn longer and wider than in its file, squares and all.
    """

    def stretch(root: ElementTree.Element) -> None:
        for shape in root.iterfind("link/visual"):
            for part, key in (("origin", "xyz"), ("geometry/box", "size")):
                if (element := shape.find(part)) is not None:
                    x, y, z = map(float, element.attrib[key].split())
                    element.set(key, f"{size * x} {size * y} {z}")

    slab = add_adapted_model(parser, "package://parapod/ground/ground.urdf", "ground", stretch)
    plant = parser.plant()
    ground, plane = plant.GetBodyByName("ground", slab), HalfSpace()
    plant.RegisterCollisionGeometry(ground, RigidTransform(), plane, "plane", ground_contact())
    return slab


def ground_contact() -> ProximityProperties:
    """Stiffness, damping and friction with which the ground bears feet and wheels."""
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=1.0,
        point_stiffness=5e7,
        friction=CoulombFriction(0.8, 0.8),
        properties=properties,
    )
    return properties


def add_adapted_model(
    parser: Parser, url: str, name: str, adapt: Callable[[ElementTree.Element], None]
) -> ModelInstanceIndex:
    """Adds a model of a URDF file that is not as the file has it.

    A plant's dimensions and inertias can be changed in a context, but not in its default context:
    for that they must be other ones from the start.

    Args:
        parser: parser of the plant, which knows the models of `parapod.urdf`.
        url: the file.
        name: name of the model instance.
        adapt: changes the file's `robot` element in place.
    """
    ElementTree.register_namespace("drake", "http://drake.mit.edu")
    root = ElementTree.fromstring(
        Path(parser.package_map().ResolveUrl(url)).read_text(encoding="utf-8")
    )
    root.set("name", name)
    adapt(root)
    (model,) = parser.AddModelsFromString(ElementTree.tostring(root, encoding="unicode"), "urdf")
    return model


def _concerns_us(record: logging.LogRecord) -> bool:
    """False for Drake's warnings that are about what is not used here.

    And for one about a line of a file that was printed before: a file is in several plants.
    """
    words = record.getMessage()
    if ": warning: " in words:
        is_new = words not in _SAID
        _SAID.add(words)
        return is_new
    return not any(part in words for part in _UNCONCERNING)


# Parts of such warnings: no body is deformable, and CENIC, which integrates all continuous plants
# here, keeps the ends of joints.
_UNCONCERNING = (
    "half spaces are not currently supported for deformable",
    "does not handle joint limits for continuous models",
)
# Warnings about files that have been printed.
_SAID: set[str] = set()
logging.getLogger("drake").addFilter(_concerns_us)
