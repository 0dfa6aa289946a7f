"""The walking chair's chapter: experiments in the paper's order."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.drawing import View, photograph
from parapod.diagrams.walking_chair.model import add_chair
from parapod.sims.output.rendered import rendered
from parapod.sims.report.chapter import Chapter, Component, Part, Picture
from parapod.sims.walking_chair.report.claims import CLAIMS
from parapod.sims.walking_chair.report.drawings import DRAWINGS
from parapod.sims.walking_chair.report.errata import ERRATA
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger

# From so far that lines parallel in space nearly stay so [m].
_FAR = 30.0
_MID_SWING = 7.5  # middle of the swing of legs 1 and 3 [s]


def pictures() -> tuple[Picture, ...]:
    """The chair at a step, and its side and top view.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _photograph(views: Sequence[View], passenger: Passenger) -> list[NDArray[np.uint8]]:
    """Pictures of the chair in the middle of a swing; a passenger without mass is not seen."""
    geometry = ChairGeometry()
    motion = Walk().motion(geometry, _MID_SWING)
    body = motion.body.position
    lengths = chair_inverse(geometry, body, np.eye(3), motion.feet.position, motion.references)
    return photograph(
        views,
        lambda plant, *_: add_chair(plant, passenger, geometry),
        lambda chair, context: chair.stand(context, lengths, body, passenger),
    )


def _take() -> tuple[Picture, ...]:
    whole = View((2.6, 2.9, 1.6), (0.0, 0.05, 0.86), angle=0.53, size=(1000, 1280))
    side = View((_FAR, 0.0, 0.9), (0.0, 0.05, 0.90), angle=0.068, size=(1000, 1280))
    front = View((0.0, _FAR, 0.9), (0.0, 0.0, 0.74), angle=0.055, size=(1000, 1280))
    at_step, from_side = _photograph([whole, side], Passenger())
    (from_front,) = _photograph([front], Passenger(0.0))
    return (
        Picture(
            "The chair",
            "Legs 1 and 3 swing while 2 and 4 carry chair and passenger (in the place of Figs. 2 "
            "and 18).",
            at_step,
        ),
        Picture("Side", "Side view at the same instant (Fig. 16b).", from_side),
        Picture("Front", "Without a passenger, from the front (Fig. 2).", from_front),
    )


_PARTS = (
    Part(
        "chair-walk",
        "Walking with a passenger",
        "Four legs with closed loops, contact and a passenger of 57 kg, forward and back.",
        "chair-walk",
        quick=("plant.time_step=0.005", "gait.way=forward"),
        source="Figs. 15 to 18",
    ),
    Part(
        "chair-gait",
        "The trotting gait",
        "Lengths, speeds and accelerations of all twelve branches, for the body's motion as it "
        "is printed (Eq. 45) and for one without steps of the velocity.",
        "chair-gait",
        is_random=False,
        source="Fig. 8",
    ),
    Part(
        "chair-circle",
        "A foot on a circle",
        "Drives with a lag, gains that are off and an encoder lead one foot on a circle in the "
        "three modes that the paper compares in words. The paper measures it with a laser "
        "tracker.",
        "chair-circle",
        is_random=False,
        source="Eq. 49, Figs. 11 and 14",
    ),
    Part(
        "chair-payload",
        "How much it carries",
        "The largest payload over the gait by linear programming, beside the paper's, which is "
        "measured by the rated current.",
        "chair-payload",
        is_random=False,
        source="Eqs. 50 to 55",
    ),
    Part(
        "chair-push",
        "How hard it can be pushed",
        "A push of a third of a second against the body of the chair with its passenger, while "
        "two feet stand, in four directions, until a bound of the walk breaks.",
        "push",
        ("experiment=chair-walk",),
        quick=(
            *("directions=2", "share=1", "first_N=50", "most_N=50", "asked_N=50"),
            "settings=[plant.time_step=0.005, gait.way=forward]",
        ),
        is_random=False,
    ),
    Part(
        "chair-engines",
        "Two engines",
        "Drake and MuJoCo simulate the same bodies, drives and gait.",
        "chair-engines",
        quick=(
            "steps_ms=[4]",
            "plant.time_step=0.004",
            "gait.lift_mm=20",
            "gait.step_mm=20",
            "gait.swing_height_mm=10",
            "gait.phase_duration=1",
        ),
        is_random=False,
    ),
)

_COMPONENTS = (
    Component("Four 2-UPS+UP legs", "leg.urdf", "two loops each, closed by ball constraints"),
    Component("Twelve linear actuators", "VelocityServo", "lag, speed, stroke, encoder: assumed"),
    Component(
        "Twelve controllers and drivers",
        "CompoundPositionController",
        "position, velocity and compound mode (Eqs. 46 to 48)",
    ),
    Component("Seat and connection plate", "body.urdf", "mass as weighed, spread by assumption"),
    Component("Passenger", "passenger.urdf", "a mass at a place"),
    Component("Leica laser tracker", "leg_forward", "the foot from the true lengths"),
    Component("Current measurement", "PayloadEstimator", "Eq. (55)"),
    Component("Host computer, CAN bus", "GaitPlanner, ChairFeedforward", "nodes at 100 Hz"),
)

_MISSING = (
    "The arrangement of the legs (Fig. 4) is in a figure alone: the UP branches stand outwards "
    "here, the only way in which feet of one side do not meet.",
    "The curves of Figs. 8, 11, 14 and 17 are pictures: compared are ranges and statements.",
    "The measured 2.454 mm of Fig. 14: control leaves .5 mm; a branch that is .5 mm off its "
    "homing position, or play, leaves 2.5 mm.",
    "The measured 57 kg: the rated current is reached when one branch carries .82 of its leg's "
    "load, between the best distribution of forces and a foot on one corner. What share it has "
    "depends on stiffnesses that are not printed; here all branches are equally stiff.",
    "What Figs. 1, 9, 10, 12, 13, 15 and 19 show, which is a human leg, electronics, the control "
    "scheme, instruments, numbers of legs and a scale: they are said in words above.",
    "Eq. (53) with its torque, efficiency, ratio and lead, which are not printed: its 427.3 N "
    "are used.",
)

CHAPTER = Chapter(
    title="The walking chair",
    paper=(
        "L. Sang, H. Wang, H. Yu and L. Vladareanu, A novel human-carrying quadruped walking "
        "robot, International Journal of Advanced Robotic Systems 14 (2017), "
        "doi 10.1177/1729881417716592"
    ),
    summary=(
        "A chair of 49 kg stands on four legs, each a 2-UPS+UP parallel mechanism, and carries a "
        "passenger with a trotting gait on flat feet. The walk comes first, then gait, control "
        "and payload, then each number that the paper prints beside the same here."
    ),
    parts=_PARTS,
    claims=CLAIMS,
    errata=ERRATA,
    components=_COMPONENTS,
    drawings=DRAWINGS,
    pictures=pictures,
    missing=_MISSING,
)
