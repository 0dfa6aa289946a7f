"""The levelling platform's bodies, joints and ground in a plant; drawings and pictures."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, Meshcat, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    LoadModelDirectives,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, RevoluteJoint, RigidBody
from pydrake.systems.framework import DiagramBuilder, OutputPort

from parapod.diagrams.drawing import View, add_renderer, draw, publish, take
from parapod.diagrams.levelling_platform.scenario import ControlScenario, LevellingScenario
from parapod.diagrams.multibody import add_adapted_model, add_ground, ground_contact
from parapod.diagrams.wiring import add, connect
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.fault_detection import FaultDetectorParams
from parapod.systems.levelling_platform.geometry import (
    LEG_COUNT,
    PlatformGeometry,
    drawn_deviations,
)
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import (
    LIMIT_SWITCHES,
    MODEL_GEOMETRY,
    WHEEL_COUNT,
    ParallelLinks,
    PlatformModel,
    PlatformPose,
    ground_pose,
    hip_pose,
    joint_origins,
    standing_pose,
)
from parapod.urdf import configure_parser

_FOLDER = "package://parapod/levelling_platform"
# Looks for faults of this machine's end switches.
FAULT_DETECTOR = FaultDetectorParams(
    extended=LIMIT_SWITCHES.extended, retracted=LIMIT_SWITCHES.retracted
)
# Gains of the wheels' position servos [N m/rad, N m s/rad] (assumption).
_WHEEL_GAINS = PdControllerGains(p=2000.0, d=50.0)


# Pads of uneven ground: side [m], where the feet stand in the middle of the stroke, colour.
_PAD_SIZE, _FEET_AT = 0.3, 0.405
_PAD_COLOUR = np.array([0.45, 0.42, 0.38, 1.0])


def geometry_as_built(scenario: LevellingScenario) -> PlatformGeometry:
    """Geometry of the scenario's machine: the drawing, and errors drawn from the seed."""
    length, angle = scenario.plant.length_error_mm, scenario.plant.angle_error_deg
    if not (length or angle):
        return MODEL_GEOMETRY
    # A stream of its own: errors do not change what else is drawn from the seed.
    random = np.random.default_rng((scenario.seed, 1))
    deviations = drawn_deviations(random, 1e-3 * length, math.radians(angle))
    return replace(MODEL_GEOMETRY, deviations=deviations)


def geometry_as_known(control: ControlScenario) -> PlatformGeometry:
    """Geometry that the controller reckons with: the drawing, or the legs as identified.

    Raises:
        ScenarioError: deviations of some legs only.
    """
    if not control.leg_deviations:
        return MODEL_GEOMETRY
    count, key = len(control.leg_deviations), "control.leg_deviations"
    if count != LEG_COUNT:
        raise ScenarioError(f"{key} must have {LEG_COUNT} elements or none, not {count}", key)
    deviations = tuple(leg.deviation for leg in control.leg_deviations)
    return replace(MODEL_GEOMETRY, deviations=deviations)


