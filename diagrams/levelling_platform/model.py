"""The levelling platform's bodies, joints and ground in a plant; drawings and pictures."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, CollisionFilterDeclaration, GeometrySet, Meshcat, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    Joint,
    PdControllerGains,
    RevoluteJoint,
    RigidBody,
)
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from parapod.diagrams.bodies import (
    Body,
    Stretch,
    fit_link,
    limit_joints,
    place_element,
    place_joints,
    set_attribute,
)
from parapod.diagrams.cad_models import OwnModel
from parapod.diagrams.drawing import draw_model, publish
from parapod.diagrams.multibody import add_adapted_model, add_ground, ground_contact
from parapod.diagrams.pads import PAD_DEPTH, add_moving_body
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.geometry import (
    ARM_BASE,
    LegGeometry,
    PlatformGeometry,
)
from parapod.systems.levelling_platform.leg import diagonal_angle, foot_to_centre, swing_angle
from parapod.systems.levelling_platform.model import (
    ParallelLinks,
    PlatformModel,
    PlatformPose,
    ground_pose,
    hip_pose,
    joint_origins,
)
from parapod.systems.levelling_platform.wheels import WheelGeometry
from parapod.urdf import configure_parser

# Dimensions to which the files are drawn: Tables 1 and 2, with rollers.
DRAWN = PlatformGeometry(foot_radius=0.025)
_FOLDER = "package://parapod/levelling_platform"
_DRAKE = "{http://drake.mit.edu}"
_LEG_LINKS = ("hip", "lower_link", "coupler", "roller", "cylinder", "rod")
_BASE = 0.88, 0.42, 0.20  # length, width, and depth below F of the drawn base, as it collides [m]
# Length and width of a wheel's drawn strut, and its upper end from F [m]; its lower end below the
# axle [m]; its place inside the wheel's, by the half track [-].
_STRUT, _BEYOND, _INSIDE = (0.05, 0.03, -0.13), 0.015, 0.75
# Mass of the drawn roller [kg], and end stop of the drawn rod [m].
_ROLLER, _STOP = 0.5, 0.38
# Damping of a rod by its stiffness [s], and stiffness of the reduced leg's crank by that of the
# rod of the drawn leg [m^2].
_ROD_DAMPING, _CRANK = 0.01, 5e-3
# Distance of an extension from those of a flat parallelogram, by the drawn short side [m]; least
# factor of a drawn part [-].
_FLAT, _LEAST = 1e-3, 0.1
BASE, WHEEL = f"{_FOLDER}/base.urdf", f"{_FOLDER}/wheel.urdf"
LEGS = {"full": f"{_FOLDER}/leg.urdf", "reduced": f"{_FOLDER}/leg_reduced.urdf"}
ARM_JOINTS = ("turntable", "arm")
# Length of the drawn arm [m]; damping of its drives by their stiffness [s].
_ARM_LENGTH, _ARM_DAMPING = 2.02, 0.05
# Gains of the wheels' position servos [N m/rad, N m s/rad] (assumption).
_WHEEL_GAINS = PdControllerGains(p=2000.0, d=50.0)

# Pads of uneven ground: side by the length of a leg's long side [-], and colour.
_PAD_SIZE = 0.3 / 0.44
_PAD_COLOUR = np.array([0.45, 0.42, 0.38, 1.0])


@dataclass(frozen=True)
class PlatformStructure:
    """A platform's parts beside the dimensions of its legs; the defaults are as drawn.

    Attributes:
        stretch: factors by which the base is larger than the drawn one.
        wheels: its wheels.
        arm_base: base of its arm, from F [m].
        arm_length: length of the drawn arm [m]; None: another arm, or none.
        arm_drives: stiffness [N m/rad] and largest effort [N m] of the drives of the arm's joints,
            one for all or one for each.
        stops: end stops of the actuators [m].
        rod_stiffness: axial stiffness of an actuator's rod [N/m].
        roll_damping: damping of a roller's bearing [N m s/rad]; None: the drawn one's, by mass and
            size.
        base: base of the user's own.
        arm: arm of the user's own, if it has one.
        bodies: masses of its links by their names; those of others are as drawn, by volume.
    """

    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
    wheels: WheelGeometry = WheelGeometry()  # noqa: RUF009
    arm_base: tuple[float, float, float] = ARM_BASE
    arm_length: float | None = 2.02
    arm_drives: tuple[tuple[float, float], ...] = ((2e4, math.inf),)
    stops: tuple[float, float] = (0.38, 0.46)
    rod_stiffness: float = 1e8
    roll_damping: float | None = None
    base: OwnModel = OwnModel("machine.base.urdf")  # noqa: RUF009
    arm: OwnModel | None = None
    bodies: tuple[tuple[str, Body], ...] = ()

    @property
    def links(self) -> dict[str, Body]:
        """Its links by their names."""
        return dict(self.bodies)

    @property
    def ground_size(self) -> int:
        """Factor by which the slab under it is larger than the drawn one [-]."""
        return math.ceil(max(1.0, *self.stretch[:2]) - 1e-9)

    @property
    def underside(self) -> NDArray[np.float64]:
        """Corners (4, 3) of the drawn base that are nearest to the ground, from F [m]."""
        along, across = (0.5 * side for side in _BASE[:2])
        corners = [(x, y, -_BASE[2]) for x in (-along, along) for y in (-across, across)]
        return np.array(self.stretch) * np.array(corners)

    @property
    def arm_alone(self) -> "PlatformStructure":
        """Its arm on a platform as drawn."""
        names = ("mount", "turntable", "link")
        bodies = tuple((name, body) for name, body in self.bodies if name in names)
        return PlatformStructure(
            arm_base=self.arm_base, arm_length=self.arm_length, arm=self.arm, bodies=bodies
        )


DRAWN_PARTS = PlatformStructure()


def add_platform(
    plant: MultibodyPlant,
    leg_model: str = "full",
    wheels: str = "braked",
    ground: tuple[float, float] = (0.0, 0.0),
    geometry: PlatformGeometry = DRAWN,
    foot_offsets: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    structure: PlatformStructure = DRAWN_PARTS,
    moving_ground: bool = False,
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
        structure: its other parts.
        moving_ground: true if each foot stands on a pad of its own, with a drive along the
            ground's normal; see `put_feet_on_pads`.

    Raises:
        ValueError: another `leg_model` than those.
        ScenarioError: a file of a part of one's own that does not do.
    """
    if leg_model not in LEGS:
        raise ValueError(f"leg_model: {leg_model!r} is none of {', '.join(LEGS)}")
    parser = Parser(plant)
    configure_parser(parser)
    base = add_base(parser, structure)
    legs = zip(geometry.legs, geometry.drawn_legs, strict=True)
    for i, (leg, drawn_leg) in enumerate(legs, start=1):
        mount: Any = plant.AddFrame(FixedOffsetFrame(f"hip_{i}", base, hip_pose(leg)))
        adapt = functools.partial(fit_leg, leg, drawn_leg, structure, leg_model)
        instance = add_adapted_model(parser, LEGS[leg_model], f"leg_{i}", adapt)
        plant.WeldFrames(mount, plant.GetFrameByName("hip", instance))
    axles = _add_wheels(parser, base, structure)
    add_arm(parser, base, structure)
    _fix_wheels(plant, axles, wheels)
    slab = add_ground(parser, structure.ground_size)
    X_WG = ground_pose(ground, foot_offsets)
    ground_mount: Any = plant.AddFrame(FixedOffsetFrame("ground_mount", plant.world_frame(), X_WG))
    plant.WeldFrames(ground_mount, plant.GetFrameByName("ground", slab))
    if any(foot_offsets) or moving_ground:
        body = plant.GetBodyByName("ground", slab)
        _add_pads(plant, body, geometry, foot_offsets, moving_ground)
    plant.Finalize()
    return PlatformModel(plant, ground_mount, geometry)


