"""The levelling platform's chapter: the machine's work, then its model."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.drawing import View, photograph
from parapod.diagrams.levelling_platform.model import DRAWN, add_platform, add_visualization
from parapod.sims.levelling_platform.report.claims import CLAIMS
from parapod.sims.levelling_platform.report.drawings import DRAWINGS
from parapod.sims.levelling_platform.report.errata import ERRATA
from parapod.sims.output.rendered import rendered
from parapod.sims.report.chapter import Chapter, Component, FutureWork, Part, Picture
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.model import PlatformModel, standing_pose

_HEIGHT = 0.477  # in the middle of what the stroke allows [m]
_GROUND = (math.radians(2.0), math.radians(3.0))
_UPRIGHT, _LEANING = (0.0, 0.0), (0.0, math.radians(35.0))
# From so far that lines parallel in space nearly stay so [m].
_FAR = 30.0


def pictures() -> tuple[Picture, ...]:
    """The whole machine at work, and its front and top view.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _photograph(
    views: Sequence[View], ground: tuple[float, float], arm: tuple[float, float]
) -> list[NDArray[np.uint8]]:
    """Pictures of the platform, level on plane ground, and its arm [rad]."""
    level = (0.0, 0.0, _HEIGHT)
    extension, pose = inverse_kinematics(DRAWN, level, ground), standing_pose(level, ground)

    def add_model(
        plant: MultibodyPlant, builder: DiagramBuilder, scene_graph: SceneGraph
    ) -> PlatformModel:
        model = add_platform(plant, "full", ground=ground)
        add_visualization(builder, model, plant.get_state_output_port(), scene_graph, None)
        return model

    return photograph(
        views,
        add_model,
        lambda model, context: model.plant.SetPositions(
            context, model.positions_at(extension, pose, arm)
        ),
    )


def _take() -> tuple[Picture, ...]:
    whole = View((2.9, -5.9, 1.9), (0.08, 0.0, 0.96), angle=0.50, size=(1280, 1080))
    front = View((0.0, -_FAR, 0.6), (0.0, 0.0, 0.40), angle=0.033, size=(1280, 640))
    top = View(
        (0.0, 0.0, _FAR), (0.0, 0.0, 0.3), angle=0.052, size=(1280, 1000), up=(0.0, 1.0, 0.0)
    )
    (at_work,) = _photograph([whole], _GROUND, _LEANING)
    from_front, from_top = _photograph([front, top], (0.0, 0.0), _UPRIGHT)
    return (
        Picture(
            "The platform",
            "Level on ground that rolls by 2 and pitches by 3 deg, its arm leaning by 35 deg "
            "(in the place of Figs. 3, 12a and 19).",
            at_work,
        ),
        Picture("Front", "Front view (Fig. 1a).", from_front),
        Picture("Top", "Top view (Fig. 1b).", from_top),
    )


# The bounds hold at this step too.
_COARSE = ("plant.time_step=0.01",)
# A job that is over soon.
_ENGINES = (
    "job.settled_after=1",
    "job.waypoints=[{time: 1, roll_deg: 1, height_mm: 3}]",
    "job.arm={start: 2, duration: 0.5}",
    "job.end=3",
)