def add_platform(
    plant: MultibodyPlant,
    leg_model: str = "full",
    wheels: str = "braked",
    ground: tuple[float, float] = (0.0, 0.0),
    geometry: PlatformGeometry = MODEL_GEOMETRY,
    foot_offsets: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> PlatformModel:
    """Adds platform and ground to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        leg_model: "full" or "reduced".
        wheels: "braked" makes them part of the base, "rolling" gives them driven joints.
        ground: roll and pitch of the ground in a default context [rad].
        geometry: dimensions of the legs as built.
        foot_offsets: heights under the feet above the ground's plane [m]; if any is not zero,
            each foot gets a pad to stand on.
    """
    parser = Parser(plant)
    configure_parser(parser)
    _add_machine(parser, leg_model, geometry)
    for i in range(1, WHEEL_COUNT + 1):
        axle = plant.GetFrameByName(f"axle_{i}")
        wheel = plant.GetFrameByName("wheel", plant.GetModelInstanceByName(f"wheel_{i}"))
        if wheels == "braked":
            plant.WeldFrames(axle, wheel)
        else:
            turn = plant.AddJoint(RevoluteJoint(f"wheel_{i}", axle, wheel, np.array([0, 1.0, 0])))
            plant.AddJointActuator(f"wheel_{i}", turn).set_controller_gains(_WHEEL_GAINS)
    slab = add_ground(parser)
    X_WG = ground_pose(ground, foot_offsets)
    mount: Any = plant.AddFrame(FixedOffsetFrame("ground_mount", plant.world_frame(), X_WG))
    plant.WeldFrames(mount, plant.GetFrameByName("ground", slab))
    if any(foot_offsets):
        _add_pads(plant, plant.GetBodyByName("ground", slab), foot_offsets)
    plant.Finalize()
    return PlatformModel(plant, mount, geometry)


def _add_machine(parser: Parser, leg_model: str, geometry: PlatformGeometry) -> None:
    """Adds base, legs, arm and wheels; hips and legs as the geometry has them."""
    url = f"{_FOLDER}/platform_{leg_model}.dmd.yaml"
    if geometry == MODEL_GEOMETRY:
        parser.AddModels(url=url)
        return
    directives = LoadModelDirectives(parser.package_map().ResolveUrl(url)).directives
    of_legs = [k for k, directive in enumerate(directives) if _is_of_leg(directive)]
    before, after = directives[: of_legs[0]], directives[of_legs[-1] + 1 :]
    files = [model.file for k in of_legs if (model := directives[k].add_model) is not None]
    ProcessModelDirectives(ModelDirectives(directives=before), parser)
    plant = parser.plant()
    base = plant.GetFrameByName("base")
    legs = zip(geometry.legs, MODEL_GEOMETRY.legs, files, strict=True)
    for i, (leg, nominal_leg, file) in enumerate(legs, start=1):
        mount: Any = plant.AddFrame(FixedOffsetFrame(f"hip_{i}", base, hip_pose(leg)))
        adapt = functools.partial(_move_joints, joint_origins(leg, nominal_leg, leg_model))
        instance = add_adapted_model(parser, file, f"leg_{i}", adapt)
        plant.WeldFrames(mount, plant.GetFrameByName("hip", instance))
    ProcessModelDirectives(ModelDirectives(directives=after), parser)


def _is_of_leg(directive: Any) -> bool:
    """Whether a directive adds a leg, its mount, or the weld between both."""
    named = directive.add_model or directive.add_frame
    name = named.name if named else directive.add_weld.parent
    return str(name).startswith(("hip_", "leg_"))


def _move_joints(origins: Mapping[str, Sequence[float]], root: Element) -> None:
    """Gives joints of a URDF model other origins [m]."""
    for joint, origin in origins.items():
        element = root.find(f"joint[@name='{joint}']/origin")
        assert element is not None
        element.set("xyz", " ".join(map(repr, origin)))


def _add_pads(plant: MultibodyPlant, ground: RigidBody, foot_offsets: Sequence[float]) -> None:
    """Pads around the places of the feet, on a plane that is as low as the lowest of them."""
    lowest = min(0.0, *foot_offsets)
    properties = ground_contact()
    for i, (leg, offset) in enumerate(zip(MODEL_GEOMETRY.legs, foot_offsets, strict=True)):
        height = offset - lowest
        if height == 0.0:
            continue
        x, y, _ = foot_to_centre(leg, _FEET_AT)
        pad = Box(_PAD_SIZE, _PAD_SIZE, height)
        X_GP = RigidTransform(np.array([-x, -y, 0.5 * height]))
        plant.RegisterCollisionGeometry(ground, X_GP, pad, f"pad_{i + 1}", properties)
        plant.RegisterVisualGeometry(ground, X_GP, pad, f"pad_{i + 1}_visual", _PAD_COLOUR)


def add_visualization(
    builder: DiagramBuilder,
    model: PlatformModel,
    positions: OutputPort,
    scene_graph: SceneGraph,
    meshcat: Meshcat | None,
    path: str = "platform",
) -> None:
    """Adds the links that the plant leaves out, and publishes the whole to Meshcat.

    Args:
        builder: builder of the diagram that holds `scene_graph`.
        model: the platform.
        positions: positions of the model's joints (or its whole state).
        scene_graph: scene that is drawn.
        meshcat: scene; None: not drawn.
        path: its path there.
    """
    links = add(builder, ParallelLinks(model, scene_graph, positions.size()), f"links_of_{path}")
    connect(builder, positions, links.get_input_port())
    connect(builder, links.get_output_port(), scene_graph.get_source_pose_port(links.source_id))
    publish(builder, scene_graph, meshcat, path)


def add_drawing(
    builder: DiagramBuilder,
    ground: tuple[float, float],
    meshcat: Meshcat | None,
    extension: OutputPort,
    base_pose: OutputPort,
    arm_position: OutputPort,
    *,
    path: str = "platform",
) -> None:
    """Adds a drawing of the full model for a plant that is simulated with fewer joints or none.

    Args:
        builder: builder of the diagram that holds the plant.
        ground: roll and pitch that the drawn slab keeps [rad].
        meshcat: scene in which to draw; None: poses are all that is asked for.
        extension: extensions (4) [m].
        base_pose: quaternion and position (7) of the platform.
        arm_position: turntable and arm angle (2) [rad].
        path: its path in the scene.
    """
    plant = MultibodyPlant(time_step=1.0)
    scene_graph = add(builder, SceneGraph(), f"drawing_of_{path}")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(plant, "full", ground=ground)
    pose = add(builder, PlatformPose(model), f"pose_of_{path}")
    connect(builder, extension, pose.GetInputPort("extension"))
    connect(builder, base_pose, pose.GetInputPort("base_pose"))
    connect(builder, arm_position, pose.GetInputPort("arm_position"))
    draw(builder, plant, pose.get_output_port(), scene_graph)
    add_visualization(builder, model, pose.get_output_port(), scene_graph, meshcat, path)


def photograph(
    views: Sequence[View],
    posture: ArrayLike,
    ground: tuple[float, float] = (0.0, 0.0),
    arm: tuple[float, float] = (0.0, 0.0),
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of the platform in a posture on plane ground.

    Args:
        views: from where; one picture each.
        posture: (3) roll, pitch, height [rad, rad, m].
        ground: roll and pitch [rad].
        arm: turntable and arm angle [rad].

    Raises:
        UnreachablePosture: the legs do not reach it.
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    add_renderer(scene_graph)
    model = add_platform(plant, "full", ground=ground)
    state = plant.get_state_output_port()
    links = add(builder, ParallelLinks(model, scene_graph, state.size()))
    connect(builder, state, links.get_input_port())
    connect(builder, links.get_output_port(), scene_graph.get_source_pose_port(links.source_id))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    extension = inverse_kinematics(MODEL_GEOMETRY, posture, ground)
    positions = model.positions_at(extension, standing_pose(posture, ground), arm)
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), positions)
    return take(scene_graph, context, views)