def add_base(parser: Parser, structure: PlatformStructure) -> Frame:
    """The drawn base; or an empty one that bears the user's own."""
    plant, own = parser.plant(), structure.base

    def fit(root: Element) -> None:
        fit_base(structure, root)
        if own.urdf:
            _empty(root, "base")

    instance = add_adapted_model(parser, BASE, "base", fit)
    base = plant.GetFrameByName("base", instance)
    if own.urdf:
        plant.WeldFrames(base, own.add(plant, "own_base"))
    return base


def fit_base(structure: PlatformStructure, root: Element) -> None:
    """Gives the model of the base the dimensions of a platform's."""
    fit_link(root, "base", structure.stretch, structure.links.get("base"))
    # Struts reach from the hull to the axles, wherever these are.
    wheels, usual = structure.wheels, WheelGeometry()
    top, width = structure.stretch[2] * _STRUT[2], wheels.radius / usual.radius
    end = min(wheels.height - _BEYOND * width, top - _BEYOND * width)
    struts = [v for v in root.findall("link/visual") if v.get("name", "").startswith("strut")]
    for strut in struts:
        origin, box = strut.find("origin"), strut.find("geometry/box")
        assert origin is not None
        assert box is not None
        x, y = (float(number) for number in origin.get("xyz", "").split()[:2])
        along, across = math.copysign(wheels.half_base, x), math.copysign(wheels.half_track, y)
        place_element(origin, "xyz", (along, _INSIDE * across, 0.5 * (top + end)))
        place_element(box, "size", (_STRUT[0] * width, _STRUT[1] * width, top - end))


