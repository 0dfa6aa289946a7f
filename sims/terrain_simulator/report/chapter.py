"""The terrain simulator's chapter: its kinematics, singularities and workspaces."""

import math

from parapod.diagrams.drawing import View
from parapod.diagrams.terrain_simulator.model import photograph
from parapod.sims.output.rendered import rendered
from parapod.sims.report.chapter import Chapter, Component, Part, Picture
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


# The shortest walk.
_SHORT = ("gait.strides=1", "gait.run_up=0", "begin=0.1", "shift=0.1", "end=0.05")

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
    Part(
        "bench-walk",
        "A walking trot on the pedal (section 2, Fig. 2)",
        "The paper derives its specification from the ground reaction forces of a simulated "
        "quadruped of 120 kg, which it shows as curves. Here one leg of such a robot trots at "
        "1.5 m/s on the pedal: the plate gives it its footholds, the slide carries a quarter of "
        "the body, and its drive plays the other legs. The forces stand beside the laws that bind "
        "them.",
        "bench-walk",
        quick=(*_SHORT, "gait.speed_m_s=0.8"),
    ),
    Part(
        "bench-walk-flying",
        "A flying trot on the treadmill (section 2, Figs. 2 and 3)",
        "The fastest motion that the paper names, 2.75 m/s. On the pedal it is possible at the "
        "limit only; the treadmill, whose belt carries the foot back, has room for it.",
        "bench-walk",
        ("configuration=treadmill", "gait.speed_m_s=2.75", "gait.duty=0.4", "gait.ramp=0.3"),
        quick=(*_SHORT, "gait.speed_m_s=1"),
    ),
    Part(
        "bench-course",
        "Slopes, stairs and steps, on the bench and in the world",
        "The paper names the terrains that the bench is for and plays none. Here each is walked "
        "twice by the same leg with the same controller: on the plate that plays it, and over the "
        "terrain itself, laid out in the world. That both agree is what makes the bench right.",
        "bench-course",
        quick=("courses=[slope down 20]", "strides=1", "run_up=0"),
        quick_text="One slope alone, on the bench and in the world.",
        is_random=False,
    ),
    Part(
        "bench-leg",
        "Legs of somebody's own (section 3)",
        "The bench is for legs of any structure that move in a plane. Here one of three joints, "
        "described by a URDF, is looked at, steps, and jumps by 0.3 m, which is what Table 1's "
        "vertical speed of 2.5 m/s is for; and the leg of the walking chair, which is a parallel "
        "mechanism itself, stands and steps.",
        "bench-leg",
        quick=("jump_mm=100", "strides=1", "tries=[step, jump]"),
    ),
)

_COMPONENTS = (
    Component(
        "PRR mechanism", "forward_kinematics, inverse_kinematics", "closed form, both modes"
    ),
    Component("Mechanical stops", "margins", "every limit's distance; least heights are assumed"),
    Component("Sliders, links, strut", "rail.urdf", "two loops closed by ball constraints"),
    Component("Pedal, treadmill", "pedal.urdf, treadmill.urdf", "masses are assumed"),
    Component("Vertical slide P_1", "column.urdf, slide.urdf, HipSupport", "masses are assumed"),
    Component(
        "Leg under test", "leg.urdf, FootImpedance", "of a 120 kg quadruped; any other URDF"
    ),
    Component("Treadmill's belt", "BeltSurface", "a surface that moves; lag of 10 ms assumed"),
    Component("Structure parameters", "BenchGeometry", "Table 2, its l_5 of the treadmill mended"),
)

_MISSING = (
    "Fig. 2: ground reaction forces of a 120 kg quadruped, whose curves are not in numbers; those "
    "of a leg that trots are here, beside the laws that bind them.",
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
