"""A model in a plant: what closes its loops, its motors, and its frames and joints by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

from pydrake.geometry import Mesh
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, FrameIndex, Joint, JointIndex, RigidBody

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import did_you_mean, printable, quoted
from parapod.systems.physics.description import Drives, bodies_of, joints_of, unique_names
from parapod.systems.physics.loops import Loop


@dataclass
class Model:
    """A model in a plant.

    Attributes:
        path: its file.
        plant: the plant, not finalized.
        loops: constraints that close its loops.
        motors: its joints with motors, by the file; empty where it names none.
        notes: parts that are read in another way than they are written, or not at all.
        efforts: largest forces of joints by their names, as a URDF has them without a transmission
            [N, N m].
        is_plain: true if its joints are hinges and slides alone, at the origins of their links, as
            all formats have them; light links are between those of one universal or ball joint.
        drives: parts of its drives that an MJCF has, and the plant does not hold.
    """

    path: Path
    plant: MultibodyPlant
    loops: list[Loop] = field(default_factory=list)
    motors: list[JointIndex] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    efforts: dict[str, float] = field(default_factory=dict)
    is_plain: bool = False
    drives: Drives = field(default_factory=Drives)
    _meshes: dict[str, Path] = field(default_factory=dict)

    @cached_property
    def _folder(self) -> TemporaryDirectory[str]:
        return TemporaryDirectory(prefix="parapod-meshes-")

    def mesh(self, name: str, text: str) -> Mesh:
        """A mesh for the plant, in a file that is there as long as the model is.

        Args:
            name: name of the mesh.
            text: its content as Wavefront OBJ.
        """
        if text not in self._meshes:
            path = Path(self._folder.name) / f"{name}_{len(self._meshes)}.obj"
            path.write_text(text, encoding="utf-8")
            self._meshes[text] = path
        return Mesh(str(self._meshes[text]), 1.0)


def named[P](name: str, parts: Mapping[str, P], kind: str, source: str) -> P:
    """Part of a name.

    Args:
        name: the name.
        parts: parts by their names.
        kind: word for such a part.
        source: file or thing that asks for it.

    Raises:
        ScenarioError: there is none of the name.
    """
    if name in parts:
        return parts[name]
    names = [each for each in parts if not each.endswith("_parent")]
    near = did_you_mean(name, names) or f"; there are: {', '.join(names)}"
    raise ScenarioError(printable(f"{source}: the model has no {kind} {quoted(name)}{near}"))


def frames_by_name(plant: MultibodyPlant) -> dict[str, Frame]:
    """Frames by their names, those of links among them, and of joints' children."""
    frames = {each: joint.frame_on_child() for each, joint in joints_by_name(plant).items()}
    every = [plant.get_frame(FrameIndex(i)) for i in range(plant.num_frames())]
    return frames | dict(zip(unique_names(every, "frame", set()), every, strict=True))


def bodies_by_name(plant: MultibodyPlant) -> dict[str, RigidBody]:
    """Bodies that can move by their names, with the model instance where another has the same."""
    bodies = [body for body in bodies_of(plant) if not plant.IsAnchored(body)]
    return dict(zip(unique_names(bodies, "body", set()), bodies, strict=True))


def joints_by_name(plant: MultibodyPlant) -> dict[str, Joint]:
    """Joints by their names, with the model instance where another one has the same."""
    joints = joints_of(plant)
    return dict(zip(unique_names(joints, "joint", set()), joints, strict=True))
