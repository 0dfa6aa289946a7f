"""Serial arm of a model: joints and links of a `MultibodyPlant` as `SerialArm` has them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, Joint, RevoluteJoint
from pydrake.systems.framework import Context

from parapod.systems.arm.serial_arm import ArmJoint, ArmLink, SerialArm
from parapod.systems.core.triples import Vector3

# Components of directions and places that are taken for zero [- or m].
_ROUNDED = 1e-15


def serial_arm(
    plant: MultibodyPlant, base: Frame, joints: Sequence[Joint], tip: Frame
) -> SerialArm:
    """The arm of these joints, each of which moves those after it; every other joint is fixed.

    Args:
        plant: finalized, with every joint at zero in its default context.
        base: frame of the platform's centre F.
        joints: joints that turn about or slide along one axis, from the base to the tip.
        tip: frame of the tip.
    """
    context = plant.CreateDefaultContext()
    moved = [
        set(map(int, plant.GetBodiesKinematicallyAffectedBy([joint.index()]))) for joint in joints
    ]
    arm_joints, links, before = [], [], base
    for i, joint in enumerate(joints):
        X_BJ = plant.CalcRelativeTransform(context, before, joint.frame_on_parent())
        is_revolute = isinstance(joint, RevoluteJoint)
        moving: Any = joint
        axis = moving.revolute_axis() if is_revolute else moving.translation_axis()
        arm_joints.append(
            ArmJoint(
                name=joint.name(),
                place=_vector(X_BJ.translation()),
                rotation=_rows(X_BJ.rotation()),
                axis=_vector(axis),
                kind="revolute" if is_revolute else "prismatic",
                lower=float(joint.position_lower_limits()[0]),
                upper=float(joint.position_upper_limits()[0]),
            )
        )
        before = joint.frame_on_child()
        beyond = moved[i + 1] if i + 1 < len(joints) else set()
        links.append(_link(plant, context, before, sorted(moved[i] - beyond)))
    X_BT = plant.CalcRelativeTransform(context, before, tip)
    tip_place, tip_rotation = _vector(X_BT.translation()), _rows(X_BT.rotation())
    return SerialArm(tuple(arm_joints), tuple(links), tip_place, tip_rotation)


def _link(plant: MultibodyPlant, context: Context, frame: Frame, bodies: Sequence[int]) -> ArmLink:
    """Bodies that move together, in a frame that moves with them."""
    whole = plant.CalcSpatialInertia(context, frame, [BodyIndex(i) for i in bodies])
    mass, centre = whole.get_mass(), whole.get_com()
    if not mass > 0.0:
        return ArmLink()
    inertia = whole.Shift(centre).CalcRotationalInertia()
    moments = (*inertia.get_moments().tolist(), *inertia.get_products().tolist())
    return ArmLink(mass, _vector(centre), moments)


def _vector(values: NDArray[np.float64]) -> Vector3:
    # Without what rounding leaves of zero in turns by a right angle.
    x, y, z = np.where(np.abs(values) < _ROUNDED, 0.0, values).tolist()
    return x, y, z


def _rows(rotation: RotationMatrix) -> tuple[Vector3, Vector3, Vector3]:
    first, second, third = map(_vector, rotation.matrix())
    return first, second, third
