"""A mechanism in another format, compared with what it was."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.model_file import TITLES, notes, write_model
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.core.scenario_file import dump_scenario
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.model import LoopsFile
from parapod.systems.mechanism.parts import Model
from parapod.systems.physics.description import KINDS, Description

type Floats = NDArray[np.float64]

# Poses that are compared, and how far they are from home [rad, lengths of the mechanism].
_POSES, _WAY = 5, 0.05
# Differences that are rounding: of places by the mechanism's size, and of masses [-].
_SAME, _SAME_MASS = 1e-6, 1e-4


@dataclass(frozen=True)
class Conversion:
    """A model that has been written.

    Attributes:
        files: all files; the model is the last one.
        notes: parts that the format does not hold, or holds in another way.
        freedoms: freedoms of the mechanism.
        loops: number of its loops.
        largest_gap: largest distance of a link from where it was [m].
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...]
    freedoms: int
    loops: int
    largest_gap: float


def files_of(out: Path, form: str) -> tuple[Path, ...]:
    """Files that are written: the YAML with loops and motors, where there is one, and the model.

    Args:
        out: the model's file.
        form: "urdf", "sdf" or "mjcf".
    """
    return (out,) if form == "mjcf" else (out.with_name(f"{out.name}.yaml"), out)


def convert(read: Callable[[Any], Model], name: str, form: str, out: Path) -> Conversion:
    """Writes a mechanism in a format, reads it back and compares.

    Args:
        read: adds the model to a plant that is not finalized, plain as `add_model` makes it.
        name: name of the model in the file.
        form: "urdf", "sdf" or "mjcf".
        out: the file.

    Raises:
        OutputError: a file that cannot be written.
        ParapodError: a model that cannot be read, or is not the same when it is read back.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    model = read(plant)
    plant.Finalize()
    mechanism = Mechanism.of_model(model)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, mechanism.home)
    has_one_name_space = form == "sdf"
    tree = Description(
        plant, context, scene_graph, name, model.loops, has_one_name_space, model.drives
    )
    more = [*mechanism.notes, *notes(tree, form), *_floating(tree, form)]
    files = write_model(out, form, tree)
    path, *others = files_of(out, form)
    if others:
        with atomic_output(path) as temporary:
            temporary.write_text(_loops_beside(mechanism, tree), encoding="utf-8")
        files.insert(0, path)
        more = [note for note in more if not note.startswith("not in") or "weld of" not in note]
    gap = _compare(mechanism, tree, out)
    of = mechanism.mobility
    return Conversion(tuple(files), tuple(more), of.freedoms, len(mechanism.loops), gap)


def _floating(tree: Description, form: str) -> list[str]:
    """Lines about links that float, where a format cannot say so or not where."""
    on_world = {
        tree.link(joint.child_body()): joint
        for joint in tree.joints
        if joint.parent_body().index() == tree.plant.world_body().index()
    }
    names = [name for name, joint in on_world.items() if KINDS[type(joint)] == "floating"]
    if form == "mjcf" or not names:
        return []
    title, links = TITLES[form], ", ".join(names)
    lines = [f"the pose of {links} is not in URDF: it floats"] if form == "urdf" else []
    if len(names) == len(on_world):
        lines.append(f"not in {title}: that {links} is free; --free reads it back so")
    return lines


def _loops_beside(mechanism: Mechanism, tree: Description) -> str:
    """Text of the YAML with the motors, and with the loops that the format does not have."""
    welds = [closure for closure in tree.closures if closure.kind == "weld"]
    motors = [tree.joint_name(joint) for joint in mechanism.motors]
    loops = LoopsFile([list(weld.names) for weld in welds], ["6d"] * len(welds), [], motors)
    return dump_scenario(loops)


def _compare(mechanism: Mechanism, tree: Description, out: Path) -> float:
    """Largest distance of a link from where it was [m].

    Raises:
        ParapodError: a mechanism that is another one.
    """
    is_free = any(joint.type_name() == "quaternion_floating" for joint in mechanism.joints)
    other = Mechanism.load(out, is_free=is_free)

    def refuse(what: str, here: object, there: object) -> None:
        if here != there:
            raise ParapodError(
                f"{quoted_path(out)} has another {what} when it is read back: {there} in place "
                f"of {here}"
            )

    refuse("number of freedoms", mechanism.mobility.freedoms, other.mobility.freedoms)
    motors = sorted(tree.joint_name(joint) for joint in mechanism.motors)
    refuse("set of motors", motors, sorted(other.name(joint) for joint in other.motors))
    masses = [m.plant.CalcTotalMass(m.plant.CreateDefaultContext()) for m in (mechanism, other)]
    if abs(masses[0] - masses[1]) > _SAME_MASS * masses[0]:
        refuse("mass", f"{masses[0]:.6g} kg", f"{masses[1]:.6g} kg")
    return max(_distance(mechanism, other, tree, q) for q in _poses(mechanism))


def _poses(mechanism: Mechanism) -> list[Floats]:
    """Home, and closed poses about it."""
    random, poses = np.random.default_rng(0), [mechanism.home]
    scale = np.where(mechanism.is_length, mechanism.size, 1.0)
    for _ in range(_POSES):
        way = _WAY * scale * random.uniform(-1.0, 1.0, len(scale))
        q = mechanism.closed(mechanism.moved(mechanism.home, way))
        if q is not None:
            poses.append(q)
    return poses


def _distance(mechanism: Mechanism, other: Mechanism, tree: Description, q: Floats) -> float:
    """Largest distance of a link of two mechanisms with the same positions of joints [m].

    Raises:
        ParapodError: links that are elsewhere, or loops that are open.
    """
    there = other.home.copy()
    for name, joint in zip(tree.joint_names, tree.joints, strict=True):
        if count := joint.num_positions():
            target = other.joint(name) if joint.num_positions() == 1 else None
            if target is None:
                first = other.plant.GetBodyByName(
                    tree.link(joint.child_body())
                ).floating_positions_start()
            else:
                first = target.position_start()
            start = joint.position_start()
            there[first : first + count] = q[start : start + count]
    open_gaps = np.abs(other.residual(there)).max(initial=0.0)
    most = float(open_gaps)
    contexts = [m.plant.CreateDefaultContext() for m in (mechanism, other)]
    for m, positions, context in zip((mechanism, other), (q, there), contexts, strict=True):
        m.plant.SetPositions(context, positions)
    for body, name in zip(tree.bodies, tree.links, strict=True):
        if name == "world" or not other.plant.HasBodyNamed(name):
            continue
        ends = [
            m.plant.EvalBodyPoseInWorld(context, part).translation()
            for m, context, part in zip(
                (mechanism, other), contexts, (body, other.plant.GetBodyByName(name)), strict=True
            )
        ]
        most = max(most, float(np.linalg.norm(ends[0] - ends[1])))
    if most > _SAME * mechanism.size:
        raise ParapodError(f"a link is {1e3 * most:.4g} mm elsewhere when the file is read back")
    return most
