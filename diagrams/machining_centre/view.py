"""Views of the centre: bodies, switches and panel, as measured and pale where they are led to."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    LeafSystem,
    OutputPort,
)

from parapod.diagrams.drawing import draw_model, publish
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.machining_centre.scenario import CentreScenario, Plan
from parapod.diagrams.real import MachineView
from parapod.diagrams.twin import DESIRED, MEASURED, Twin
from parapod.diagrams.wiring import add, connect
from parapod.systems.core.ports import read_array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import Drill
from parapod.systems.machining_centre.model import CentrePositions
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB
from parapod.systems.machining_centre.swing import LOCKABLE


def _below(depth: float) -> RigidTransform:
    return RigidTransform(np.array((0.0, 0.0, -depth)))


# Collars that are seen where a joint is locked, by the body that it turns, and covers of a foot
# that is not clamped; slightly larger than what they hide. Bodies, shapes, places, turns.
_LOCKED, _LET_GO = Rgba(0.90, 0.30, 0.0, 1.0), Rgba(0.75, 0.77, 0.80, 1.0)
_ACROSS = RollPitchYaw(0.5 * math.pi, 0.0, 0.0)
_COLLARS: dict[int, tuple[str, Shape, RigidTransform]] = {
    1: ("foot", Cylinder(0.024, 0.008), _below(0.010)),
    2: ("ankle_2", Cylinder(0.021, 0.010), RigidTransform(_ACROSS, np.zeros(3))),
    3: ("ankle_3", Sphere(0.0185), RigidTransform()),
    6: ("hinge", Cylinder(0.0095, 0.131), RigidTransform(_ACROSS, np.zeros(3))),
}
_COVERS = (
    ("sole", Cylinder(0.0368, 0.0165), _below(0.022)),
    ("plate", Cylinder(0.0468, 0.0125), _below(0.036)),
)
_PANEL, _HOLE = Rgba(0.86, 0.88, 0.91, 1.0), Rgba(0.15, 0.15, 0.18, 1.0)
# Margin of the drawn panel around the feet, and size of its facets [m].
_ROOM, _STEP = 0.35, 0.02
_HOLE_RADIUS = 5e-3
_LOOKS = 0.1  # between two looks at what is locked [s]


class SwitchColours(LeafSystem):
    """Colours joints that are locked, and feet that are not clamped, as their switches tell.

    Inputs: `locks_closed` (4n), `clamps_closed` (n). No outputs. State: what is shown (5n).

    Args:
        geometry: the centre.
        meshcat: the scene.
        path: path of the drawing there.
    """

    def __init__(self, geometry: CentreGeometry, meshcat: Meshcat, path: str):
        super().__init__()
        self.set_name(f"colours_of_{path}")
        self._meshcat, n = meshcat, geometry.limbs
        # Shown where a lock is closed, and where a clamp is open.
        self._shown: list[tuple[str, bool]] = []
        for limb in range(1, n + 1):
            for joint in LOCKABLE:
                body, shape, place = _COLLARS[joint]
                there = f"{path}/limb_{limb}/{body}/locked_{joint}"
                meshcat.SetObject(there, shape, _LOCKED)
                meshcat.SetTransform(there, place)
                self._shown.append((there, True))
        for limb in range(1, n + 1):
            there = f"{path}/limb_{limb}/foot/let_go"
            for name, shape, place in _COVERS:
                meshcat.SetObject(f"{there}/{name}", shape, _LET_GO)
                meshcat.SetTransform(f"{there}/{name}", place)
            self._shown.append((there, False))
        self._locks = self.DeclareVectorInputPort("locks_closed", LOCKS_OF_LIMB * n)
        self._clamps = self.DeclareVectorInputPort("clamps_closed", n)
        self.DeclareDiscreteState(np.full((LOCKS_OF_LIMB + 1) * n, np.nan))
        self.DeclarePeriodicPublishEvent(_LOOKS, 0.0, self._colour)
        self.DeclarePeriodicDiscreteUpdateEvent(_LOOKS, 0.0, self._remember)
        self.DeclareForcedPublishEvent(self._colour)

    def _closed(self, context: Context) -> NDArray[np.float64]:
        return np.concatenate([read_array(port, context) for port in (self._locks, self._clamps)])

    def _remember(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(0, self._closed(context))

    def _colour(self, context: Context) -> EventStatus:
        """Colours what has changed, with the time for a recording."""
        closed, now = self._closed(context), context.get_time()
        for i in np.flatnonzero(closed != context.get_discrete_state(0).value()).tolist():
            path, when_closed = self._shown[i]
            is_shown = bool(closed[i] > 0.5) == when_closed
            self._meshcat.SetProperty(path, "visible", is_shown, now)
        return EventStatus.Succeeded()


def add_colours(
    builder: DiagramBuilder,
    geometry: CentreGeometry,
    switches: tuple[OutputPort, OutputPort],
    meshcat: Meshcat,
    path: str = "centre",
) -> None:
    """Colours a drawing by what is locked and clamped.

    Args:
        builder: builder of the diagram that holds the ports' systems.
        geometry: the centre.
        switches: ports of the closed locks (4n) and the closed clamps (n).
        meshcat: the scene.
        path: path of the drawing there.
    """
    colours = add(builder, SwitchColours(geometry, meshcat, path))
    for port, name in zip(switches, ("locks_closed", "clamps_closed"), strict=True):
        connect(builder, port, colours.GetInputPort(name))


def add_drawing(
    builder: DiagramBuilder,
    geometry: CentreGeometry,
    pose: OutputPort,
    feet: OutputPort,
    meshcat: Meshcat | None,
    path: str = "centre",
) -> None:
    """Draws the bodies where platform and feet are.

    Args:
        builder: builder of the diagram that holds the ports' systems.
        geometry: the centre.
        pose: pose of the platform (6) [m, rad].
        feet: poses of the feet (6n) [m, rad].
        meshcat: scene in which to draw; None: poses are all that is asked for.
        path: its path in the scene.
    """
    signals = {"pose": pose, "feet": feet}
    scene_graph, _ = draw_model(
        builder, path, lambda plant: CentrePositions(add_centre(plant, geometry)), signals
    )
    publish(builder, scene_graph, meshcat, path)


def draw_panel(meshcat: Meshcat, plan: Plan, geometry: CentreGeometry) -> None:
    """Draws the panel around the centre's way, and its holes.

    Args:
        meshcat: the scene.
        plan: tells the panel, the way and the holes.
        geometry: the centre.
    """
    panel, reach = plan.job.panel, geometry.pattern_radius + _ROOM
    along, across = (
        np.arange(min(0.0, way) - reach, max(0.0, way) + reach + _STEP, _STEP)
        for way in plan.shift
    )
    vertices = np.array([panel.frame(a, c)[:3] for a in along for c in across]).T
    rows, columns = len(along), len(across)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    corners = (first, first + columns, first + 1, first + columns + 1)
    faces = np.hstack((np.stack(corners[:3]), np.stack((corners[2], corners[1], corners[3]))))
    meshcat.SetTriangleMesh("panel", vertices, faces, _PANEL)
    for number, operation in enumerate(plan.job.operations):
        if isinstance(operation, Drill):
            path = f"holes/{number}"
            meshcat.SetObject(path, Cylinder(_HOLE_RADIUS, 1e-3), _HOLE)
            place = RigidTransform(RollPitchYaw(operation.hole[3:]), operation.hole[:3])
            meshcat.SetTransform(path, place)


# Signal with the platform's pose.
_DRAWN = {MEASURED: "pose_estimated", DESIRED: "pose_desired"}
_FEET, _SWITCHES = "feet_estimated", ("locks.closed", "clamps.closed")


class CentreTwin(Twin):
    """Two drawings of the centre on the footholds that its lengths give."""

    needed = frozenset((_DRAWN[MEASURED], _FEET))
    stand_ins = {_DRAWN[MEASURED]: "truth.pose", _FEET: "truth.feet"}  # noqa: RUF012
    signals = needed | {_DRAWN[DESIRED], *_SWITCHES}

    def __init__(self, meshcat: Meshcat | None, scenario: CentreScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        geometry = scenario.machine.geometry
        limbs = geometry.limbs
        for drawing in _DRAWN:
            pose = self.input(f"{drawing}_pose", 6)
            feet = self.input(f"{drawing}_feet", 6 * limbs)
            add_drawing(self.builder, geometry, pose, feet, meshcat, self.path(drawing))
        if meshcat is not None:
            locks = self.input(_SWITCHES[0], LOCKS_OF_LIMB * limbs)
            clamps = self.input(_SWITCHES[1], limbs)
            add_colours(self.builder, geometry, (locks, clamps), meshcat, self.path(MEASURED))
            if not self.is_guest:
                draw_panel(meshcat, scenario.plan, geometry)
        self._switches = {_SWITCHES[0]: LOCKS_OF_LIMB * limbs, _SWITCHES[1]: limbs}
        self.finish()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        positions = {}
        for drawing, name in _DRAWN.items():
            positions[f"{drawing}_pose"] = values.get(name, values[_DRAWN[MEASURED]])
            positions[f"{drawing}_feet"] = values[_FEET]
        if self.meshcat is not None:
            for name, size in self._switches.items():
                positions[name] = values.get(name, np.ones(size))
        self._publish(positions, time)


# Drawing and plots by which the machine is looked at.
VIEW = MachineView(
    CentreTwin,
    plots=(
        "pose_desired[0:3]+pose_estimated[0:3]",
        "pose_desired[3:6]+pose_estimated[3:6]",
        "legs.position",
        "wrench_margin",
    ),
    log_every=2,
)