def fit_wheel(structure: PlatformStructure, root: Element) -> None:
    """Gives the model of a wheel the dimensions of a platform's."""
    size = structure.wheels.radius / WheelGeometry().radius
    fit_link(root, "wheel", (size, size, size), structure.links.get("wheel"))


def _empty(root: Element, name: str) -> None:
    """Takes shapes and mass from a link."""
    link = root.find(f"link[@name='{name}']")
    assert link is not None
    for element in [*link.findall("visual"), *link.findall("collision")]:
        link.remove(element)
    inertial = link.find("inertial")
    assert inertial is not None
    link.remove(inertial)


def _add_wheels(
    parser: Parser, base: Frame, structure: PlatformStructure
) -> list[tuple[Frame, Frame]]:
    """The wheels, which are not fixed yet: frames of their axles and of themselves."""
    plant, geometry = parser.plant(), structure.wheels
    pairs = []
    for i, place in enumerate(geometry.axles, start=1):
        X_FA = RigidTransform(np.array(place))
        axle: Any = plant.AddFrame(FixedOffsetFrame(f"axle_{i}", base, X_FA))
        fit = functools.partial(fit_wheel, structure)
        instance = add_adapted_model(parser, WHEEL, f"wheel_{i}", fit)
        pairs.append((axle, plant.GetFrameByName("wheel", instance)))
    return pairs


def _fix_wheels(plant: MultibodyPlant, pairs: Sequence[tuple[Frame, Frame]], wheels: str) -> None:
    for i, (axle, wheel) in enumerate(pairs, start=1):
        if wheels == "braked":
            plant.WeldFrames(axle, wheel)
        else:
            turn = plant.AddJoint(RevoluteJoint(f"wheel_{i}", axle, wheel, np.array([0, 1.0, 0])))
            plant.AddJointActuator(f"wheel_{i}", turn).set_controller_gains(_WHEEL_GAINS)


def add_arm(
    parser: Parser, base: Frame, structure: PlatformStructure
) -> tuple[tuple[Joint, ...], Frame]:
    """Adds the drawn arm, the user's own or none; returns its joints in their order, and its tip.

    Args:
        parser: parser of the plant.
        base: frame of the platform's centre F.
        structure: the platform.

    Raises:
        ScenarioError: a file of an arm of one's own that does not do.
    """
    plant = parser.plant()
    X_FB = RigidTransform(np.array(structure.arm_base))
    mount: Any = plant.AddFrame(FixedOffsetFrame("arm_mount", base, X_FB))
    joints: tuple[Joint, ...] = ()
    tip: Any = mount
    if structure.arm is not None:
        frame, joints, tip = structure.arm.add_arm(plant, "arm")
        plant.WeldFrames(mount, frame)
    elif structure.arm_length is not None:
        joints, tip = _add_rod(parser, mount, structure, structure.arm_length)
    drives = structure.arm_drives
    _drive_joints(plant, joints, drives * (len(joints) if len(drives) == 1 else 1))
    return joints, tip


