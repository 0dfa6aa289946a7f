"""The terrain simulator's chapter: its kinematics, singularities and workspaces."""

from parapod.sims.report.chapter import Chapter, Component, Part
from parapod.sims.terrain_simulator.report.claims import CLAIMS
from parapod.sims.terrain_simulator.report.drawings import DRAWINGS
from parapod.sims.terrain_simulator.report.errata import ERRATA

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
    Component("Pedal, treadmill", "BenchGeometry", "Table 2, its l_5 of the treadmill mended"),
)

_MISSING = (
    "Figs. 1 and 2: a picture of the bench, and ground reaction forces of a 120 kg quadruped, "
    "whose curves are not in numbers.",
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
    missing=_MISSING,
)
