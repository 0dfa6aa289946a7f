"""Views of the bench: as measured, pale where its plate is led to, and the terrain played."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from parapod.diagrams.real import MachineView
from parapod.diagrams.terrain_simulator.plants import add_drawing
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.twin import DESIRED, MEASURED, Twin
from parapod.systems.core.ports import read
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.terrain import Terrain
from parapod.systems.terrain_simulator.walk import BenchWalk

_PERIOD = 1.0 / 30.0
_GROUND, _MARK = Rgba(0.55, 0.62, 0.50, 1.0), Rgba(0.84, 0.37, 0.0, 1.0)
# Place of the strip across the bench, its width, and how deep it is below its lowest ground [m].
_ASIDE, _WIDTH, _DEEP = 0.62, 0.30, 0.05
# How far it is seen ahead of and behind the body's way, and the distance of its points [m].
_BEYOND, _STEP = 0.8, 0.004
_PATH = "terrain"


def profile(terrain: Terrain, first: float, last: float) -> Array:
    """Distances and heights (k, 2) of a terrain's corners between two distances [m]."""
    along = np.arange(first, last + _STEP, _STEP)
    points = np.stack((along, terrain.height(along)), axis=-1)
    # Only where it bends: a strip of long faces.
    bends = np.abs(np.diff(points[:, 1], n=2)) > 1e-9
    return points[np.concatenate(([True], bends, [True]))]


class TerrainRibbon(LeafSystem):
    """Strip of ground that goes by beside the bench as the body would walk over it.

    Inputs: `distance` (1) and `rise` (1) of the body [m]. No outputs, no state.

    Args:
        meshcat: the scene.
        walk: the walk whose terrain is drawn.
    """

    def __init__(self, meshcat: Meshcat, walk: BenchWalk):
        super().__init__()
        self.set_name("terrain_ribbon")
        self._meshcat = meshcat
        self._origin = walk.path.x_c, walk.path.z_c
        self._distance = self.DeclareVectorInputPort("distance", 1)
        self._rise = self.DeclareVectorInputPort("rise", 1)
        reach = walk.path.gait.speed * (walk.landing - walk.lift_off)
        first, last = walk.path.start - _BEYOND, walk.path.start + reach + _BEYOND
        _draw_strip(meshcat, profile(walk.path.terrain, first, last))
        meshcat.SetObject(f"{_PATH}_mark", Sphere(0.02), _MARK)
        x, z = self._origin
        meshcat.SetTransform(f"{_PATH}_mark", RigidTransform(np.array((x, _ASIDE, z + 0.02))))
        self.DeclarePeriodicPublishEvent(_PERIOD, 0.0, self._move)
        self.DeclareForcedPublishEvent(self._move)

    def _move(self, context: Context) -> EventStatus:
        """Puts the strip where the body is, with the time for a recording."""
        (distance,), (rise,) = read(self._distance, context), read(self._rise, context)
        x, z = self._origin
        place = np.array((x - distance, _ASIDE, z - rise))
        self._meshcat.SetTransform(_PATH, RigidTransform(place), context.get_time())
        return EventStatus.Succeeded()


def _draw_strip(meshcat: Meshcat, points: Array) -> None:
    """Draws the ground and its near side."""
    along, height = points.T
    low = np.full_like(height, height.min() - _DEEP)
    half = 0.5 * _WIDTH
    rows = [
        np.stack((along, np.full_like(along, y), z), axis=-1)
        for y, z in ((half, height), (-half, height), (-half, low))
    ]
    vertices = np.concatenate(rows)
    n = len(along)
    first = np.arange(n - 1, dtype=np.int32)
    faces = [
        np.stack((a + first, b + first, c + first), axis=-1)
        for a, b, c in ((0, n, 1), (n, n + 1, 1), (n, 2 * n, n + 1), (2 * n, 2 * n + 1, n + 1))
    ]
    meshcat.SetTriangleMesh(_PATH, vertices.T, np.concatenate(faces).T.astype(np.int32), _GROUND)


# Signal with the plate's pose.
_DRAWN = {MEASURED: "pose_estimated", DESIRED: "pose_desired"}
_HIP, _LEG = "hip.position", "leg.position"


class BenchTwin(Twin):
    """Two drawings of the bench, with the leg as it is measured."""

    needed = frozenset((_DRAWN[MEASURED], _HIP, _LEG))
    stand_ins = {_DRAWN[MEASURED]: "truth.pose"}  # noqa: RUF012
    signals = needed | {_DRAWN[DESIRED]}

    def __init__(self, meshcat: Meshcat | None, scenario: TerrainBenchScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        self._x = scenario.walk.hip[0]
        sizes = {"pose": 3, "hip": 2, "leg": scenario.leg.ports}
        for drawing in _DRAWN:
            pose, hip, leg = (self.input(f"{drawing}_{name}", n) for name, n in sizes.items())
            add_drawing(self.builder, scenario, (pose, hip, leg), meshcat, self.path(drawing))
        self.finish()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        positions: dict[str, Any] = {}
        for drawing, name in _DRAWN.items():
            positions[f"{drawing}_pose"] = values.get(name, values[_DRAWN[MEASURED]])
            positions[f"{drawing}_hip"] = [self._x, values[_HIP][0]]
            positions[f"{drawing}_leg"] = values[_LEG]
        self._publish(positions, time)


# Drawing and plots by which the machine is looked at.
VIEW = MachineView(
    BenchTwin,
    plots=(
        "pose_desired[0:2]+pose_estimated[0:2]",
        "pose_desired[2]+pose_estimated[2]",
        "foot_load[0:2]",
        "hip.position",
        "sliders.velocity",
    ),
)