def _add_rod(
    parser: Parser, mount: Frame, structure: PlatformStructure, length: float
) -> tuple[tuple[Joint, ...], Frame]:
    """Adds the drawn arm; returns its joints and its tip."""
    plant = parser.plant()
    tall = structure.arm_base[2] / ARM_BASE[2]
    size = (tall, tall, tall) if tall > 0.0 else (1.0, 1.0, 1.0)
    long = length / _ARM_LENGTH
    stretches = {"mount": size, "turntable": size, "link": (size[0], size[1], long)}

    def fit(root: Element) -> None:
        for name, stretch in stretches.items():
            fit_link(root, name, stretch, structure.links.get(name))

    instance = add_adapted_model(parser, f"{_FOLDER}/arm.urdf", "arm", fit)
    plant.WeldFrames(mount, plant.GetFrameByName("mount", instance))
    X_LT = RigidTransform(np.array([0.0, 0.0, length]))
    link = plant.GetFrameByName("link", instance)
    tip: Any = plant.AddFrame(FixedOffsetFrame("arm_tip", link, X_LT))
    return tuple(plant.GetJointByName(name, instance) for name in ARM_JOINTS), tip


def _drive_joints(
    plant: MultibodyPlant, joints: Sequence[Joint], drives: Sequence[tuple[float, float]]
) -> None:
    """Gives joints drives of a stiffness and a largest effort each, in their order."""
    own = [
        actuator
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
        if actuator.joint() in joints
    ]
    # Commands come in the order of the actuators.
    if [actuator.joint() for actuator in own] != list(joints):
        for actuator in own:
            plant.RemoveJointActuator(actuator)
        own = [plant.AddJointActuator(joint.name(), joint) for joint in joints]
    for actuator, (stiffness, effort) in zip(own, drives, strict=True):
        actuator.set_effort_limit(effort)
        gains = PdControllerGains(p=stiffness, d=_ARM_DAMPING * stiffness)
        actuator.set_controller_gains(gains)


def fit_leg(
    leg: LegGeometry,
    drawn_leg: LegGeometry,
    structure: PlatformStructure,
    leg_model: str,
    root: Element,
) -> None:
    """Gives the model of a leg the dimensions of a platform's.

    Args:
        leg: the leg as built.
        drawn_leg: the leg without its deviations.
        structure: the platform.
        leg_model: "full" or "reduced".
        root: the file's `robot` element.
    """
    paper, links = DRAWN.legs[0], structure.links
    size = leg.foot_radius / paper.foot_radius
    roller = links.get("roller")
    fit_link(root, "roller", (size, size, size), roller)
    damping = structure.roll_damping
    if damping is None:
        damping = size**2 * (1.0 if roller is None else roller.mass / _ROLLER)
    set_attribute(root, "joint[@name='roll']/dynamics", "damping", damping)
    if leg_model == "full":
        _fit_full(drawn_leg, structure, root)
        stiffness = structure.rod_stiffness
    else:
        _fit_reduced(drawn_leg, structure, root)
        stiffness = _CRANK * structure.rod_stiffness * (drawn_leg.l_3 / paper.l_3) ** 2
    for name, value in (("p", stiffness), ("d", _ROD_DAMPING * stiffness)):
        set_attribute(root, f".//{_DRAKE}controller_gains", name, value)
    place_joints(root, joint_origins(leg, drawn_leg, leg_model))


def _fit_full(leg: LegGeometry, structure: PlatformStructure, root: Element) -> None:
    paper, links = DRAWN.legs[0], structure.links
    short, long = leg.l_3 / paper.l_3, leg.l_4 / paper.l_4
    rod = structure.stops[0] / _STOP
    column = (
        leg.l_6 / paper.l_6,
        (leg.l_6 * leg.e_a[1] + leg.l_7) / (paper.l_6 * paper.e_a[1] + paper.l_7),
    )
    stretches: dict[str, Stretch] = {
        "hip": (short, short, short),
        "lower_link": (long, short, short),
        "coupler": (column[0], short, max(column[1], _LEAST)),
        "cylinder": (rod, short, short),
        "rod": (rod, short, short),
    }
    for name, stretch in stretches.items():
        fit_link(root, name, stretch, links.get(name))
    if leg != paper:
        _draw_inclined(leg, short, root)
    p_MK = leg.l_3 * leg.e_a[0], 0.0, leg.l_3 * leg.e_a[1]
    ball = root.find(f"{_DRAKE}ball_constraint/{_DRAKE}ball_constraint_p_BQ")
    assert ball is not None
    place_element(ball, "value", p_MK)
    limits = abs(leg.l_4 - leg.l_3) + _FLAT * short, leg.l_4 + leg.l_3 - _FLAT * short
    limit_joints(root, {"extension": {"lower": limits[0], "upper": limits[1]}})


