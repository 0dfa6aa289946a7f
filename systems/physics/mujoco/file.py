"""MJCF of a described plant: its translation, as stiff in a file as in a program."""

from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree.ElementTree import Comment, Element, fromstring, indent, tostring

import numpy as np
from pydrake.multibody.tree import QuaternionFloatingJoint

from parapod.systems.core.errors import WiringError
from parapod.systems.core.extras import need
from parapod.systems.physics.description import Description
from parapod.systems.physics.loops import Distance
from parapod.systems.physics.mujoco.model import StateMaps
from parapod.systems.physics.mujoco.translation import WEIGHT, Translation, body_name, joint_name

# Impedances that MuJoCo takes, and the group of geometry that it does not draw.
_IMPEDANCES, _HIDDEN = (1e-4, 0.9999), 3
# Attributes of the file that have other names in a specification.
_ATTRIBUTES = {
    "solreflimit": "solref_limit",
    "solimplimit": "solimp_limit",
    "actuatorfrcrange": "actfrcrange",
}
_INERTIAL = {"pos": "ipos", "quat": "iquat", "mass": "mass", "diaginertia": "inertia"}
# Digits of the place of what floats, behind which there is but rounding.
_DIGITS = 15
# Error of a number that MuJoCo has written with six digits [-].
_ROUNDED = 1e-5


def mjcf(tree: Description, mesh: Callable[[Path], str], notes: Iterable[str]) -> str:
    """A machine as MJCF, with the key frame `standing`.

    Args:
        tree: the machine, described.
        mesh: name of a mesh in the file, by its path.
        notes: lines of the comment at its beginning.

    Raises:
        MissingExtra: MuJoCo is not installed.
        WiringError: a part of the machine that cannot be translated.
    """
    mujoco, plant, constraints = need("mujoco"), tree.plant, tree.constraints
    translation = Translation(mujoco, plant, tree.context)
    translation.add_bodies()
    translation.add_balls(constraints.balls)
    translation.add_welds(constraints.welds)
    translation.add_couplings(constraints.couplings)
    translation.add_rods(constraints.of(Distance))
    translation.add_contacts(tree.scene_graph)
    translation.add_visuals(tree.scene_graph)
    spec: Any = translation.spec
    spec.modelname = tree.name
    _place(spec, tree)
    _add_drives(mujoco, spec, tree)
    for body in spec.bodies:
        body.mocap = False
    for geom in spec.geoms:
        geom.group = geom.group or _HIDDEN
    try:
        model = spec.compile()
    except ValueError as error:
        raise WiringError(f"MuJoCo refuses the model: {' '.join(str(error).split())}") from None
    translation.measure_rods(constraints.of(Distance), model)
    _weigh(mujoco, spec, model)
    _stand(mujoco, spec, model, tree)
    spec.compile()
    root = fromstring(spec.to_xml())
    _refine(root, spec)
    names = {body_name(b): n for b, n in zip(tree.bodies, tree.links, strict=True)}
    names |= {joint_name(j): n for j, n in zip(tree.joints, tree.joint_names, strict=True)}
    for element in root.iter():
        if element.get("limited") == "false":
            del element.attrib["solreflimit"], element.attrib["solimplimit"]
        for key, value in element.attrib.items():
            element.set(key, mesh(Path(value)) if key == "file" else names.get(value, value))
    for i, note in enumerate(notes):
        root.insert(i, Comment(f" {note.replace('--', '- -')} "))
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _place(spec: Any, tree: Description) -> None:
    """Puts what floats where it stands, as a file is mostly loaded without its key frame."""
    for joint in tree.joints:
        if isinstance(joint, QuaternionFloatingJoint):
            pose = tree.plant.EvalBodyPoseInWorld(tree.context, joint.child_body())
            body = spec.body(body_name(joint.child_body()))
            quaternion = pose.rotation().ToQuaternion().wxyz()
            body.pos, body.quat = (
                each.round(_DIGITS) + 0.0 for each in (pose.translation(), quaternion)
            )


