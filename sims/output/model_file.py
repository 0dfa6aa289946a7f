"""Files that describe a machine to other programs: URDF, SDFormat and MJCF, and their meshes."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pydrake.geometry import Ellipsoid, HalfSpace, Role

from parapod.sims.output.atomic import atomic_output, check_folder, check_writable
from parapod.systems.core.errors import OutputError, ParapodError, WiringError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.physics.description import Description
from parapod.systems.physics.model_files import sdf, urdf
from parapod.systems.physics.mujoco.file import mjcf

FORMATS = {"urdf": urdf, "sdf": sdf, "mjcf": mjcf}
_SUFFIXES = {".urdf": "urdf", ".sdf": "sdf", ".mjcf": "mjcf", ".xml": "mjcf"}
# Names of files in a mesh.
_REFERENCE = re.compile(r"[^\s\"']+\.(?:mtl|png|jpe?g|bin|ktx2)")
# Parts of drives that no format has.
_NO_DRIVES = "models of motors, sensors and control"
TITLES = {"urdf": "URDF", "sdf": "SDFormat", "mjcf": "MJCF"}


def format_of(path: Path, required: str | None) -> str:
    """Format of a file.

    Args:
        path: the file; its suffix says the format.
        required: format that it must be; None for any.

    Raises:
        OutputError: a suffix of another format, or of none.
    """
    form = _SUFFIXES.get(path.suffix.lower())
    if form is None or required not in (None, form):
        fit = [suffix for suffix, each in _SUFFIXES.items() if required in (None, each)]
        what = "a machine's suffix" if required is None else f"the suffix of {TITLES[required]}"
        words = f"cannot write {quoted_path(path)}: {what} must be one of {', '.join(fit)}"
        raise OutputError(words, path)
    return form


def write_model(path: Path, form: str, tree: Description) -> list[Path]:
    """Writes a machine, and its meshes into a folder beside it.

    Args:
        path: the file.
        form: a key of `FORMATS`.
        tree: the machine, described.

    Returns:
        All files; the machine is in the last one.

    Raises:
        OutputError: a file that cannot be written.
        ParapodError: a machine that the format cannot hold, or MuJoCo is missing for MJCF.
    """
    folder, meshes = path.with_name(f"{path.stem}_meshes"), dict[Path, str]()

    def mesh(source: Path) -> str:
        if source not in meshes:
            clash = any(Path(name).name == source.name for name in meshes.values())
            name = f"{len(meshes)}_{source.name}" if clash else source.name
            meshes[source] = f"{folder.name}/{name}"
        return meshes[source]

    try:
        text = FORMATS[form](tree, mesh, notes(tree, form))
    except WiringError as error:
        raise ParapodError(f"cannot write {TITLES[form]}: {error}") from None
    check_writable(path)
    files = {
        path.with_name(folder.name) / Path(name).name: source for source, name in meshes.items()
    }
    for target, source in list(files.items()):
        files |= {target.with_name(other.name): other for other in _companions(source)}
    if files:
        check_folder(folder)
        folder.mkdir(exist_ok=True)
    for target, source in files.items():
        with atomic_output(target) as temporary:
            temporary.write_bytes(source.read_bytes())
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [*files, path]


def _companions(source: Path) -> Iterator[Path]:
    """Files that a mesh refers to: materials and pictures in the same folder."""
    if source.suffix.lower() not in (".obj", ".mtl", ".gltf"):
        return
    for name in set(_REFERENCE.findall(source.read_text("utf-8"))):
        other = source.with_name(name)
        if other.is_file() and other != source:
            yield other
            yield from _companions(other)


def notes(tree: Description, form: str) -> list[str]:
    """Lines about parts that a file does not hold, or holds in another way.

    Args:
        tree: the machine, described.
        form: a key of `FORMATS`.
    """
    title, lines = TITLES[form], []
    balls = [closure for closure in tree.closures if closure.kind == "ball"]
    if form != "mjcf" and balls:
        lines.append(
            f"{len(balls)} ball joints close loops, as drake:ball_constraint, which Drake alone "
            f"reads; elsewhere close {_and_so_on([str(ball) for ball in balls])}"
        )
    forces = tree.plant.num_force_elements() - 1
    if form == "mjcf":
        forces -= len(tree.drives.springs)
    else:
        welds = (closure for closure in tree.closures if closure.kind == "weld")
        lines += (f"not in {title}: the weld of {weld}" for weld in welds)
    if forces:
        lines.append(f"not in {title}: {forces} springs or bushings")
    if tree.constraints.others:
        lines.append(f"not in {title}: {tree.constraints.others} springs of points or tendons")
    if locked := [
        name
        for name, joint in zip(tree.joint_names, tree.joints, strict=True)
        if joint.num_velocities() and joint.is_locked(tree.context)
    ]:
        lines.append(f"not in {title}: the locks of {', '.join(locked)}")
    if tree.other_names:
        others = ", ".join(f"{own} is {name}" for name, own in tree.other_names.items())
        lines.append(f"joints have other names in {title}, as links have theirs: {others}")
    pairs = zip(tree.bodies, tree.links, strict=True)
    belts = [link for body, link in pairs if tree.belt(body) is not None]
    if belts:
        lines.append(f"not in {title}: the speed of the belt on {', '.join(belts)}")
    if form == "urdf":
        shapes = {
            type(each.shape)
            for body in tree.bodies
            for role in (Role.kIllustration, Role.kProximity)
            for each in tree.shapes(body, role)
        }
        if HalfSpace in shapes:
            lines.append("the ground is a box: URDF has no half space")
        if Ellipsoid in shapes:
            lines.append("ellipsoids are seen as balls: URDF has none")
    if tree.actuators:
        lines += _drives_in_mjcf(tree) if form == "mjcf" else _drives_in(title, tree)
    return lines


def _drives_in_mjcf(tree: Description) -> list[str]:
    """Lines about drives as actuators of MuJoCo."""
    controlled = Counter(servo.controlled for servo in tree.drives.servos)
    kinds = {
        "position": ("position servo", "a position"),
        "speed": ("velocity servo", "a speed"),
        "force": ("motor", "a force, for want of gains"),
        "number": ("actuator", "with gain and bias as they were"),
    }
    words = [
        f"{_count(controlled[control], kind)}, control {what}"
        for control, (kind, what) in kinds.items()
        if controlled[control]
    ]
    limited = sum(servo.forces is not None for servo in tree.drives.servos)
    limited += len(tree.drives.forces)
    if limited:
        words.append(_count(limited, "limit") + " of force")
    if count := len(tree.drives.armatures):
        words.append(_count(count, "armature"))
    speeds = any(
        np.isfinite(actuator.joint().velocity_upper_limits()).all()
        for actuator in tree.actuators.values()
    )
    missing = ("limits of speed, " if speeds else "") + _NO_DRIVES
    return [f"drives in MJCF: {'; '.join(words)}", f"not in MJCF: {missing}"]


def _drives_in(title: str, tree: Description) -> list[str]:
    """Lines about drives in a format that has limits, and for Drake gains and rotors."""
    gains = sum(actuator.has_controller() for actuator in tree.actuators.values())
    words = []
    if gains:
        words.append(
            f"{_count(gains, 'servo')}, as drake:controller_gains, which Drake alone reads"
        )
    if others := len(tree.actuators) - gains:
        words.append(_count(others, "motor") + " without gains")
    lines = [f"drives in {title}: {'; '.join(words)}"]
    servos, driven = tree.drives.servos, {a.joint().index() for a in tree.actuators.values()}
    names = {
        joint.index(): name for name, joint in zip(tree.joint_names, tree.joints, strict=True)
    }
    for what, joints in (
        ("gears", [servo.joint for servo in servos if servo.gear != 1.0]),
        ("ranges of controls", [servo.joint for servo in servos if servo.controls is not None]),
        ("armatures", [joint for joint in tree.drives.armatures if joint not in driven]),
    ):
        if joints:
            of = ", ".join(names[joint] for joint in dict.fromkeys(joints))
            lines.append(f"not in {title}: the {what} of {of}")
    lines.append(f"not in {title}: {_NO_DRIVES}")
    return lines


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _and_so_on(texts: list[str]) -> str:
    return texts[0] if len(texts) == 1 else f"{texts[0]}, and so on to {texts[-1]}"
