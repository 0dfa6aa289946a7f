"""Views of the chair: as its encoders measure it, and pale where its branches are led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from parapod.diagrams.drawing import draw, publish
from parapod.diagrams.real import MachineView
from parapod.diagrams.twin import DESIRED, MEASURED, Tracker, Twin
from parapod.diagrams.walking_chair.model import add_leg
from parapod.diagrams.walking_chair.plants import Beginning, add_drawing, make_statics
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.kinematic_chair import KinematicChair
from parapod.systems.walking_chair.leg import leg_corners, up_of_lengths
from parapod.systems.walking_chair.model import leg_joints
from parapod.systems.walking_chair.odometry import FeetOdometer, Footing
from parapod.urdf import configure_parser

# Signal with the branches' lengths.
_DRAWN = {MEASURED: "legs.position", DESIRED: "position_node"}
_SUPPORT = "support"
_FOOTINGS = {drawing: f"footing_{drawing}" for drawing in _DRAWN}
_SIZES = (3, len(BRANCHES), LEG_COUNT)  # sizes of the parts of a footing


class ChairTwin(Twin):
    """Two drawings of the chair, at rest on its feet with the lengths that its branches have.

    Feet that stand do not slip: the drawing goes where the lengths lead it, from the place at
    which the scenario begins. `support` tells which feet these are, or else their heights do.
    """

    needed = frozenset((_DRAWN[MEASURED],))
    signals = needed | {_DRAWN[DESIRED], _SUPPORT}
    tracked = frozenset(_FOOTINGS.values())

    def __init__(self, meshcat: Meshcat | None, scenario: ChairScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        beginning = Beginning.from_scenario(scenario.walk, scenario)
        self._statics: dict[str, KinematicChair] = {}
        for drawing in _DRAWN:
            position = self.input(drawing, len(BRANCHES))
            chair = make_statics(scenario, beginning)
            self._statics[drawing] = add(self.builder, chair, f"statics_of_{drawing}")
            connect(self.builder, position, chair.GetInputPort("position"))
            add_drawing(self.builder, scenario, position, chair, meshcat, self.path(drawing))
        self._geometry = scenario.machine.geometry
        self._track, self._shown = _Steps(self._geometry, beginning.body), 0
        self.finish()

    @classmethod
    def tracker(cls, scenario: ChairScenario) -> Tracker:
        """Counts the steps; see `Twin`."""
        beginning = Beginning.from_scenario(scenario.walk, scenario)
        return _Steps(scenario.machine.geometry, beginning.body)

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        measured = values[_DRAWN[MEASURED]]
        for drawing, name in _DRAWN.items():
            self._fix(drawing, values.get(name, measured))
        complete = values if self.tracked <= values.keys() else self._counted(values)
        for drawing, name in _DRAWN.items():
            footing = _unpacked(complete[_FOOTINGS[drawing]])
            lengths = np.reshape(values.get(name, measured), (LEG_COUNT, 3))
            self._statics[drawing].put(self._context, footing.at(self._geometry, lengths))
        self._publish({}, time)

    def _counted(self, values: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[np.float64]]:
        """Counts a picture as the next sample, from each of which on the way is counted anew."""
        self._shown += 1
        samples = {n: values[n][np.newaxis] for n in self.signals & values.keys()}
        counts = self._track(np.array([float(self._shown)]), samples)
        return {name: each[0] for name, each in counts.items()}


class _Steps:
    """The chair's `Tracker`: the footing of each drawing."""

    def __init__(self, geometry: ChairGeometry, place: NDArray[np.float64]):
        self._odometers = {d: FeetOdometer(geometry, place[:2]) for d in _DRAWN}

    def __call__(
        self, time: NDArray[np.float64], samples: Mapping[str, NDArray[Any]]
    ) -> Mapping[str, NDArray[np.float64]]:
        positions = {}
        for drawing, odometer in self._odometers.items():
            lengths = samples.get(_DRAWN[drawing], samples[_DRAWN[MEASURED]])
            footing = odometer.add(time, lengths, samples.get(_SUPPORT))
            parts = [np.reshape(part, (len(time), -1)) for part in footing]
            positions[_FOOTINGS[drawing]] = np.concatenate(parts, axis=1)
        return positions


def _unpacked(footing: NDArray[np.float64]) -> Footing:
    place, lengths, stands = np.split(footing, np.cumsum(_SIZES)[:-1])
    return Footing(place, lengths.reshape(LEG_COUNT, 3), stands)


# Height of a leg's upper platform above the floor: its foot swings clear of that [m].
_HANGS = 1.1
_FLOOR = Cylinder(0.6, 0.02)
_CAMERA, _TARGET = (1.2, 1.5, 1.0), (0.0, -0.05, 0.68)  # [m]


class LegTwin(Twin):
    """Two drawings of one leg that hangs in the air: as it is, and pale as it is asked to be.

    A line shows the way of the foot's corner E_1.
    """

    needed = frozenset(("leg.position",))
    signals = needed | {"leg.position_desired"}

    def __init__(self, meshcat: Meshcat | None, scenario: ChairScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        self._geometry = scenario.machine.geometry.leg
        for drawing in (MEASURED, DESIRED):
            path = self.path(drawing)
            scene_graph = add(self.builder, SceneGraph(), f"drawing_of_{path}")
            self._leg = MultibodyPlant(time_step=1.0)
            self._leg.RegisterAsSourceForSceneGraph(scene_graph)
            parser = Parser(self._leg)
            configure_parser(parser)
            add_leg(parser, "leg", self._geometry)
            self._leg.WeldFrames(
                self._leg.world_frame(),
                self._leg.GetFrameByName("upper_platform"),
                RigidTransform(np.array([0.0, 0.0, _HANGS])),
            )
            self._leg.Finalize()
            positions = self.input(drawing, self._leg.num_positions())
            draw(self.builder, self._leg, positions, scene_graph)
            publish(self.builder, scene_graph, meshcat, path)
        self.finish()
        self._way: list[NDArray[np.float64]] = []
        if meshcat is None or self.is_guest:
            return
        meshcat.SetObject("/floor", _FLOOR, Rgba(0.86, 0.89, 0.91))
        meshcat.SetCameraPose(np.array(_CAMERA), np.array(_TARGET))

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        measured = values["leg.position"]
        desired = values.get("leg.position_desired", measured)
        self._publish({MEASURED: self._joints(measured), DESIRED: self._joints(desired)}, time)
        self._draw_way(measured)

    def _draw_way(self, lengths: NDArray[Any]) -> None:
        geometry = self._geometry
        corner, *_ = leg_corners(geometry, up_of_lengths(geometry, lengths))
        self._way.append(corner + np.array((0.0, 0.0, _HANGS)))
        if self.meshcat is not None and len(self._way) > 1:
            path, colour = f"{self.path(MEASURED)}_way", Rgba(0.90, 0.35, 0.10)
            self.meshcat.SetLine(path, np.array(self._way).T, 2.0, colour)

    def _joints(self, lengths: NDArray[Any]) -> NDArray[np.float64]:
        """Positions of the leg's joints, its loops closed, by the lengths (3) of its branches."""
        positions = np.zeros(self._leg.num_positions())
        for name, value in leg_joints(self._geometry, lengths).items():
            positions[self._leg.GetJointByName(name).position_start()] = value
        return positions


# Drawing and plots by which the machine is looked at.
VIEW = MachineView(
    ChairTwin,
    plots=(
        "position_node[0:3]+legs.position[0:3]",
        "support_margin",
        "truth.contact_force",
        "legs.current[0:3]",
    ),
    log_every=2,
)
