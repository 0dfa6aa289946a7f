"""The machining centres' chapter: experiments in the paper's order."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.diagrams.drawing import View, photograph
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.sims.machining_centre.report.claims import CLAIMS
from parapod.sims.machining_centre.report.drawings import DRAWINGS
from parapod.sims.machining_centre.report.errata import ERRATA
from parapod.sims.output.rendered import rendered
from parapod.sims.report.chapter import Chapter, Component, Part, Picture
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import Swing
from parapod.systems.machining_centre.paths import foot_at
from parapod.systems.machining_centre.platform_mode import displacement

_VIEW = View((0.95, -1.15, 0.75), (0.0, 0.0, 0.25), angle=0.48, size=(900, 1100))
_WALKED = View((1.25, -1.25, 0.80), (0.1, 0.0, 0.26), angle=0.52, size=(900, 1000))
_POSES = {3: (0.0, 0.0, 0.48, 0.0, 0.0, 0.0), 4: (0.03, 0.0, 0.47, 0.1, 0.05, 0.1)}


def pictures() -> tuple[Picture, ...]:
    """Tripod and quadruped.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _photograph(
    view: View, geometry: CentreGeometry, pose: ArrayLike, feet: ArrayLike | None = None
) -> NDArray[np.uint8]:
    """Picture of a centre at a pose; its feet are in the paper's pattern unless told."""
    (picture,) = photograph(
        [view],
        lambda plant, *_: add_centre(plant, geometry),
        lambda centre, context: centre.stand(context, pose, feet),
    )
    return picture


def _take() -> tuple[Picture, ...]:
    tripod, quadruped = (
        _photograph(_VIEW, CentreGeometry(limbs), pose) for limbs, pose in _POSES.items()
    )
    return (
        Picture(
            "The tripod", "Six legs, all feet clamped (in the place of Figs. 1 and 3).", tripod
        ),
        Picture("The quadruped", "Eight legs, the platform tilted (Fig. 3).", quadruped),
        *_walk(),
    )


