"""A mechanism that is posed by its motors, by a frame, or by the mouse, on a page that shows it.

Sliders stand beside a Meshcat scene, in which the mouse drags bodies with Ctrl held. Whatever is
moved, all loops stay closed, and all sliders follow. Joints at their limits are marked, and the
marks of motors tell how near a singular position is.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import Frame, Joint
from pydrake.systems.framework import DiagramBuilder
from pydrake.visualization import (
    AddFrameTriadIllustration,
    ApplyVisualizationConfig,
    VisualizationConfig,
)

from parapod.diagrams.drawing import NO_LCM
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.systems.core.errors import ParapodError
from parapod.systems.mechanism.coordinates import PARTS, joint_unit, last_link, part_unit
from parapod.systems.mechanism.equations import pose_vector
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.parts import Model
from parapod.systems.mechanism.pulling import pulled
from parapod.systems.mechanism.statics import motor_forces

type Floats = NDArray[np.float64]

HOME = "Home"
# Frames a second, and the ratio of a singular value from which a pose is called near a singular
# one [-].
_RATE, _NEAR = 30.0, 0.01
# Stiffness of the mouse's spring by mass [1/s^2], by which its way is known; any does.
_STIFFNESS = 100.0
# Ranges of sliders without limits [rad, sizes of the mechanism].
_TURN, _SHIFT = math.pi, 0.5
_GOOD, _BAD = np.array([0.2, 0.7, 0.3]), np.array([0.9, 0.15, 0.1])
# Place of the camera from the middle, by the size of the mechanism [-].
_AWAY = np.array([1.4, -1.6, 0.8])
# Size of marks by that of the mechanism [-]; share of a range from which a limit is near [-].
_MARK, _MARGIN = 0.025, 0.05


class Poser:
    """A mechanism in one pose, in a scene.

    Attributes:
        mechanism: the mechanism.
        frame: name of the frame that is moved.
        parts: parts of the frame's pose that can be set, by their places in `PARTS`.
        q: (q) positions, all loops closed.
        remark: reason why the last move was not made; empty where it was.
    """

    def __init__(
        self,
        add_model: Callable[[Any], Model],
        frame: str = "",
        meshcat: Meshcat | None = None,
    ):
        """Builds the scene.

        Args:
            add_model: adds the model to a plant that is not finalized.
            frame: name of the frame that is moved; "": the link on which most loops end.
            meshcat: scene in which it is drawn; None: nowhere.

        Raises:
            ParapodError: a model that cannot be read, or whose loops cannot be closed.
        """
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        if meshcat is None:
            plant = type(plant)(1e-3)
        model = self._model = add_model(plant)  # whose meshes are there as long as it is
        plant.Finalize()
        self.mechanism = Mechanism.of_model(model)
        self.mechanism.check_motors()
        self.frame = self.mechanism.frame(frame).name() if frame else last_link(self.mechanism)
        self.parts = self.mechanism.free_parts(self.frame)
        self.q, self.remark = self.mechanism.home, ""
        self._marks: dict[str, tuple[float, ...]] = {}
        self._meshcat, self._diagram, self._mouse = meshcat, None, None
        if meshcat is not None:
            body = self.mechanism.frame(self.frame).body()
            length = 0.15 * self.mechanism.size
            AddFrameTriadIllustration(
                scene_graph=scene_graph, body=body, length=length, radius=0.03 * length
            )
            settings = VisualizationConfig(
                publish_period=1.0 / _RATE,
                publish_proximity=False,
                publish_inertia=False,
                publish_contacts=False,
                delete_on_initialization_event=False,
                mouse_interaction_stiffness=_STIFFNESS,
            )
            ApplyVisualizationConfig(settings, builder, meshcat=meshcat, lcm=NO_LCM)
            self._diagram = builder.Build()
            self._root = self._diagram.CreateDefaultContext()
            self._mouse = self._diagram.GetSubsystemByName("meshcat_mouse_spring")
            self.publish()
            self._look_at(meshcat)

    def _look_at(self, meshcat: Meshcat) -> None:
        """Has the camera see all of the mechanism."""
        plant = self.mechanism.plant
        context = plant.GetMyContextFromRoot(self._root)
        poses: Any = plant.get_body_poses_output_port().Eval(context)
        places = np.array([pose.translation() for pose in poses[1:]])
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        away = _AWAY * self.mechanism.size
        meshcat.SetCameraPose(middle + away, middle)

    # --- moves

    def move_motors(self, motors: ArrayLike) -> None:
        """Moves the motors' joints to positions [m, rad]."""
        self._try(lambda: self.mechanism.forward(motors, self.q))

    def move_frame(self, values: Mapping[int, float]) -> None:
        """Moves the frame to parts of a pose, by their places in `PARTS` [m, rad].

        Other parts that the motors can set stay, unless one is asked for that they cannot.
        """
        goal = np.full(6, np.nan)
        if set(values) <= set(self.parts):
            goal[list(self.parts)] = self.pose[list(self.parts)]
        for part, value in values.items():
            goal[part] = value
        self._try(lambda: self.mechanism.inverse(self.frame, goal, self.q))

    def pull(self, body: str, point: ArrayLike, way: ArrayLike) -> None:
        """Pulls a point (3) of a body along a way (3) in the world [m]."""
        self._pull(self.mechanism.plant.GetBodyByName(body).body_frame(), point, way)

    def follow_mouse(self) -> bool:
        """Follows the mouse where it drags a body; returns whether it does."""
        if self._mouse is None or self._diagram is None:
            return False
        context = self._mouse.GetMyContextFromRoot(self._root)
        forces: Any = self._mouse.GetOutputPort("applied_spatial_force").Eval(context)
        for force in forces:
            body = self.mechanism.plant.get_body(force.body_index)
            if mass := body.default_mass():
                way = force.F_Bq_W.translational() / (mass * _STIFFNESS)
                self._pull(body.body_frame(), force.p_BoBq_B, way)
                return True
        return False

    def _pull(self, frame: Frame, point: ArrayLike, way: ArrayLike) -> None:
        self._try(lambda: pulled(self.mechanism, self.q, frame, point, way))

    def _try(self, move: Callable[[], Floats]) -> None:
        try:
            self.q, self.remark = move(), ""
        except ParapodError as error:
            self.remark = str(error)

    # --- what there is to see

    @property
    def motors(self) -> Floats:
        """Positions of the motors' joints [m, rad]."""
        return self.mechanism.motor_positions(self.q)

    @property
    def pose(self) -> Floats:
        """Pose of the frame (6): x, y, z [m], roll, pitch, yaw [rad]."""
        return pose_vector(self.mechanism.pose(self.frame, self.q))

    def publish(self) -> None:
        """Draws the pose, and marks of limits and of singular positions."""
        if self._diagram is None:
            return
        plant = self.mechanism.plant
        plant.SetPositions(plant.GetMyMutableContextFromRoot(self._root), self.q)
        self._diagram.ForcedPublish(self._root)
        held = self.mechanism.dexterity(self.q).held
        for joint in self.mechanism.motors:
            self._mark(joint, min(1.0, held / _NEAR))
        for joint in self.mechanism.passive:
            if np.isfinite((*joint.position_lower_limits(), *joint.position_upper_limits())).all():
                self._mark(joint, self._room(joint))

    def _room(self, joint: Joint) -> float:
        """1 far from a joint's limits, 0 at one."""
        first, count = joint.position_start(), joint.num_positions()
        values = self.q[first : first + count]
        low, high = joint.position_lower_limits(), joint.position_upper_limits()
        room = np.minimum(values - low, high - values) / np.maximum(high - low, 1e-12)
        return float(np.clip(room.min() / _MARGIN, 0.0, 1.0))

    def _mark(self, joint: Joint, goodness: float) -> None:
        assert self._meshcat is not None
        name = self.mechanism.name(joint)
        path, room = f"/marks/{name}", min(goodness, self._room(joint))
        red, green, blue = (room * _GOOD + (1.0 - room) * _BAD).round(2).tolist()
        colour = red, green, blue
        if self._marks.get(name) != colour:
            size = _MARK * self.mechanism.size
            self._meshcat.SetObject(path, Sphere(size), Rgba(red, green, blue, 0.9))
            self._marks[name] = colour
        plant = self.mechanism.plant
        context = plant.GetMyContextFromRoot(self._root)
        place = joint.frame_on_child().CalcPoseInWorld(context).translation()
        self._meshcat.SetTransform(path, RigidTransform(place))

    def readout(self) -> Readout:
        """Numbers of the pose that sliders do not show."""
        mechanism, rows = self.mechanism, []
        near = mechanism.dexterity(self.q, self.frame)
        rows.append(Row("held (0: singular)", None, near.held, None, "", 4))
        rows.append(Row("moved (0: singular)", None, near.moved, None, "", 4))
        held = motor_forces(mechanism, self.q)
        for joint, force in zip(mechanism.motors, held.forces, strict=True):
            per = "N" if joint_unit(mechanism, joint)[0] == "mm" else "N m"
            rows.append(Row(f"{mechanism.name(joint)} holds", None, float(force), None, per, 2))
        for part, value in enumerate(self.pose):
            if part not in self.parts:
                unit, factor = part_unit(part)
                name = f"{self.frame}: {PARTS[part]}"
                rows.append(Row(name, None, factor * float(value), None, unit, 2))
        beyond = mechanism.beyond_limits(self.q)
        remarks = [self.remark] if self.remark else []
        remarks += [f"{name} is beyond its limits" for name in beyond]
        is_singular = min(near.held, near.moved) < _NEAR
        state = "near a singular position" if is_singular else "all loops closed"
        return Readout(state, rows, remarks, is_singular or bool(remarks))

    def range(self, joint: Joint) -> tuple[float, float]:
        """Smallest and largest position of a motor's slider [m, rad]."""
        (low,), (high,) = joint.position_lower_limits(), joint.position_upper_limits()
        is_length = self.mechanism.is_length[joint.velocity_start()]
        wide = _SHIFT * self.mechanism.size if is_length else _TURN
        middle = self.mechanism.home[joint.position_start()]
        return max(low, middle - wide), min(high, middle + wide)