def _draw_inclined(leg: LegGeometry, size: float, root: Element) -> None:
    """Draws the hip's and the coupler's parts along the parallelogram's short side."""
    e, lean = np.array([leg.e_a[0], 0.0, leg.e_a[1]]), (0.0, 0.5 * math.pi - leg.alpha, 0.0)
    up = np.array([0.0, 0.0, 1.0])
    corner, foot = -leg.l_6 * e, leg.l_7 - leg.foot_radius
    if root.find("link/visual") is None:  # it is not drawn
        return
    places = {
        "hip": (0.0 * e, leg.l_3 * e, 0.4375 * leg.l_3 * e),
        "coupler": (
            0.5 * (leg.l_3 - leg.l_6) * e,
            corner,
            corner - 0.5 * foot * up,
            corner - (foot - 0.012 * size) * up,
        ),
    }
    for name, centres in places.items():
        visuals = root.findall(f"link[@name='{name}']/visual")
        for visual, centre in zip(visuals, centres, strict=True):
            origin = visual.find("origin")
            assert origin is not None
            place_element(origin, "xyz", centre)
    bar, _, column, _ = root.findall("link[@name='coupler']/visual")
    bar_origin = bar.find("origin")
    assert bar_origin is not None
    place_element(bar_origin, "rpy", lean)
    for visual, length in ((bar, leg.l_3 + leg.l_6), (column, foot)):
        cylinder = visual.find("geometry/cylinder")
        assert cylinder is not None
        cylinder.set("length", repr(length))


def _fit_reduced(leg: LegGeometry, structure: PlatformStructure, root: Element) -> None:
    """Gives the reduced leg the masses that move its centre as the full leg's moves."""
    own, usual = (
        _shared_masses(each, of) for each, of in ((leg, structure), (DRAWN.legs[0], DRAWN_PARTS))
    )
    for name in ("hip", "crank"):
        link = root.find(f"link[@name='{name}']/inertial")
        assert link is not None
        mass, place = link.find("mass"), link.find("origin")
        assert mass is not None
        assert place is not None
        drawn_mass = float(mass.get("value", "0"))
        ratio = leg.l_4 / DRAWN.l_4
        shift = np.array(own[name].centre) - np.array(usual[name].centre)
        drawn_centre = np.array(place.get("xyz", "").split(), dtype=float)
        body = Body(
            drawn_mass + (own[name].mass - usual[name].mass),
            tuple((drawn_centre + shift).tolist()) if shift.any() else None,
        )
        fit_link(root, name, (ratio, ratio, ratio), body)


@functools.lru_cache(maxsize=64)
def _shared_masses(leg: LegGeometry, structure: PlatformStructure) -> dict[str, Body]:
    """Bodies of hip and crank whose centre moves as that of the full leg: least squares.

    The crank's is at its end; so there are three numbers: its mass, and the hip's first moments.
    """
    plant = MultibodyPlant(time_step=0.0)
    parser = Parser(plant)
    configure_parser(parser)
    adapt = functools.partial(fit_leg, leg, leg, structure, "full")
    instance = add_adapted_model(parser, LEGS["full"], "leg", adapt)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("hip", instance))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    names = [name for name in _LEG_LINKS if name != "roller"]
    parts = [plant.GetBodyByName(name).index() for name in names]
    pivot = joint_origins(leg, leg, "reduced")["swing"]
    rows, moments, whole = [], [], 0.0
    for extension in np.linspace(leg.extension_min, leg.extension_max, 7).tolist():
        swing = swing_angle(leg, extension)
        positions = np.zeros(plant.num_positions())
        for name, value in (
            ("swing", swing),
            ("coupler_swing", -swing),
            ("cylinder_swing", diagonal_angle(leg, extension)),
            ("extension", extension),
        ):
            positions[plant.GetJointByName(name).position_start()] = value
        plant.SetPositions(context, positions)
        inertia = plant.CalcSpatialInertia(context, plant.world_frame(), parts)
        whole = inertia.get_mass()
        moment = whole * inertia.get_com()
        end = np.array(pivot) + leg.l_4 * np.array([math.cos(swing), 0.0, math.sin(swing)])
        rows += [[1.0, 0.0, end[0]], [0.0, 1.0, end[2]]]
        moments += [moment[0], moment[2]]
    (first, third, crank), *_ = np.linalg.lstsq(np.array(rows), np.array(moments))
    hip = whole - crank
    return {
        "hip": Body(float(hip), (float(first / hip), 0.0, float(third / hip))),
        "crank": Body(float(crank), (leg.l_4, 0.0, 0.0)),
    }


