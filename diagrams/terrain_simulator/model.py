"""The terrain simulator's bodies, joints and loops in a MultibodyPlant; pictures.

Three sliders, two links, plate and strut, two loops closed by ball constraints. Masses and the
drives' stiffness are assumptions. Loops stay closed within 5 um at 1 ms, four times as well at
half the step; a plate whose sliders are led one step ahead follows within .03 mm and .006 deg, and
trails by speed times step without that.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any
from xml.etree import ElementTree

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
)

from parapod.diagrams.bodies import (
    Body,
    Stretch,
    fit_link,
    limit_joints,
    link_bodies,
    place_element,
    place_joints,
)
from parapod.diagrams.multibody import add_adapted_model
from parapod.diagrams.terrain_simulator.leg import AddedLeg, LegUnderTest
from parapod.systems.core.errors import ScenarioError
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.load_estimator import BenchMasses, PlaneBody
from parapod.systems.terrain_simulator.model import SLIDERS, BenchModel
from parapod.urdf import configure_parser

# Stiffness of a slider's drive [N/m], and its damping [N s/m]: assumptions.
STIFFNESS = PdControllerGains(p=1e7, d=2e4)
# Least factor of a drawn cheek [-].
_LEAST = 0.2
# Gains of the drive that holds the column or moves it, which is not one of the bench's own.
_COLUMN = PdControllerGains(p=1e9, d=2e6)
_FOLDER = "package://parapod/terrain_simulator"


# Greatest height of the slide to which the column is drawn [m].
_HIGHEST = 1.4
# Middle of the drawn rail, and reach of its sliders [m].
_RAIL, _REACH = 0.6, 1.04
_ENDLESS = (-100.0, 100.0)  # ends of a slide that has none [m]
_AT_ENDS = 0.08  # way of the sliders' joints beyond the stops, by their reach of 1.04 m [m]


@dataclass(frozen=True)
class LegOnSlide:
    """A leg on the slide of the column, in a plant.

    Attributes:
        leg: the leg.
        column: model instance of the column.
        slide: model instance of the slide.
    """

    leg: AddedLeg
    column: ModelInstanceIndex
    slide: ModelInstanceIndex

    def order(self, plant: MultibodyPlant) -> tuple[int, ...]:
        """Indices of column, slide and the leg's joints among the plant's positions."""
        carriers = (("column", self.column), ("slide", self.slide))
        joints = [plant.GetJointByName(*carrier) for carrier in carriers]
        joints += [*self.leg.joints, *self.leg.passive]
        return tuple(joint.position_start() for joint in joints)


def add_bench(
    plant: MultibodyPlant,
    geometry: BenchGeometry,
    stiffness: PdControllerGains = STIFFNESS,
    add_more: Callable[[], None] = lambda: None,
    max_force: float | None = None,
    bodies: Mapping[str, Body] | None = None,
) -> BenchModel:
    """Adds a bench to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        geometry: the bench.
        stiffness: stiffness and damping of each slider's drive [N/m, N s/m].
        add_more: adds what else is to be in the plant.
        max_force: largest force of each slider's drive [N]; None: that of the file.
        bodies: masses of its links by their names; None: those of the files, by volume.
    """
    parser = Parser(plant)
    configure_parser(parser)
    links, efforts = bodies or {}, {} if max_force is None else {"effort": max_force}

    def fit_rail(root: ElementTree.Element) -> None:
        _fit_rail(geometry, links, efforts, root)

    def fit_plate(root: ElementTree.Element) -> None:
        _fit_plate(geometry, links, root)

    name = "treadmill" if geometry.belt else "pedal"
    rail = add_adapted_model(parser, f"{_FOLDER}/rail.urdf", "rail", fit_rail)
    carried = add_adapted_model(parser, f"{_FOLDER}/{name}.urdf", name, fit_plate)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("rail", rail))
    link = plant.GetFrameByName("link_1", rail)
    X_LP = RigidTransform(np.array((geometry.link, 0.0, 0.0)))
    pivot: Any = plant.AddFrame(FixedOffsetFrame("P", link, X_LP))
    y = np.array((0.0, 1.0, 0.0))
    plant.AddJoint(RevoluteJoint("plate", pivot, plant.GetFrameByName("plate", carried), y))
    model = BenchModel(plant, geometry, rail, carried)
    here = np.zeros(3)
    tip, foot = np.array((geometry.link, 0.0, 0.0)), np.array((-geometry.strut, 0.0, 0.0))
    plant.AddBallConstraint(model.body("link_2"), tip, model.body("plate"), here)
    plant.AddBallConstraint(model.body("strut"), foot, model.body("slider_3"), here)
    for name in SLIDERS:
        plant.GetJointActuatorByName(name, rail).set_controller_gains(stiffness)
    add_more()
    plant.Finalize()
    return model


def _fit_rail(
    geometry: BenchGeometry,
    bodies: Mapping[str, Body],
    efforts: Mapping[str, float],
    root: ElementTree.Element,
) -> None:
    """Gives rail, sliders and links the sizes of a bench; they are drawn for links of 300 mm."""
    link = geometry.link / BenchGeometry.pedal().link
    rear, front = geometry.slider_min, geometry.slider_max
    reach = (front - rear) / _REACH
    about = (_RAIL, 0.0, 0.0), (0.5 * (rear + front), 0.0, 0.0)
    fit_link(root, "rail", (reach, link, link), None, about=about)
    for name in (*SLIDERS, "link_1", "link_2"):
        fit_link(root, name, (link, link, link), bodies.get(name))
    beyond = reach * _AT_ENDS
    limits = {"lower": rear - beyond, "upper": front + beyond} | dict(efforts)
    limit_joints(root, dict.fromkeys(SLIDERS, limits))


def _fit_plate(
    geometry: BenchGeometry, bodies: Mapping[str, Body], root: ElementTree.Element
) -> None:
    """Gives plate, tread and strut the sizes of a bench."""
    paper = BenchGeometry.treadmill() if geometry.belt else BenchGeometry.pedal()
    link, strut = geometry.link / paper.link, geometry.strut / paper.strut
    plate = geometry.plate / paper.plate
    about = _from_p(paper.p_OP, (0.0, 0.0)), _from_p(geometry.p_OP, (0.0, 0.0))
    pivot = _from_p(geometry.p_OP, geometry.p_OT)
    # Cheeks lead from P to the plate, of which they keep some height.
    cheek = tuple(
        max(abs(own / usual), _LEAST) if usual else 1.0
        for own, usual in zip(about[1], about[0], strict=True)
    )
    shapes: dict[str, Stretch] = {"pivot_p": (link, link, link)}
    for name in ("cheek_near", "cheek_far"):
        shapes[name] = (cheek[0], link, cheek[2])
    for name in ("plate", "tread"):
        fit_link(root, name, (plate, link, link), bodies.get(name), shapes, about)
    fit_link(root, "strut", (strut, link, link), bodies.get("strut"))
    place_joints(root, {"strut": pivot})
    for visual in root.findall("link[@name='plate']/visual[@name='pivot_t']/origin"):
        place_element(visual, "xyz", pivot)


def _from_p(p_OP: tuple[float, float], place: tuple[float, float]) -> tuple[float, float, float]:
    """A point of the plate, which is given from its middle, from its pivot P [m]."""
    return place[0] - p_OP[0], 0.0, place[1] - p_OP[1]


@lru_cache(maxsize=16)
def masses_of(
    geometry: BenchGeometry, bodies: tuple[tuple[str, Body], ...]
) -> tuple[BenchMasses, PlaneBody]:
    """Masses of a bench in closed form, as the plant that is built has them.

    Args:
        geometry: the bench.
        bodies: its links by their names.

    Returns:
        Those of the bench, and that of the tread, which the cells bear.
    """
    masses, name = dict(bodies), "treadmill" if geometry.belt else "pedal"
    links = link_bodies(f"{_FOLDER}/rail.urdf", partial(_fit_rail, geometry, masses, {}))
    links |= link_bodies(f"{_FOLDER}/{name}.urdf", partial(_fit_plate, geometry, masses))

    def taken(names: Sequence[str], x: float, z: float = 0.0) -> PlaneBody:
        """Bodies together, about a point of their frame, which is the same."""
        parts = [links[name] for name in names]
        total = sum(part.mass for part in parts)
        places = np.array([part.centre for part in parts])[:, ::2]
        own = np.array([part.mass for part in parts])
        centre = own @ places / total
        inertia = sum((part.inertia or (0.0, 0.0))[1] for part in parts)
        inertia += float(own @ ((places - centre) ** 2).sum(axis=1))
        ahead, above = (centre - (x, z)).tolist()
        return PlaneBody(total, (ahead, above), inertia)

    middle = -geometry.p_OP[0], -geometry.p_OP[1]
    bench = BenchMasses(
        taken(["slider_1"], 0.0).mass,
        taken(["link_1"], 0.0),
        taken(["strut"], -geometry.strut),
        taken(["plate", "tread"], *middle),
    )
    return bench, taken(["tread"], *middle)


def add_leg_on_slide(
    plant: MultibodyPlant,
    leg: LegUnderTest,
    mass: float,
    ends: tuple[float, float] | None = None,
    scene_graph: SceneGraph | None = None,
) -> LegOnSlide:
    """Adds the column, the hip's slide and the leg on it to a plant that is not finalized.

    Args:
        plant: the plant.
        leg: the leg.
        mass: mass that the slide has with its leg [kg].
        ends: ends of the slide's way [m]; None: farther than it ever goes.
        scene_graph: scene graph with which the plant is registered; None: nothing collides.

    Raises:
        ScenarioError: the leg is not usable, or is heavier than that.
    """
    weight = mass - leg.mass
    if weight <= 0.0:
        raise ScenarioError(
            f"hip.mass_kg = {mass:g} must be more than the {mass - weight:.3g} kg of the leg",
            "hip.mass_kg",
        )

    def adapt(root: ElementTree.Element) -> None:
        inertial = root.find("link[@name='slide']/inertial/mass")
        assert inertial is not None
        inertial.set("value", repr(weight))

    parser = Parser(plant)
    configure_parser(parser)
    tall = 1.0 if ends is None else ends[1] / _HIGHEST

    def fit_column(root: ElementTree.Element) -> None:
        fit_link(root, "column", (1.0, 1.0, tall), None)

    column = add_adapted_model(parser, f"{_FOLDER}/column.urdf", "column", fit_column)
    plant.GetJointActuatorByName("column", column).set_controller_gains(_COLUMN)
    slide = add_adapted_model(parser, f"{_FOLDER}/slide.urdf", "slide", adapt)
    body = plant.GetFrameByName("slide", slide)
    frame, up = plant.GetFrameByName("column", column), np.array((0.0, 0.0, 1.0))
    joint = plant.AddJoint(PrismaticJoint("slide", frame, body, up, *(ends or _ENDLESS)))
    plant.AddJointActuator("slide", joint)
    return LegOnSlide(leg.add(plant, body, scene_graph), column, slide)