def _add_drives(mujoco: Any, spec: Any, tree: Description) -> None:
    """Adds actuators with their controls and limits, which the translation has not, and rotors."""
    for servo in tree.drives.servos:
        biases = mujoco.mjtBias
        added = spec.add_actuator(
            name=servo.name,
            target=joint_name(tree.plant.get_joint(servo.joint)),
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=biases.mjBIAS_AFFINE if any(servo.bias) else biases.mjBIAS_NONE,
        )
        added.gainprm[0], added.biasprm[:3], added.gear[0] = servo.gain, servo.bias, servo.gear
        if servo.forces is not None:
            added.forcelimited, added.forcerange = True, servo.forces
        if servo.controls is not None:
            added.ctrllimited, added.ctrlrange = True, servo.controls
    joints = {joint.index(): spec.joint(joint_name(joint)) for joint in tree.joints}
    for index, limits in tree.drives.forces.items():
        joints[index].actfrclimited, joints[index].actfrcrange = True, limits
    for index, armature in tree.drives.armatures.items():
        joints[index].armature = armature
    for index, (stiffness, rest) in tree.drives.springs.items():
        joints[index].stiffness[0], joints[index].springref = stiffness, rest


def _weigh(mujoco: ModuleType, spec: Any, model: Any) -> None:
    """Keeps the stiffness of constraints, for weights that MuJoCo computes when it loads the file.

    The translation counts on `WEIGHT` for all.
    """
    bodies, dofs = model.body_invweight0[:, 0], model.dof_invweight0

    def fit(reference: Any, impedance: Any, weight: float) -> None:
        inertia = (1.0 - impedance[0]) / impedance[0] * 2.0 * WEIGHT
        other = np.clip(weight / (weight + inertia), *_IMPEDANCES)
        reference *= (1.0 - other) * weight / ((1.0 - impedance[0]) * 2.0 * WEIGHT)
        impedance[:2] = other

    for pair in spec.pairs:
        touching = [model.geom(name).bodyid[0] for name in (pair.geomname1, pair.geomname2)]
        before = pair.solimp.copy()
        fit(pair.solref, pair.solimp, bodies[touching].sum())
        fit(pair.solreffriction, before, bodies[touching].sum())
    for equality in spec.equalities:
        ends = equality.name1, equality.name2
        if equality.type == mujoco.mjtEq.mjEQ_JOINT:
            weight = sum(dofs[model.joint(name).dofadr[0]] for name in ends)
        elif equality.type == mujoco.mjtEq.mjEQ_TENDON:
            weight = model.tendon_invweight0[model.tendon(ends[0]).id]
        else:
            weight = sum(bodies[model.site(name).bodyid[0]] for name in ends)
        fit(equality.solref, equality.solimp, weight)
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            weight = dofs[model.joint(joint.name).dofadr[0]]
            fit(joint.solref_limit, joint.solimp_limit, weight)


def _stand(mujoco: ModuleType, spec: Any, model: Any, tree: Description) -> None:
    """Adds the key frame in which the machine stands, its drives where they are."""
    q, v = (of(tree.context) for of in (tree.plant.GetPositions, tree.plant.GetVelocities))
    qpos, qvel = StateMaps(model, tree.plant).to_mujoco(q, v)
    control = [
        servo.holding(float(qpos[model.joint(actuator.target).qposadr[0]]))
        for servo, actuator in zip(tree.drives.servos, spec.actuators, strict=True)
    ]
    spec.add_key(name="standing", qpos=qpos, qvel=qvel, ctrl=control)


def _refine(root: Element, spec: Any) -> None:
    """Gives numbers all their digits, of which MuJoCo writes six."""
    parts: list[tuple[Element, Any]] = [(e, spec.option) for e in root.findall("option")]
    for tag in ("body", "joint", "geom", "site", "mesh", "key"):
        named = (element for element in root.iter(tag) if element.get("name"))
        parts += [(element, getattr(spec, tag)(element.get("name"))) for element in named]
    for path, every in (
        ("contact/pair", spec.pairs),
        ("equality/*", spec.equalities),
        ("actuator/*", spec.actuators),
    ):
        parts += zip(root.findall(path), every, strict=True)
    for element, part in parts:
        _refine_element(element, part, _ATTRIBUTES)
        if (inertial := element.find("inertial")) is not None:
            _refine_element(inertial, part, _INERTIAL)


def _refine_element(element: Element, part: Any, names: dict[str, str]) -> None:
    for key, text in element.attrib.items():
        exact = getattr(part, names.get(key, key), None)
        try:
            rounded = np.array(text.split(), dtype=float)
            numbers = np.array(exact, dtype=float).ravel()[: len(rounded)]
        except (TypeError, ValueError):
            continue
        is_same = len(numbers) == len(rounded) and np.allclose(
            numbers, rounded, _ROUNDED, _ROUNDED
        )
        if is_same and (numbers != rounded).any():
            element.set(key, " ".join(repr(number) for number in numbers.tolist()))