def _add_pads(
    plant: MultibodyPlant,
    ground: RigidBody,
    geometry: PlatformGeometry,
    foot_offsets: Sequence[float],
    is_moving: bool,
) -> None:
    """Pads around the places of the feet, on a plane that is as low as the lowest of them."""
    lowest = min(0.0, *foot_offsets)
    properties, body = ground_contact(), ground
    middle = 0.5 * (geometry.extension_min + geometry.extension_max)
    for i, (leg, offset) in enumerate(zip(geometry.drawn_legs, foot_offsets, strict=True), 1):
        name, top, bottom = f"pad_{i}", offset - lowest, 0.0
        if is_moving:
            body = add_moving_body(plant, ground.body_frame(), name)
            bottom = top - PAD_DEPTH
        if top == bottom:
            continue
        x, y, _ = foot_to_centre(leg, middle)
        side = _PAD_SIZE * leg.l_4
        pad = Box(side, side, top - bottom)
        X_GP = RigidTransform(np.array([-x, -y, 0.5 * (top + bottom)]))
        plant.RegisterCollisionGeometry(body, X_GP, pad, name, properties)
        plant.RegisterVisualGeometry(body, X_GP, pad, f"{name}_visual", _PAD_COLOUR)


def put_feet_on_pads(model: PlatformModel, scene_graph: SceneGraph) -> None:
    """Has the feet touch their pads alone, which move through the plane.

    Args:
        model: a platform on moving ground.
        scene_graph: the scene graph of its plant.
    """
    plant = model.plant
    rollers, plane = (
        GeometrySet([g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)])
        for bodies in (model.leg_bodies("roller"), [plant.GetBodyByName("ground")])
    )
    apart = CollisionFilterDeclaration().ExcludeBetween(rollers, plane)
    scene_graph.collision_filter_manager().Apply(apart)


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
    arm_position: OutputPort | None,
    *,
    geometry: PlatformGeometry,
    structure: PlatformStructure,
    path: str = "platform",
) -> tuple[PlatformModel, SceneGraph]:
    """Adds a drawing of the full model for a plant that is simulated with fewer joints or none.

    Args:
        builder: builder of the diagram that holds the plant.
        ground: roll and pitch that the drawn slab keeps [rad].
        meshcat: scene in which to draw; None: poses are all that is asked for.
        extension: extensions (4) [m].
        base_pose: quaternion and position (7) of the platform.
        arm_position: positions of the arm's joints (n) [rad or m]; None: there is no arm.
        geometry: dimensions of its legs.
        structure: its other parts.
        path: its path in the scene.

    Returns:
        The model that is drawn, and its scene graph.
    """
    models: list[PlatformModel] = []

    def add_model(plant: MultibodyPlant) -> System:
        model = add_platform(plant, "full", ground=ground, geometry=geometry, structure=structure)
        models.append(model)
        return PlatformPose(model)

    signals = {"extension": extension, "base_pose": base_pose}
    if arm_position is not None:
        signals["arm_position"] = arm_position
    scene_graph, positions = draw_model(builder, path, add_model, signals)
    add_visualization(builder, models[0], positions, scene_graph, meshcat, path)
    return models[0], scene_graph
