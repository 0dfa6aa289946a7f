"""Builds the levelling platform's bodies, joints and ground into a MultibodyPlant."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.geometry import AddContactMaterial, Box, ProximityProperties
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, RevoluteJoint, RigidBody

from parapod.diagrams.ground import add_ground
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.levelling_platform.geometry import PlatformGeometry, drawn_deviations
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import (
    MODEL_GEOMETRY,
    WHEEL_COUNT,
    PlatformModel,
)
from parapod.urdf import configure_parser

_FOLDER = "package://parapod/levelling_platform"
# Of the wheels' position servos [N m/rad, N m s/rad] (assumption).
_WHEEL_GAINS = PdControllerGains(p=2000.0, d=50.0)


# Pads of uneven ground: side [m], where the feet stand in the middle of the stroke, colour.
_PAD_SIZE, _FEET_AT = 0.3, 0.405
_PAD_COLOUR = np.array([0.45, 0.42, 0.38, 1.0])


def geometry_as_built(scenario: LevellingScenario) -> PlatformGeometry:
    """What the scenario's machine measures: the drawing, and errors drawn from the seed."""
    length, angle = scenario.plant.length_error_mm, scenario.plant.angle_error_deg
    if not (length or angle):
        return MODEL_GEOMETRY
    # A stream of its own: errors do not change what else is drawn from the seed.
    random = np.random.default_rng((scenario.seed, 1))
    deviations = drawn_deviations(random, 1e-3 * length, math.radians(angle))
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
        ground: roll and pitch of the ground [rad] until `PlatformModel.stand` inclines it.
        geometry: dimensions that `PlatformModel.stand` gives the legs.
        foot_offsets: heights under the feet above the ground's plane [m]; if any is not zero,
            each foot gets a pad to stand on.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/platform_{leg_model}.dmd.yaml")
    for i in range(1, WHEEL_COUNT + 1):
        axle = plant.GetFrameByName(f"axle_{i}")
        wheel = plant.GetFrameByName("wheel", plant.GetModelInstanceByName(f"wheel_{i}"))
        if wheels == "braked":
            plant.WeldFrames(axle, wheel)
        else:
            turn = plant.AddJoint(RevoluteJoint(f"wheel_{i}", axle, wheel, np.array([0, 1.0, 0])))
            plant.AddJointActuator(f"wheel_{i}", turn).set_controller_gains(_WHEEL_GAINS)
    slab = add_ground(parser)
    X_WG = RigidTransform(RollPitchYaw(ground[0], ground[1], 0.0), np.zeros(3))
    mount: Any = plant.AddFrame(FixedOffsetFrame("ground_mount", plant.world_frame(), X_WG))
    plant.WeldFrames(mount, plant.GetFrameByName("ground", slab))
    if any(foot_offsets):
        _add_pads(plant, plant.GetBodyByName("ground", slab), foot_offsets)
    plant.Finalize()
    return PlatformModel(plant, mount, geometry)


def _add_pads(plant: MultibodyPlant, ground: RigidBody, foot_offsets: Sequence[float]) -> None:
    """Pads around the places of the feet, on a plane that is as low as the lowest of them."""
    lowest = min(0.0, *foot_offsets)
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=1.0,
        point_stiffness=5e7,
        friction=CoulombFriction(0.8, 0.8),
        properties=properties,
    )
    for i, (leg, offset) in enumerate(zip(MODEL_GEOMETRY.legs, foot_offsets, strict=True)):
        height = offset - lowest
        if height == 0.0:
            continue
        x, y, _ = foot_to_centre(leg, _FEET_AT)
        pad = Box(_PAD_SIZE, _PAD_SIZE, height)
        X_GP = RigidTransform(np.array([-x, -y, 0.5 * height]))
        plant.RegisterCollisionGeometry(ground, X_GP, pad, f"pad_{i + 1}", properties)
        plant.RegisterVisualGeometry(ground, X_GP, pad, f"pad_{i + 1}_visual", _PAD_COLOUR)
