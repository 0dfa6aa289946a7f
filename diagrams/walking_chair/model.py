"""The walking chair's bodies, joints and ground in a MultibodyPlant; pictures."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex

from parapod.diagrams.bodies import (
    Body,
    fit_link,
    limit_joints,
    link_bodies,
    place_element,
    place_joints,
)
from parapod.diagrams.multibody import add_adapted_model, add_ground
from parapod.diagrams.pads import add_pads
from parapod.systems.walking_chair.geometry import ChairGeometry, LegGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.model import ChairModel, inertia_of, moment_of_inertia
from parapod.systems.walking_chair.payload import FORCE_LIMIT
from parapod.systems.walking_chair.statics import STIFFNESS
from parapod.urdf import configure_parser

_BRANCHES = ("up", "ups_2", "ups_3")
_DRAKE = "{http://drake.mit.edu}"
_BALL = f"{_DRAKE}ball_constraint/{_DRAKE}ball_constraint_p_BQ"
_GAINS = f"transmission/actuator/{_DRAKE}controller_gains"
# Damping of a branch with its screw and drive by its stiffness [s] (assumption).
_DAMPING = 0.02


@dataclass(frozen=True)
class BranchDrive:
    """Screw and drive of a branch.

    Attributes:
        stiffness: axial stiffness [N/m].
        max_force: largest force [N].
    """

    stiffness: float = STIFFNESS
    max_force: float = FORCE_LIMIT


_FOLDER = "package://parapod/walking_chair"
_DRAWN = ChairGeometry()  # dimensions to which the files are drawn
# Radius of gyration of the drawn passenger [m].
_GYRATION = Passenger().gyration


def add_chair(
    plant: MultibodyPlant,
    passenger: Passenger = Passenger(),
    geometry: ChairGeometry = _DRAWN,
    bodies: Mapping[str, Body] | None = None,
    drive: BranchDrive = BranchDrive(),
    giving: SceneGraph | None = None,
) -> ChairModel:
    """Adds chair, passenger and ground to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        passenger: person on the seat in a default context; one without mass is not file.
        geometry: dimensions of the chair.
        bodies: masses of its links by their names; None: those of the files, by volume.
        drive: stiffness and force of the branches.
        giving: scene graph of the plant if ground gives way under a foot, see `pads`; None: it
            does not.
    """
    parser = Parser(plant)
    configure_parser(parser)
    masses = bodies or {}
    fit_body = functools.partial(_fit_body, geometry, masses.get("body"))
    add_adapted_model(parser, f"{_FOLDER}/body.urdf", "body", fit_body)
    body = plant.GetFrameByName("body")
    for i, placement in enumerate(geometry.placements):
        turn = RotationMatrix.MakeZRotation(math.pi if placement.turned else 0.0)
        mount: Any = plant.AddFrame(
            FixedOffsetFrame(f"leg_mount_{i + 1}", body, RigidTransform(turn, geometry.p_SA[i]))
        )
        leg = add_leg(parser, f"leg_{i + 1}", geometry.leg, masses, drive)
        plant.WeldFrames(mount, plant.GetFrameByName("upper_platform", leg))
    X_SP = RigidTransform(passenger.place)
    seat: Any = plant.AddFrame(FixedOffsetFrame("seat", plant.GetFrameByName("body"), X_SP))
    if passenger.mass > 0.0:
        weigh = functools.partial(_weigh, passenger)
        add_adapted_model(parser, f"{_FOLDER}/passenger.urdf", "passenger", weigh)
    else:
        massless = inertia_of(passenger)
        plant.AddRigidBody("passenger", plant.AddModelInstance("passenger"), massless)
    plant.WeldFrames(seat, plant.GetFrameByName("passenger"))
    slab = add_ground(parser)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("ground", slab))
    model = ChairModel(plant, geometry)
    if giving is not None:
        shapes = [plant.GetCollisionGeometriesForBody(foot) for foot in model.feet]
        add_pads(plant, giving, plant.GetBodyByName("ground", slab), shapes)
    plant.Finalize()
    return model


def add_leg(
    parser: Parser,
    name: str,
    geometry: LegGeometry = _DRAWN.leg,
    bodies: Mapping[str, Body] | None = None,
    drive: BranchDrive = BranchDrive(),
) -> ModelInstanceIndex:
    """Adds a leg, whose `upper_platform` is to be welded somewhere.

    Args:
        parser: parser of the plant, which knows the models of `parapod.urdf`.
        name: name of its model instance.
        geometry: dimensions of the leg.
        bodies: masses of its links by their names; None: those of the file, by volume.
        drive: stiffness and force of its branches.
    """
    fit = functools.partial(_fit_leg, geometry, bodies or {}, drive)
    return add_adapted_model(parser, f"{_FOLDER}/leg.urdf", name, fit)


@functools.lru_cache(maxsize=16)
def masses_of(geometry: ChairGeometry, bodies: tuple[tuple[str, Body], ...]) -> ChairMasses:
    """Masses of a chair in closed form, as the plant that is built has them.

    Args:
        geometry: the chair.
        bodies: its links by their names.
    """
    (body,) = link_bodies(
        f"{_FOLDER}/body.urdf", functools.partial(_fit_body, geometry, dict(bodies).get("body"))
    ).values()
    legs = link_bodies(
        f"{_FOLDER}/leg.urdf",
        functools.partial(_fit_leg, geometry.leg, dict(bodies), BranchDrive()),
    )
    assert body.centre is not None
    *_, z = body.centre
    return ChairMasses(
        body=body.mass,
        body_height=z,
        upper_platform=legs["upper_platform"].mass,
        yoke=legs["up_yoke"].mass,
        cylinder=legs["up_cylinder"].mass,
        rod=legs["ups_2_rod"].mass,
        foot=legs["foot"].mass,
    )


def _fit_body(geometry: ChairGeometry, body: Body | None, root: Element) -> None:
    """Gives the body of a chair the size that its legs and its seat have room for."""

    def reach(of: ChairGeometry) -> tuple[float, float, float]:
        places = of.placements
        return max(abs(p.x) for p in places), max(abs(p.y) for p in places), of.seat_height

    x, y, z = (own / usual for own, usual in zip(reach(geometry), reach(_DRAWN), strict=True))
    fit_link(root, "body", (x, y, z), body)


def _fit_leg(
    geometry: LegGeometry, bodies: Mapping[str, Body], drive: BranchDrive, root: Element
) -> None:
    """Gives a leg its dimensions and masses, and its branches stiffness and force."""
    file = _DRAWN.leg
    wide, below = geometry.a / file.a, geometry.b / file.b
    hung, shod = geometry.x1 / file.x1, geometry.x3 / file.x3
    tubes = geometry.actuator_min / file.actuator_min
    fit_link(root, "upper_platform", (wide, wide, hung), bodies.get("upper_platform"))
    feet = dict.fromkeys((f"corner_{i}" for i in (1, 2, 3)), (below, below, below))
    shapes = {"rod": (below, below, tubes), **feet}
    fit_link(root, "foot", (below, below, shod), bodies.get("foot"), shapes)
    origins: dict[str, ArrayLike] = {"up_length": (0.0, 0.0, -geometry.x2)}
    limits: dict[str, dict[str, float]] = {}
    strokes = zip(_BRANCHES, geometry.strokes, file.strokes, strict=True)
    for i, (branch, stroke, drawn_stroke) in enumerate(strokes):
        for part in ("yoke", "cylinder", "rod"):
            link = f"{branch}_{part}"
            factor = hung if part == "yoke" else tubes
            if link != "up_rod":  # part of the foot
                fit_link(root, link, (factor,) * 3, bodies.get(link))
        origins[f"{branch}_swing"] = geometry.upper_joints[i]
        limit = root.find(f"joint[@name='{branch}_length']/limit")
        assert limit is not None
        ends = zip(("lower", "upper"), stroke - drawn_stroke, strict=True)
        moved_ends = {end: float(limit.get(end, "0")) + float(by) for end, by in ends}
        limits[f"{branch}_length"] = moved_ends | {"effort": drive.max_force}
    place_joints(root, origins)
    limit_joints(root, limits)
    for ball, place in zip(root.findall(_BALL), geometry.lower_joints[1:], strict=True):
        place_element(ball, "value", place)
    for gains in root.findall(_GAINS):
        gains.set("p", repr(drive.stiffness))
        gains.set("d", repr(_DAMPING * drive.stiffness))


def add_passenger(plant: MultibodyPlant, passenger: Passenger) -> None:
    """Adds a passenger who floats to a plant that is drawn, and finalizes it."""
    parser = Parser(plant)
    configure_parser(parser)
    weigh = functools.partial(_weigh, passenger)
    add_adapted_model(parser, f"{_FOLDER}/passenger.urdf", "passenger", weigh)
    plant.Finalize()


def _weigh(passenger: Passenger, root: Element) -> None:
    """Gives the model of a passenger its mass, its moments of inertia and its size."""
    size, moment = passenger.gyration / _GYRATION, moment_of_inertia(passenger)
    body = Body(passenger.mass, None, (moment, moment, moment, 0.0, 0.0, 0.0))
    fit_link(root, "passenger", (size, size, size), body)