def _walk() -> Iterator[Picture]:
    """Limbs of a tripod in the middle of their swings (in the place of Fig. 8)."""
    scenario = CentreScenario()
    scenario.walk.advance_mm, scenario.walk.steps, scenario.holes.count = 202.0, 1, 0
    geometry, plan = scenario.machine.geometry, scenario.plan
    feet = plan.beginning.feet
    for operation in plan.job.operations:
        if not isinstance(operation, Swing) or operation.way is None:
            continue
        limb, way, before = (
            operation.lock_set.limb,
            operation.way,
            feet[operation.lock_set.limb - 1],
        )
        by = displacement(before, operation.foothold)
        feet = feet.copy()
        feet[limb - 1] = foot_at(before, operation.foothold, by, plan.job.lift, 0.5)
        picture = _photograph(_WALKED, geometry, way[len(way) // 2], feet)
        locked = ", ".join(
            f"q_{joint} of limb {other}" for other, joint in operation.lock_set.standing
        )
        yield Picture(
            f"Limb {limb} swings",
            f"Half way, 30 mm above the panel; locked besides its own joints: {locked} (in the "
            "place of Fig. 8).",
            picture,
        )
        feet[limb - 1] = operation.foothold


_KINEMATIC = "backend=kinematic"
_QUICK = (
    *(_KINEMATIC, "holes.count=0", "motion.swing_mm_s=150", "motion.acceleration_mm_s2=2000"),
    "control.settling=0.05",
)
_PARTS = (
    Part(
        "centre-machining",
        "Machining",
        "A tripod of rigid bodies drills a row of inclined holes into a panel of 3 m radius, "
        "with the drill's thrust and torque; every hole is checked against the wrench index "
        "before it is begun. The paper drills none.",
        "centre-machining",
        quick=(_KINEMATIC, "holes.count=1"),
        source="section V-A, Fig. 7",
    ),
    Part(
        "centre-machining-quadruped",
        "Machining with the quadruped",
        "The same holes with eight legs.",
        "centre-machining",
        ("machine.limbs=4",),
        quick=(_KINEMATIC, "holes.count=1"),
    ),
    Part(
        "centre-walk",
        "Walking",
        "Machining, reconfiguration, a swing of each limb and machining again, as in the phases "
        "of Fig. 7: the plan is searched, the bodies are rigid, the legs yield, and the feet are "
        "clamped where they arrive. The paper shows one walk as a picture, without numbers.",
        "centre-walk",
        quick=(*_QUICK, "walk.advance_mm=60"),
        source="section V-B and C, Figs. 7 and 8",
    ),
    Part(
        "centre-walk-quadruped",
        "Walking with the quadruped",
        "The same walk with eight legs, three limbs of which hold the platform without any lock.",
        "centre-walk",
        ("machine.limbs=4",),
        quick=(*_QUICK, "walk.advance_mm=60"),
    ),
    Part(
        "centre-push",
        "How hard it can be pushed",
        "A push of a third of a second against the platform while it drills, in four directions, "
        "until a bound of the machining breaks.",
        "push",
        ("experiment=centre-machining", "at=15.5"),
        quick=(
            *("directions=2", "share=1", "first_N=50", "most_N=100", "at=4.5"),
            "settings=[holes.count=1]",
        ),
        is_random=False,
    ),
    Part(
        "centre-locks",
        "Locked joints",
        "The joints that are locked while a foot swings decide whether the foot can be led and "
        "whether the platform is held. Every pair is tried, by kinematics and with rigid bodies. "
        "The paper locks q_1 of both standing limbs and leaves the choice to future work.",
        "centre-locks",
        quick=("poses=50",),
        source="sections V-C and VII",
    ),
    Part(
        "centre-workspace",
        "Workspace and wrenches",
        "Positions that the upright platform reaches, and the wrenches that it resists there. "
        "Cells are made smaller until the result stays; the grid that gives the paper's first "
        "row stands beside them, since the paper does not print its own.",
        "centre-workspace",
        quick=("cell_mm=25",),
        is_random=False,
        source="section VI, Tables I and II, Figs. 11 and 12",
    ),
)

_COMPONENTS = (
    Component("Branches", "limb.urdf", "hinge, two legs in a closed loop, ankle; masses assumed"),
    Component("Prismatic actuators", "PositionServo", "position loop, speed, stroke, 10 N/um"),
    Component("Lockers", "Locking", "joints that Drake locks, at rest; they hold without play"),
    Component("Clamping devices", "clamp.urdf", "a weld between foot and clamp, put where it is"),
    Component("Sequence of phases", "CentreSequencer", "one table of phases, and what ends each"),
    Component("IKM in PP and BE mode", "CentreFeedforward", "lengths a period ahead"),
    Component("Payload platform", "platform.urdf", "10 kg with its spindle: assumed"),
)

_MISSING = (
    "Table I above the threshold 0, and the means of Table II: no reading of the stated formulas "
    "gives them, and two of the means are impossible (see the errata). Tried: moments about B_O, "
    "about points below and above P_O, about the feet and the pivots, four other lengths for r_c, "
    "both weightings of the forces, boxes at five heights, sampled directions. What holds are the "
    "trends: the tripod reaches a little more, the quadruped resists more at each threshold, its "
    "eta_w is lower.",
    "The heights of the sections in Fig. 12, and the walk of Figs. 7 and 8 itself: these are "
    "pictures without numbers. The walk here has its phases.",
    "A walk with the paper's locks: where the platform is parallel to the panel they leave the "
    "foot's pose open (see the locked joints), so that the plan finds others.",
    "What Figs. 1, 2, 9 and 10 show: an artist's view, another robot, screws and a mapping.",
)

CHAPTER = Chapter(
    title="The machining centres",
    paper=(
        "H. Yang, S. Krut, C. Baradat and F. Pierrot (Fatronik France Tecnalia and LIRMM), A new "
        "concept of self-reconfigurable mobile machining centers"
    ),
    summary=(
        "A tripod and a quadruped, two prismatic actuators a limb, machine in six axes with all "
        "feet clamped, and walk: passive joints are locked, one foot is unclamped, and all legs "
        "together swing it. The paper gives the kinematics of both modes and compares what the "
        "two machines reach and resist. The machines and their work come first, then each number "
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
