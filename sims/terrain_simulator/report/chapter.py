"""The terrain simulator's chapter: its kinematics, singularities and workspaces."""

import math

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.drawing import View, photograph
from parapod.diagrams.terrain_simulator.model import add_bench
from parapod.sims.output.rendered import rendered
from parapod.sims.report.chapter import Chapter, Component, Part, Picture
from parapod.sims.terrain_simulator.report.claims import CLAIMS
from parapod.sims.terrain_simulator.report.drawings import DRAWINGS
from parapod.sims.terrain_simulator.report.errata import ERRATA
from parapod.systems.terrain_simulator.geometry import BenchGeometry

_VIEW = View((1.5, -2.6, 1.15), (0.60, 0.0, 0.08), angle=0.37, size=(1280, 900))


def pictures() -> tuple[Picture, ...]:
    """Both benches.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _photograph(geometry: BenchGeometry, pose: tuple[float, float, float]) -> NDArray[np.uint8]:
    """Picture of a bench in a pose of its plate [m, m, rad]."""
    (picture,) = photograph(
        [_VIEW],
        lambda plant, *_: add_bench(plant, geometry),
        lambda bench, context: bench.stand(context, pose),
    )
    return picture


def _take() -> tuple[Picture, ...]:
    pedal = _photograph(BenchGeometry.pedal(), (0.5, 0.29, math.radians(15.0)))
    treadmill = _photograph(BenchGeometry.treadmill(), (0.8, 0.26, math.radians(-7.0)))
    return (
        Picture("The pedal", "Front end down by 15 deg (in the place of Fig. 1).", pedal),
        Picture("The treadmill", "Front end up by 7 deg (in the place of Fig. 3).", treadmill),
    )


# The shortest walk.
_SHORT = ("gait.strides=1", "gait.run_up=0", "begin=0.1", "shift=0.1", "end=0.05")

_PARTS = (
    Part(
        "bench-walk",
        "A walking trot on the pedal",
        "One leg of a quadruped of 120 kg trots at 1.5 m/s on the pedal: the plate gives it its "
        "footholds, the slide carries a quarter of the body, and its drive acts for the other "
        "legs. The forces are checked by the laws of mechanics. The paper derives its "
        "specification from such forces and shows them as curves.",
        "bench-walk",
        quick=(*_SHORT, "gait.speed_m_s=0.8"),
        source="section 2, Fig. 2",
    ),
    Part(
        "bench-walk-flying",
        "A flying trot on the treadmill",
        "2.75 m/s is the fastest motion that the paper names. The pedal reaches it just before "
        "its limit; the treadmill, whose belt carries the foot back, has room for it.",
        "bench-walk",
        (
            "machine.configuration=treadmill",
            "gait.speed_m_s=2.75",
            "gait.duty=0.4",
            "gait.ramp=0.3",
        ),
        quick=(*_SHORT, "gait.speed_m_s=1"),
        source="section 2, Figs. 2 and 3",
    ),
    Part(
        "bench-course",
        "Slopes, stairs and steps, on the bench and in the world",
        "The same leg with the same controller walks each terrain twice: on the plate that plays "
        "it, and over the terrain itself. The bench is right if both agree. The paper names "
        "these terrains and plays none.",
        "bench-course",
        quick=("courses=[slope down 20]", "strides=1", "run_up=0"),
        quick_text="One slope alone, on the bench and in the world.",
        is_random=False,
    ),
    Part(
        "bench-leg",
        "Other legs",
        "The bench is for legs of any structure that move in a plane. A leg of three joints, "
        "described by a URDF, is examined, steps, and jumps by 0.3 m, for which Table 1 has its "
        "vertical speed of 2.5 m/s; and the leg of the walking chair, a parallel mechanism "
        "itself, stands and steps.",
        "bench-leg",
        quick=("jump_mm=100", "strides=1", "tries=[step, jump]"),
        source="section 3",
    ),
    Part(
        "bench-workspace",
        "Workspaces and singularities",
        "Exact workspaces of both benches, with and without a distance from the singularities, "
        "and the part of Table 1 that they contain, box by box. The paper shows them in three "
        "orientations and concludes that Table 2 fulfils Table 1.",
        "bench-workspace",
        is_random=False,
        source="section 4, Tables 1 and 2, Fig. 6",
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
        "and round. Walks, runs and courses come first, then the workspaces and each number "
        "that the paper prints beside the same here."
    ),
    parts=_PARTS,
    claims=CLAIMS,
    errata=ERRATA,
    components=_COMPONENTS,
    drawings=DRAWINGS,
    pictures=pictures,
    missing=_MISSING,
)
