"""Masses of a platform in closed form, from the files of its bodies: no plant is built for them.

Base or arm of one's own are read by Drake, once.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from parapod.diagrams.bodies import Body, link_bodies
from parapod.diagrams.cad_models import OwnModel
from parapod.diagrams.levelling_platform.model import (
    BASE,
    LEGS,
    WHEEL,
    PlatformStructure,
    add_arm,
    add_base,
    fit_base,
    fit_leg,
    fit_wheel,
)
from parapod.diagrams.serial_arms import serial_arm
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.levelling_platform.geometry import LegGeometry, PlatformGeometry
from parapod.systems.levelling_platform.leg import diagonal_angle, swing_angle
from parapod.systems.levelling_platform.model import hip_pose, joint_origins
from parapod.systems.levelling_platform.statics import KinematicPlatformParams
from parapod.urdf import configure_parser

_NOWHERE = {"l_x": 0.0, "l_y": 0.0, "l_z": 0.0}


class _Part(NamedTuple):
    """Mass [kg] and its first moment [kg m]."""

    mass: float
    moment: NDArray[np.float64]


@functools.lru_cache(maxsize=64)
def masses_of(geometry: PlatformGeometry, structure: PlatformStructure) -> KinematicPlatformParams:
    """Masses of a platform, as the plant that is built has them, its legs in their middle.

    Args:
        geometry: dimensions of its legs.
        structure: its other parts.

    Raises:
        ScenarioError: a file of a part of one's own that does not do.
    """
    standing, arm = _arm(structure.arm_alone)
    parts = [standing, _base(structure), *_wheels(structure), *_legs(geometry, structure)]
    mass = sum(part.mass for part in parts)
    moment = np.sum([part.moment for part in parts], axis=0)
    return KinematicPlatformParams(
        mass=mass, centre_of_mass=tuple((moment / mass).tolist()), arm=arm
    )


def _base(structure: PlatformStructure) -> _Part:
    """The base, about F."""
    if structure.base.urdf:
        return _own_base(structure.base)
    (body,) = link_bodies(BASE, functools.partial(fit_base, structure)).values()
    return _weigh(body)


@functools.lru_cache(maxsize=16)
def _own_base(own: OwnModel) -> _Part:
    plant, parser, _scene_graph = _plant()
    frame = add_base(parser, PlatformStructure(base=own))
    plant.WeldFrames(plant.world_frame(), frame)
    plant.Finalize()
    bodies = [BodyIndex(i) for i in range(1, plant.num_bodies())]
    inertia = plant.CalcSpatialInertia(plant.CreateDefaultContext(), frame, bodies)
    return _Part(inertia.get_mass(), inertia.get_mass() * inertia.get_com())


def _wheels(structure: PlatformStructure) -> Iterator[_Part]:
    """The wheels, about F."""
    (body,) = link_bodies(WHEEL, functools.partial(fit_wheel, structure)).values()
    for axle in structure.wheels.axles:
        yield _weigh(body, RigidTransform(np.array(axle)))


def _legs(geometry: PlatformGeometry, structure: PlatformStructure) -> Iterator[_Part]:
    """Bodies of the legs in the middle of their strokes, about F."""
    middle = 0.5 * (geometry.extension_min + geometry.extension_max)
    weighed: dict[tuple[LegGeometry, ...], _Part] = {}
    for leg, drawn_leg in zip(geometry.legs, geometry.drawn_legs, strict=True):
        alike = tuple(
            replace(each, l_x=0.0, l_y=0.0, l_z=0.0, beta=0.0) for each in (leg, drawn_leg)
        )
        if alike not in weighed:
            bodies = link_bodies(
                LEGS["full"], functools.partial(fit_leg, leg, drawn_leg, structure, "full")
            )
            poses = _link_poses(leg, drawn_leg, middle).items()
            links = [_weigh(bodies[name], X_DL) for name, X_DL in poses]
            moment = np.sum([link.moment for link in links], axis=0)
            weighed[alike] = _Part(sum(link.mass for link in links), moment)
        mass, moment = weighed[alike]
        X_FD = hip_pose(leg)
        yield _Part(mass, mass * X_FD.translation() + X_FD.rotation().matrix() @ moment)


def _link_poses(
    leg: LegGeometry, drawn_leg: LegGeometry, extension: float
) -> dict[str, RigidTransform]:
    """Poses of a leg's links in its frame D, by their names."""
    swing, diagonal = swing_angle(leg, extension), diagonal_angle(leg, extension)
    origins = {n: np.array(p) for n, p in joint_origins(leg, drawn_leg, "full").items()}
    end = leg.l_4 * np.array([math.cos(swing), 0.0, math.sin(swing)])
    cylinder = RigidTransform(RotationMatrix.MakeYRotation(-diagonal), origins["cylinder_swing"])
    return {
        "hip": RigidTransform(),
        "lower_link": RigidTransform(RotationMatrix.MakeYRotation(-swing), np.zeros(3)),
        "coupler": RigidTransform(end),
        "roller": RigidTransform(end + origins["roll"]),
        "cylinder": cylinder,
        "rod": cylinder @ RigidTransform(np.array([extension, 0.0, 0.0])),
    }


def _weigh(body: Body, X_FL: RigidTransform | None = None) -> _Part:
    """Mass and moment of a link about F, whose frame has a pose."""
    centre = np.array(body.centre)
    if X_FL is not None:
        centre = X_FL.translation() + X_FL.rotation().matrix() @ centre
    return _Part(body.mass, body.mass * centre)


@functools.lru_cache(maxsize=64)
def _arm(structure: PlatformStructure) -> tuple[_Part, SerialArm]:
    """Parts of the arm that do not move, about F, and the arm."""
    plant, parser, _scene_graph = _plant()
    world = plant.world_frame()
    joints, tip = add_arm(parser, world, structure)
    plant.Finalize()
    moved = plant.GetBodiesKinematicallyAffectedBy([joint.index() for joint in joints])
    bodies = [BodyIndex(i) for i in range(1, plant.num_bodies())]
    others = [body for body in bodies if body not in moved]
    standing = plant.CalcSpatialInertia(plant.CreateDefaultContext(), world, others)
    part = _Part(standing.get_mass(), standing.get_mass() * standing.get_com())
    return part, serial_arm(plant, world, joints, tip)


def _plant() -> tuple[MultibodyPlant, Parser, SceneGraph]:
    """A plant that reads shapes too, so that meshes that are missing are told."""
    plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    parser = Parser(plant)
    configure_parser(parser)
    return plant, parser, scene_graph
