"""A machining centre's bodies, joints, clamps and closed loops in a MultibodyPlant; pictures.

Eight joints a limb, its loop closed by a ball constraint, feet welded to clamps. Drake fixes a
constraint's place when a plant is finalized; so a clamp is a body that is welded to a frame whose
pose is a parameter of the context (`FixedOffsetFrame`), which is put where the foot stands. That
costs no joint: bodies that float and are locked cost a third of the speed, and have no lock in a
default context. Locks and clamps are parameters, which no system can change while a simulation
steps: `Locking` changes them between two steps, in one place, and only what stands.

Half the step leaves a quarter of the clamps' yielding (29 um at 1 ms, standing). Masses and
stiffnesses are assumptions: a platform of 10 kg, 2.1 kg a leg, 10 N/um.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, QuaternionFloatingJoint

from parapod.diagrams.bodies import Body, fit_link, limit_joints, link_bodies, place_joints
from parapod.diagrams.multibody import add_adapted_model
from parapod.diagrams.pads import add_moving_body
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.model import CentreModel, transform_of
from parapod.systems.machining_centre.platform_mode import feet_of
from parapod.systems.machining_centre.statics import CentreMasses
from parapod.urdf import configure_parser

type _Fit = Callable[[Element], None]
# Axial stiffness of a leg with its screw and drive [N/m], and its damping [N s/m]: assumptions.
STIFFNESS = PdControllerGains(p=1e7, d=1e5)
_FOLDER = "package://parapod/machining_centre"
_DRAWN = CentreGeometry()  # dimensions to which the files are drawn
_SPINDLE = 0.07  # from P_O to the drawn quill [m]
_LIMB_LINKS = (
    *("mount", "hinge", "left_cylinder", "left_rod", "right_cylinder", "right_rod"),
    *("ankle_3", "ankle_2", "foot"),
)


def add_centre(
    plant: MultibodyPlant,
    geometry: CentreGeometry,
    stiffness: PdControllerGains = STIFFNESS,
    footholds: ArrayLike | None = None,
    bodies: Mapping[str, Body] | None = None,
    ground_gives: bool = False,
) -> CentreModel:
    """Adds a centre and its clamps to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        geometry: the centre.
        stiffness: axial stiffness and damping of a leg [N/m, N s/m].
        footholds: (n, 6) on which it stands in a default context; None for the paper's pattern.
        bodies: masses of its links by their names; None: those of the files, by volume.
        ground_gives: true if clamps move along the panel's normal, by drives of the instance
            `PADS`.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.SetAutoRenaming(True)
    fit_platform, fit_limb = _fits(geometry, bodies or {})
    body = add_adapted_model(parser, f"{_FOLDER}/platform.urdf", "platform", fit_platform)
    platform = plant.GetBodyByName("platform", body)
    world = plant.world_frame()
    plant.AddJoint(QuaternionFloatingJoint("platform", world, platform.body_frame()))
    clamps, held = [], []
    feet = feet_of(geometry, footholds)
    for i, (angle, middle) in enumerate(zip(geometry.angles, geometry.middles, strict=True)):
        limb = add_adapted_model(parser, f"{_FOLDER}/limb.urdf", f"limb_{i + 1}", fit_limb)
        X_PM = RigidTransform(RotationMatrix.MakeZRotation(angle), middle)
        plant.WeldFrames(platform.body_frame(), plant.GetFrameByName("mount", limb), X_PM)
        tips = [plant.GetBodyByName(f"{side}_rod", limb) for side in ("left", "right")]
        plant.AddBallConstraint(tips[0], np.zeros(3), tips[1], np.zeros(3))
        for side in ("left", "right"):
            plant.GetJointActuatorByName(side, limb).set_controller_gains(stiffness)
        (plate,) = parser.AddModels(url=f"{_FOLDER}/clamp.urdf")
        plant.RenameModelInstance(plate, f"clamp_{i + 1}")
        clamp = plant.GetBodyByName("clamp", plate)
        # A frame whose pose is a parameter: a clamp has no place of its own.
        held_frame: Any = plant.AddFrame(
            FixedOffsetFrame(f"clamp_{i + 1}", world, transform_of(feet[i]))
        )
        held.append((held_frame, clamp))
        foot = plant.GetBodyByName("foot", limb)
        clamps.append(plant.AddWeldConstraint(clamp, RigidTransform(), foot, RigidTransform()))
    for i, (frame, clamp) in enumerate(held, start=1):
        pad = add_moving_body(plant, frame, f"pad_{i}").body_frame() if ground_gives else frame
        plant.WeldFrames(pad, clamp.body_frame())
    plant.Finalize()
    return CentreModel(plant, geometry, tuple(clamps))


def link_stretches(geometry: CentreGeometry) -> dict[str, tuple[float, float, float]]:
    """Factors by which the drawn links are stretched, by their names."""

    def by(name: str) -> float:
        return float(getattr(geometry, name) / getattr(_DRAWN, name))

    wide, tool, foot = by("platform_radius"), by("tool_length"), by("foot_diameter")
    leg = by("stroke_min")  # its tubes are as long as there is room for
    hinge = wide * math.sin(geometry.half_angle) / math.sin(_DRAWN.half_angle)
    factors = {"platform": wide, "tool": tool, "mount": hinge, "hinge": hinge}
    factors |= dict.fromkeys((name for name in _LIMB_LINKS[2:6]), leg)
    factors |= dict.fromkeys(("ankle_2", "ankle_3"), foot)
    stretches = {name: (factor,) * 3 for name, factor in factors.items()}
    return stretches | {"foot": (foot, foot, by("foot_height"))}


@lru_cache(maxsize=16)
def masses_of(geometry: CentreGeometry, bodies: tuple[tuple[str, Body], ...]) -> CentreMasses:
    """Masses of a centre in closed form, as the plant that is built has them.

    Args:
        geometry: the centre.
        bodies: its links by their names.
    """
    files = zip(("platform", "limb"), _fits(geometry, dict(bodies)), strict=True)
    platform, limb = (
        sum(body.mass for body in link_bodies(f"{_FOLDER}/{name}.urdf", fit).values())
        for name, fit in files
    )
    return CentreMasses(platform, limb)


def _fits(geometry: CentreGeometry, bodies: Mapping[str, Body]) -> tuple[_Fit, _Fit]:
    """Changes of the drawn platform, and of a drawn limb, to the dimensions of a centre."""
    stretches = link_stretches(geometry)

    def fit(links: Sequence[str], root: Element) -> None:
        for link in links:
            fit_link(root, link, stretches[link], bodies.get(link))

    def fit_platform(root: Element) -> None:
        fit(("platform", "tool"), root)
        place_joints(root, {"tool": (0.0, 0.0, -_SPINDLE * stretches["tool"][0])})

    def fit_limb(root: Element) -> None:
        fit(_LIMB_LINKS, root)
        _fit_joints(geometry, root)

    return fit_platform, fit_limb


def _fit_joints(geometry: CentreGeometry, root: Element) -> None:
    """Gives a limb the pivots and strokes of a centre."""
    aside = geometry.platform_radius * math.sin(geometry.half_angle)
    stroke = {"lower": geometry.stroke_min, "upper": geometry.stroke_max}
    place_joints(root, {"left_swing": (0.0, -aside, 0.0), "right_swing": (0.0, aside, 0.0)})
    limit_joints(root, {"left_length": stroke, "right_length": stroke})