class PosePage:
    """Sliders of a poser on a page."""

    def __init__(self, poser: Poser, panel: Panel):
        """Adds the sliders and buttons.

        Args:
            poser: the poser.
            panel: the page beside its scene.
        """
        self._poser, self._panel = poser, panel
        self._motors = [self._motor_slider(joint) for joint in poser.mechanism.motors]
        self._parts = {part: self._part_slider(part) for part in poser.parts}
        panel.AddButton(HOME)
        self._clicks = 0
        self._values: dict[str, float] = {}
        self._show()

    def _motor_slider(self, joint: Joint) -> tuple[str, float]:
        unit, factor = joint_unit(self._poser.mechanism, joint)
        name = f"{self._poser.mechanism.name(joint)} [{unit}]"
        low, high = (factor * end for end in self._poser.range(joint))
        self._panel.AddSlider(name, low, high, 0.01, 0.5 * (low + high))
        return name, factor

    def _part_slider(self, part: int) -> tuple[str, float]:
        unit, factor = part_unit(part)
        name = f"{self._poser.frame}: {PARTS[part]} [{unit}]"
        middle = float(self._poser.pose[part])
        wide = _SHIFT * self._poser.mechanism.size if part < 3 else _TURN
        low, high = factor * (middle - wide), factor * (middle + wide)
        self._panel.AddSlider(name, low, high, 0.01, factor * middle)
        return name, factor

    def look(self) -> None:
        """Does what has been asked for since the last look, and shows the pose."""
        clicks = self._panel.GetButtonClicks(HOME)
        if clicks > self._clicks:
            self._clicks = clicks
            self._poser.q, self._poser.remark = self._poser.mechanism.home, ""
            self._show()
        elif self._poser.follow_mouse():
            self._show()
        elif any(self._is_moved(name) for name, _ in self._motors):
            self._poser.move_motors(self._read(self._motors))
            self._show(but=[name for name, _ in self._motors])
        elif any(self._is_moved(name) for name, _ in self._parts.values()):
            values = self._read(list(self._parts.values()))
            self._poser.move_frame(dict(zip(self._parts, values, strict=True)))
            self._show(but=[name for name, _ in self._parts.values()])

    def _is_moved(self, name: str) -> bool:
        return self._panel.GetSliderValue(name) != self._values[name]

    def _read(self, sliders: Sequence[tuple[str, float]]) -> list[float]:
        return [self._panel.GetSliderValue(name) / factor for name, factor in sliders]

    def _show(self, but: Sequence[str] = ()) -> None:
        """Draws the pose and has sliders follow, but for those that ask for it."""
        poser, panel = self._poser, self._panel
        poser.publish()
        panel.show(poser.readout())
        pairs = [
            *zip(self._motors, poser.motors, strict=True),
            *((self._parts[part], poser.pose[part]) for part in self._parts),
        ]
        for (name, factor), value in pairs:
            is_kept = name in but and not poser.remark
            self._values[name] = (
                panel.GetSliderValue(name)
                if is_kept
                else panel.SetSliderValue(name, factor * float(value))
            )

    def serve(self, until: Callable[[], bool] = lambda: False) -> None:
        """Looks thirty times a second until told to end."""
        while not until():
            begin = time.monotonic()
            self.look()
            time.sleep(max(0.0, 1.0 / _RATE - (time.monotonic() - begin)))
