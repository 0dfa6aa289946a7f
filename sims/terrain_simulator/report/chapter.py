"""The terrain simulator's chapter: its kinematics, singularities and workspaces."""

import math

from parapod.diagrams.drawing import View
from parapod.diagrams.terrain_simulator.model import photograph
from parapod.sims.report.chapter import Chapter, Component, Part, Picture
from parapod.sims.report.rendered import rendered
from parapod.sims.terrain_simulator.report.claims import CLAIMS
from parapod.sims.terrain_simulator.report.drawings import DRAWINGS
from parapod.sims.terrain_simulator.report.errata import ERRATA

_VIEW = View((1.5, -2.6, 1.15), (0.60, 0.0, 0.08), angle=0.37, size=(1280, 900))


def pictures() -> tuple[Picture, ...]:
    """Both benches.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _take() -> tuple[Picture, ...]:
    (pedal,) = photograph([_VIEW], "pedal", (0.5, 0.29, math.radians(15.0)))
    (treadmill,) = photograph([_VIEW], "treadmill", (0.8, 0.26, math.radians(-7.0)))
    return (
        Picture("The pedal", "Front end down by 15 deg (in the place of Fig. 1).", pedal),
        Picture("The treadmill", "Front end up by 7 deg (in the place of Fig. 3).", treadmill),
    )


_PARTS = (
    Part(
        "bench-workspace",
        "Workspaces and singularities (section 4, Tables 1 and 2, Fig. 6)",
        "The paper shows the workspaces of both benches in three orientations each and concludes "
        "that Table 2 fulfils Table 1. Here they are exact, with and without a distance from the "
        "singularities, and what they hold of Table 1 is said box by box.",
        "bench-workspace",
        is_random=False,
    ),
)

_COMPONENTS = (
    Component(
        "PRR mechanism", "forward_kinematics, inverse_kinematics", "closed form, both modes"
    ),
    Component("Mechanical stops", "margins", "every limit's distance; least heights are assumed"),
    Component("Sliders, links, strut", "rail.urdf", "two loops closed by ball constraints"),
    Component("Pedal, treadmill", "pedal.urdf, treadmill.urdf", "masses are assumed"),
    Component("Structure parameters", "BenchGeometry", "Table 2, its l_5 of the treadmill mended"),
)

_MISSING = (
    "Fig. 2: ground reaction forces of a 120 kg quadruped, whose curves are not in numbers.",
    "The least heights of the pivots P and T that section 4 asks for and does not name: 20 mm are "
    "assumed.",
    "Masses, actuators and their limits, which the paper does not print.",
)

CHAPTER = Chapter(
    title="The terrain simulator",
    paper=(
        "Y. Gao, V. Barasuol, D. G. Caldwell and C. Semini (Istituto Italiano di Tecnologia), "
        "Kinematic design of a configurable terrain simulator platform for robotic legs"
    ),
    summary=(
        "A bench moves a pedal or a small treadmill under a single leg, so that it walks, trots "
        "and climbs without a robot around it: three sliders on one rail lead the plate along, up "
        "and round. The paper gives the kinematics, singularities and workspaces. Below is every "
        "number that it prints beside the same number here, and its errata."
    ),
    parts=_PARTS,
    claims=CLAIMS,
    errata=ERRATA,
    components=_COMPONENTS,
    drawings=DRAWINGS,
    pictures=pictures,
    missing=_MISSING,
)