_PARTS = (
    Part(
        "deploy",
        "The whole operation",
        "The platform drives to a place, lowers its legs until they touch, levels itself and "
        "takes a posture, on ground that is inclined and uneven, and drives away again. A "
        "supervisor leads it. The paper describes this use in three sentences.",
        "deploy",
        quick=(
            "plant.leg_model=reduced",
            "plant.time_step=0.01",
            "drive.distance_m=0.05",
            "work.hold_s=0.5",
        ),
        source="section 2.2",
    ),
    Part(
        "level",
        "The whole job",
        "The platform estimates the slope of unknown ground, levels itself, follows postures and "
        "holds while the arm swings, with noise, biases, friction and gains off by up to 15 % at "
        "once. The paper has neither noise nor friction.",
        "level",
        quick=_COARSE,
    ),
    Part(
        "track-posture",
        "The control of the posture",
        "Three machines follow postures: legs as drawn, legs as built, and legs as built with "
        "the outer inclination loop that the paper leaves as its next step.",
        "track-posture",
        quick=(
            *_COARSE,
            "job.settled_after=5",
            "job.waypoints=[{time: 5.5, roll_deg: 2, pitch_deg: -1, height_mm: 15}]",
            "job.end=13",
        ),
        source="section 6.4",
    ),
    Part(
        "uneven-ground",
        "Uneven ground",
        "The feet stand at heights that differ by 40 mm. The paper assumes a plane.",
        "uneven-ground",
        quick=_COARSE,
    ),
    Part(
        "fault-campaign",
        "Faults",
        "Every kind of fault is injected into every device in every phase of the operation: "
        "which finding follows, after how long, and how the machine reacts. The paper injects "
        "none.",
        "fault-campaign",
        quick=("device=encoder", "phase=posture", "window=3"),
        quick_text="Every kind of fault is injected into an encoder while the platform takes a "
        "posture: which finding follows, after how long, and how the machine reacts. The whole "
        "campaign has every device and phase.",
        is_random=False,
    ),
    Part(
        "calibrate",
        "Calibration",
        "30 recorded poses give the true lengths of the legs. The paper explains its errors by "
        "legs that are not equal, and does not measure them.",
        "calibrate",
    ),
    Part(
        "validate-kinematics",
        "The kinematic model",
        "Eqs. (10) to (12), solved in closed form, are compared with a plant of rigid bodies "
        "with closed loops and contact: with legs as drawn, and with every length off by up to "
        ".5 mm and every angle by up to .2 deg. The paper compares them with a co-simulation on "
        "ground of 5 deg and with its prototype.",
        "validate-kinematics",
        quick=(
            "plant.time_step=0.002",
            "job.settled_after=1",
            "job.waypoints=[{time: 1.5, roll_deg: 2, pitch_deg: -2, height_mm: 10}]",
            "job.end=3",
        ),
        source="section 3.3",
    ),
    Part(
        "workspace",
        "The workspace",
        "Positions that the tip of the upright arm reaches: exact, in closed form, with their "
        "volume, beside the eight surfaces that the paper prints. `--html FILE` writes a picture "
        "to turn.",
        "workspace",
        quick=("resolution=40",),
        is_random=False,
        source="section 4",
    ),
    Part(
        "turntable",
        "The turntable",
        "A motor in the arm's base turns the arm. The prototype has it; the paper leaves it for "
        "future work.",
        "workspace",
        ("turntable=true",),
        quick=("resolution=40",),
        is_random=False,
        adds_to="workspace",
    ),
    Part(
        "push",
        "How hard it can be pushed",
        "A push of a third of a second against the levelled platform, in four directions, until "
        "it shows that a bound of its levelling breaks.",
        "push",
        ("at=23",),
        quick=(
            *("backend=kinematic", "directions=2", "share=1", "first_N=50", "most_N=100", "at=9"),
            "settings=[job.estimate_at=1.5, job.settled_after=1.5, 'job.waypoints=[]', "
            "'job.arm={start: 0.5, duration: 0.5}', job.end=12]",
        ),
    ),
    Part(
        "arm-workspace",
        "Reach and sag of the arm",
        "Points that the tip of the slender arm reaches, sagging, where it leans: by the height "
        "of the platform, by all of its postures, and without the turntable. The paper has those "
        "of the upright arm.",
        "arm-workspace",
        is_random=False,
    ),
    Part(
        "arm-vibration",
        "The flexible arm",
        "The paper takes its slender arm for rigid, and leaves its flexibility to future work. "
        "Here it bends: two modes in each plane, with sag, wrench and vibration, behind every "
        "plant. Input shapers end a swing of 45 deg in a second without vibration, and so do legs "
        "that incline the platform.",
        "arm-vibration",
        quick=("backend=kinematic",),
    ),
    Part(
        "inspect",
        "The tip put to points",
        "The paper's third task of the machine, to help in the positioning of the tip, which it "
        "leaves to future work together with the coupling of platform, turntable and arm. Here "
        "they are one chain: arm and turntable do what they can, the legs what is left, and "
        "encoders and inertial sensor tell where the tip is.",
        "inspect",
        quick=(
            "backend=kinematic",
            "inspection.points=[{place_mm: [1030, 20, 2360]}, {place_mm: [930, 1620, 1430]}]",
        ),
    ),
    Part(
        "tip-hold",
        "The tip held in a point",
        "Ground gives way under a foot, the platform is pushed, the tip takes a payload: the legs "
        "bring it back. The paper's task of making the arm stand firmly, and of helping its tip, "
        "at once.",
        "tip-hold",
        quick=(
            "backend=kinematic",
            "disturbances=[!Subsidence {at: 15, foot: 3}, !Payload {at: 22}]",
            "hold.end_s=32",
        ),
    ),
    Part(
        "identify-arm",
        "The arm's vibration",
        "Frequency and damping of the arm from the legs alone: they jerk the platform and lift "
        "it, and their voltages tell how the rod swings.",
        "identify-arm",
        quick=("backend=kinematic",),
    ),
    Part(
        "identify-actuators",
        "The actuators",
        "Ten voltage steps with legs lifted and under the platform's weight give K from voltages "
        "and encoders alone.",
        "identify-actuators",
        quick=_COARSE,
        source="section 5.2",
    ),
    Part(
        "slip",
        "Slip of the feet",
        "The legs lift the platform, then they are braked and the arm swings by 45 deg in a "
        "second. The solver's own creep on inclined ground is measured apart from it. (The "
        "caption printed below Fig. 23 is that of Fig. 5.)",
        "slip",
        quick=("plant.time_step=0.002",),
        source="section 7",
    ),
    Part(
        "compare-engines",
        "Two engines",
        "Drake and MuJoCo simulate the same bodies, drives and commands. The paper relies on one "
        "co-simulation.",
        "compare-engines",
        quick=("steps_ms=[4, 2]", "plant.time_step=0.002", *_ENGINES),
        is_random=False,
    ),
)

_COMPONENTS = (
    Component("Embedded controller NI PXIe-1082", "the controller's diagram", "at 100 Hz"),
    Component(
        "Two NI PXIe-6363",
        "the station's ports",
        "NiDaqLegs and NiDaqEncoders drive the real ones",
    ),
    Component("Four linear actuators", "LinearActuator", "Eqs. (15) to (18), self-locking screw"),
    Component("Two motor drivers Sabertooth 2x25", "LinearActuator", "supply and saturation"),
    Component("Four actuator encoders", "Encoder", "whole counts"),
    Component("Four Maxon motors, gear 26, and EPOS2 24/5", "VelocityServo", "velocity and brake"),
    Component("Twelve limit switches", "LimitSwitches", "extended, retracted, ground contact"),
    Component(
        "Inertial sensor ADIS16448", "Imu", "noise, biases, ranges and counts of its data sheet"
    ),
    Component("Optical tracking system", "PlatformTruth", "the simulation's truth"),
    Component("Arm, 2.02 m, with camera", "Rod, FlexibleArm", "rigid, or as it bends"),
)

_MISSING = (
    "The prototype. Where the paper measures it, a plant of rigid bodies stands here, whose legs "
    "are off by drawn errors; its noise, friction and masses are assumptions that keep what the "
    "paper prints of them.",
    "The curves themselves. The paper shows its trajectories only as pictures, so the figures "
    "follow trajectories of the same kind, not the same ones, and are compared by their errors.",
    "Data of the arm's flexibility. Its bending stiffness and damping are assumptions, those of a "
    "tube of carbon fibre; but for its own part the arm is rigid here, as in the paper.",
    "The photographs (Figs. 3, 7a and 19): rendered pictures of the model stand in their place.",
    "Eq. (13) is lost in print; the arm's base is fitted to the workspace's eight surfaces.",
)

_FUTURE = (
    FutureWork(
        "sections 7 and 8",
        "an outer loop that feeds back the inertial sensor, against errors of the kinematics",
        "The outer loop brings roll and pitch of legs as built within the sensor's own error.",
        ("track-posture",),
    ),
    FutureWork(
        "section 8",
        "the motor in the base, which turns the arm and makes the workspace larger",
        "The turntable's workspace is computed, its drive moves the arm in every job, and the "
        "stability monitor counts it.",
        ("turntable", "inspect"),
    ),
    FutureWork(
        "section 8",
        "the arm's flexibility in the definition of the workspace",
        "The tip's place counts the sag of the rod in closed form, 52 mm when it is horizontal, "
        "and the inverse kinematics makes it good.",
        ("inspect",),
    ),
    FutureWork(
        "section 7",
        "interaction of manipulator and platform",
        "The wrench of the moving, bending arm acts on platform, legs and feet; shapers, and the "
        "legs by themselves, end its vibration, and the legs' voltages tell its frequency.",
        ("arm-vibration", "identify-arm", "slip"),
    ),
    FutureWork(
        "sections 1 and 8",
        "the third task: the legs help in the positioning of the tip",
        "Platform, turntable and arm bring the tip to points as one chain, within millimetres, "
        "and the legs hold it there while ground gives way.",
        ("inspect", "tip-hold"),
    ),
)

CHAPTER = Chapter(
    title="The levelling platform",
    paper=(
        "D. Feliu-Talegon, A. San-Millan and V. Feliu-Batlle, A New Kinematic Model and Control "
        "Strategy for a Mobile Platform for Transporting Lightweight Manipulators, Applied "
        "Sciences 8 (2018) 2612"
    ),
    summary=(
        "A platform of 50 kg drives to a place, lowers four legs, each a parallelogram with a "
        "linear actuator on its diagonal, measures how the ground slopes, levels itself and "
        "carries a light arm of 2 m. The machine and its work come first; the paper's model, "
        "actuators and workspace follow, then each number that it prints beside the same here."
    ),
    parts=_PARTS,
    claims=CLAIMS,
    errata=ERRATA,
    components=_COMPONENTS,
    components_in="Fig. 2",
    drawings=DRAWINGS,
    pictures=pictures,
    missing=_MISSING,
    future=_FUTURE,
)
