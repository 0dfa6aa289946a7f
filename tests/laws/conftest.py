"""Every system that `parapod.systems` defines, for the laws of `test_systems.py`.

`ENTRIES` holds what the laws must be told about a class. One that is made with its defaults, and
whose inputs have names of `USUAL`, needs no entry. Devices have laws of their own.

A test of one argument `system_kind` is proved for every class, one of `specimen` for every class
with each of its variants, one of `convertible` for those that convert to AutoDiffXd.
"""

import importlib
import inspect
import math
import pkgutil
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import (
    BusValue,
    Diagram,
    DiagramBuilder,
    LeafSystem,
    PortDataType,
)
from pydrake.systems.scalar_conversion import TemplateSystem

import parapod.systems
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.station import Station
from parapod.diagrams.terrain_simulator.leg import LegDescription, UrdfLeg, make_leg_model
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.diagrams.terrain_simulator.model import add_bench, add_leg_on_slide
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.walking_chair.model import add_chair
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiControllerParams
from parapod.systems.actuators.position_drive import PositionDriveParams
from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.input_shaper import Shaper
from parapod.systems.arm.vibration import LumpedRod
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.levelling_platform.carried_arm import BarredTip, CarriedArm, UnreachableTip
from parapod.systems.levelling_platform.geometry import LegDeviation, PlatformGeometry
from parapod.systems.levelling_platform.inclination_loop import PostureLoopParams
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.scripts import Step, Waypoint
from parapod.systems.levelling_platform.statics import PAPER_ARM, KinematicPlatformParams
from parapod.systems.levelling_platform.supervisor import Command, Phase
from parapod.systems.levelling_platform.wheels import WHEEL_DRIVE, WheelGeometry
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import Job, row_of_holes
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.machining_centre.posture import Posture, lockable_joints
from parapod.systems.machining_centre.sequence import SequenceParams
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.physics.mujoco.model import MujocoModel
from parapod.systems.physics.mujoco.pushes import Place
from parapod.systems.safety.faults import Fault
from parapod.systems.sensors.imu import ImuParams, sample_period
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import slider_places
from parapod.systems.walking_chair.feedforward import NotAtStart
from parapod.systems.walking_chair.gait import Walk, gait_motion, starting_lengths
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.payload import FORCE_LIMIT

ROW = re.compile(r"^\s*\| (in|out) `([a-z_0-9]+)` \|([^|]*)\|([^|]*)\|([^|]*)\|\s*$")

# --- What flows into ports: functions of a generator and a size


def around(centre, *spread):
    """Values that differ in every element from one sample to the next."""
    return lambda random, size: np.array(centre) + np.array(spread) * random.uniform(-1, 1, size)


def one_of(*values):
    return lambda random, size: random.choice(np.array(values, dtype=float), size)


def pose(random, size):
    """A quaternion, not normalised, and as many further numbers as there is room for."""
    return np.array([1.0, *random.uniform(-0.2, 0.2, size - 1)])


def pushing(random, size):
    """Voltages that move an actuator against whatever load there is."""
    return random.choice((-1.0, 1.0), size) * random.uniform(4.0, 7.0, size)


EXTENSIONS = around((0.405,) * 4 + (0.0,) * 4, *(0.004,) * 4, *(0.003,) * 4)
POSTURE = around((0.0, 0.0, 0.477), 0.02, 0.02, 0.003)
NAMED = {
    one_of(0.0, 0.0, 1.0): "emergency_stop",
    around(0.2, 0.15): "operator_age",
    around(0.0, 0.002): "jog_request",
    one_of(
        0.0, 1.0
    ): "brake enable ground_valid halt hold limits posture_control stop trigger trusted",
    one_of(1.0, 1.0, 1.0, 1.0, 1.0, 0.0): "standing",
    one_of(*Command): "operator",
    one_of(*Phase): "phase",
    one_of(0, 1, 2, 3, 4): "severity",
    around(0.405, 0.004): "extension extension_measured",
    around(0.405, 0.001): "measured",
    EXTENSIONS: "extension_desired_state posture_extension_state rod_state",
    around((0.405,) * 3 + (0.0,) * 3, *(0.004,) * 3, *(0.003,) * 3): "active_desired_state",
    around((0.405,) * 4 + (0.0,) * 4, *(0.001,) * 4, *(0.003,) * 4): "desired_state",
    POSTURE: "posture_command posture_request",
    around((0.0, 0.0, 0.477, 0.0, 0.0, 0.0), *(0.02, 0.02, 0.003) * 2): "posture_desired_state",
    around(0.0, 0.02): "attitude",
    around(1e-3, 1e-3): "attitude_error",
    around(0.0, 0.01): "ground ground_estimated gyro leg_rate position_measured position_node",
    around(0.0, 5e-4): "foot_offsets foot_offsets_estimated rising",
    one_of(0.0, 0.5): "payload",
    around((0.0, 0.0, 9.81), 0.1): "accel specific_force",
    around(0.03, 0.03): "age wheel_velocity",
    around(0.0, 0.05): "velocity",
    around(0.0, 0.2): "angular_velocity arm_position arm_request position state velocity_command",
    around(0.0, 1.0): "noise",
    around(0.0, 2.0): "drive_request",
    around(0.5, 0.5): "signal",
    around(5.0, 5.0): "contact_force",
    around(0.0, 20.0): "swing_torque",
    around(0.0, 300.0): "load_force",
    around(0.0, 5.0): "load",
    pose: "base_pose body_pose",
    pushing: "voltage",
}
# By the name of the input.
USUAL: Mapping[str, Callable[..., Any]] = {
    name: sample for sample, names in NAMED.items() for name in names.split()
}
CHAIR, WALK = ChairGeometry(), Walk()
LENGTH = starting_lengths(CHAIR, WALK).ravel()


@cache
def model_of(add):
    """A machine's model, its plant's part of a context, and the root and diagram that own it."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    model = add(plant)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    return model, plant.GetMyMutableContextFromRoot(root), root, diagram


def of_plant(add, port):
    """Value of an output of a model's plant, its feet somewhere about the ground."""

    def sample(random, size):
        model, context, root, diagram = model_of(add)
        if add is add_platform:
            q = model.standing_positions([0.405] * 4, [0.0, 0.0])
        else:
            q = model.standing_positions(LENGTH.reshape(4, 3), START.body.position)
        q[6] -= 4e-3  # the height of the floating body: its feet go into the ground
        q = np.array([*q, *np.zeros(model.plant.num_velocities())])
        model.plant.SetPositionsAndVelocities(context, q + random.uniform(-2e-3, 2e-3, q.size))
        diagram.ExecuteForcedEvents(root, False)  # the plant's step finds the contacts
        value = model.plant.GetOutputPort(port).EvalAbstract(context)
        return value.Clone() if size is None else value.get_value().value()[:size]

    return sample


def in_gait(*names):
    """Parts of a gait's motion at some time, one after another."""

    def sample(random, size):
        motion = gait_motion(CHAIR, WALK.gaits[0], random.uniform(0.0, 10.0))
        return np.concatenate([np.ravel(getattr(getattr(motion, *names), part)) for part in PARTS])

    return sample


@cache
def three_rps():
    """A mechanism of three freedoms from its file."""
    models = Path(__file__).parents[1] / "systems" / "mechanism" / "models"
    return Mechanism.load(models / "three_rps.urdf")


def legs_of_rps(random, size):
    """Lengths of its legs."""
    mechanism = three_rps()
    return mechanism.motor_positions(mechanism.home) + random.uniform(-0.01, 0.01, 3)


def pose_of_rps(random, size):
    """Height, roll and pitch of its platform, and their rates."""
    height = three_rps().pose("platform", three_rps().home).translation()[2]
    return np.array((height, 0.0, 0.0, 0.0, 0.0, 0.0)) + random.uniform(-0.01, 0.01, 6)


def add_tripod(plant):
    return add_centre(plant, TRIPOD)


def add_pedal(plant):
    return add_bench(plant, BenchGeometry.pedal())


def add_pedal_and_leg(plant):
    def add_leg():
        add_leg_on_slide(plant, UrdfLeg(), 30.0)

    return add_bench(plant, BenchGeometry.pedal(), add_more=add_leg)


# Its drives give way by a tenth of a degree when it lies.
SOFT_ARM = replace(
    PAPER_ARM, joints=tuple(replace(joint, compliance=1e-4) for joint in PAPER_ARM.joints)
)
CARRIED = CarriedArm(PlatformGeometry(), KinematicPlatformParams(), margin=0.05)


def tip(random, size):
    """A point within reach, and a direction of view."""
    place = np.add((1.03, 0.02, 2.36), random.uniform(-0.02, 0.02, 3))
    return np.array([*place, 0.5, 0.0, 0.85])[:size]


UPRIGHT = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PARTS = ("position", "velocity", "acceleration")
TRIPOD, HOME = CentreGeometry(), np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
FOOTHOLDS, FOOT = TRIPOD.footholds.ravel(), TRIPOD.footholds[1]
LOCKED_AT = lockable_joints(TRIPOD, Posture(HOME, TRIPOD.footholds)).ravel()
CENTRE = {
    **dict.fromkeys(("pose", "pose_desired", "target", "toward"), around(HOME, 2e-3)),
    "feet": around(FOOTHOLDS, 1e-3),
    "locks_closed": one_of(0.0, 1.0),
    "clamps_closed": one_of(1.0, 1.0, 1.0, 1.0, 0.0),
    "tool_force": around((80.0, 0.5), 80.0, 0.5),
    "position_measured": around(leg_lengths(TRIPOD, HOME), 1e-3),
}
START = gait_motion(CHAIR, WALK.gaits[0], 0.0)
PLATE = np.array((0.5, 0.28, 0.0))
SLIDERS = around(slider_places(BenchGeometry.pedal(), PLATE), 2e-3)
BENCH = {
    **dict.fromkeys(("pose_asked", "pose"), around(PLATE, 2e-3)),
    "position_measured": SLIDERS,
    "position": SLIDERS,
    "plate_motion": around((*PLATE, *(0.0,) * 6), *(2e-3,) * 3, *(0.5,) * 3, *(5.0,) * 3),
    "current": around(0.0, 5.0),
    "force": around((150.0, 150.0, 0.0), 50.0),
}
LEG = {
    "position": around((0.6, -1.2), 0.1),
    "velocity": around(0.0, 1.0),
    "foot_desired": around((0.0, -0.57, 0.0, 0.0, 0.0, 0.0), 0.01),
    "foot_force_desired": around(300.0, 200.0),
    "stance": one_of(0.0, 1.0),
}
HIP = {
    "hip_force": around(0.0, 300.0),
    "hip_desired": around((0.9, 0.0), 5e-3, 0.1),
    "hip_measured": around(0.9, 5e-3),
    "hip_rate": around(0.0, 0.1),
}


@cache
def standing_leg():
    """Plant of a bench on which a leg stands, its part of a context, and what owns both."""
    station = Station(TERRAIN_BENCH, TerrainBenchScenario())
    root = station.CreateDefaultContext()
    for port in TERRAIN_BENCH.inputs:
        station.GetInputPort(port.name).FixValue(root, np.full(port.size, port.idle))
    plant = station.behind.handle.plant.model.plant
    return plant, plant.GetMyMutableContextFromRoot(root), root, station


def of_standing_leg(port):
    """Value of an output of that plant, the foot somewhere in the plate and in some motion."""

    def sample(random, size):
        plant, context, root, station = standing_leg()
        station.reset(root)
        slide = plant.GetJointByName("slide")
        slide.set_translation(context, slide.get_translation(context) - random.uniform(1e-4, 3e-4))
        plant.SetVelocities(context, random.uniform(-0.02, 0.02, plant.num_velocities()))
        if random.integers(2):
            slide.set_translation_rate(context, 0.0)  # it may be locked
        value = plant.GetOutputPort(port).EvalAbstract(context)
        return value.Clone() if size is None else value.get_value().value()[:size]

    return sample


def reactions(random, size):
    """Forces at the joints of a plant that has one."""
    return [SpatialForce(random.uniform(-9.0, 9.0, 3), random.uniform(-300.0, 300.0, 3))]


def translated():
    """A chair for another engine: drives in groups, its passenger a load, a mass put on it."""
    plant, scene_graph = MultibodyPlant(1e-3), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    chair = add_chair(plant)
    plant.SetDefaultPositions(chair.standing_positions(LENGTH.reshape(4, 3), START.body.position))
    loads = (chair.passenger,)
    model = MujocoModel(plant, scene_graph, chair.balls, feet=chair.feet, loads=loads)
    pushed = [
        Place(chair.body, (0.1, 0.0, 0.2)),
        Place(chair.feet[2], (0.0, 0.0, 0.0)),
        Place(chair.body, (0.0, 0.1, 0.2), is_weight=True),
    ]
    return {"model": model, "groups": (chair.legs[:3], chair.legs[3:]), "pushed": pushed}


# --- What the laws must be told


@dataclass(frozen=True)
class Entry:
    """Particulars of a class.

    Attributes:
        arguments: those that it cannot be made without.
        variants: others of its arguments, each with which all laws are proved as well.
        inputs: usual values of its inputs that are not those of `USUAL`.
        limits: of its outputs, whatever the inputs are; a number is one either way.
        passes: names of outputs that may be other than finite, by the words of the docstring
            that say so.
        raises: what it may raise at bad input.
        prepare: changes a context, where usual inputs do not lead to all states.
        shares: whether its outputs follow from one solution, so that an input that moves one
            counts as one that moves all.
        begins: output that begins where something is measured, and where that is.
        period: of its updates, where that is not an argument.
    """

    arguments: Callable[[], dict[str, Any]] = dict
    variants: tuple[dict[str, Any], ...] = ()
    inputs: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    limits: Mapping[str, float | tuple[float, float]] = field(default_factory=dict)
    passes: Mapping[str, str] = field(default_factory=dict)
    raises: tuple[type[Exception], ...] = ()
    prepare: Callable[[Any, Any], object] = lambda context, random: None
    shares: bool = False
    begins: tuple[str, Callable[[dict[str, Any]], Any]] | None = None
    period: Callable[[Any], float] | None = None


def rod_of_platform():
    """A rod that is drawn as it bends, in the place of the arm's link."""
    plant, scene_graph = MultibodyPlant(1e-3), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(plant)
    link = model.arm_joints[-1].child_body()
    return {"rod": FlexibleRod(), "plant": plant, "link": link, "scene_graph": scene_graph}


def of_model(add, **arguments):
    return lambda: {"model": model_of(add)[0]} | {name: f() for name, f in arguments.items()}


def of_bodies(port, add=add_tripod):
    """Value of an output of the plant of a centre or a bench, somewhere about its beginning."""

    def sample(random, size):
        model, context, *_ = model_of(add)
        if add is add_tripod:
            q = model.positions(HOME + random.uniform(-0.02, 0.02, 6))
        else:
            q = np.zeros(model.plant.num_positions())
            q[model.order] = model.positions(PLATE + random.uniform(-0.02, 0.02, 3))
        model.plant.SetPositions(context, q + random.uniform(-2e-3, 2e-3, q.size))
        value = model.plant.GetOutputPort(port).EvalAbstract(context)
        return value.Clone() if size is None else value.get_value().value()[:size]

    return sample


def in_some_phase(context, random):
    context.SetDiscreteState(0, [random.choice(list(Phase))])
    context.SetDiscreteState(5, [1.0])  # the ground is being estimated
    memory = context.get_mutable_discrete_state(11)
    memory.SetAtIndex(3, random.integers(2))  # the platform goes down before its legs go up


def tilt(given):
    x, y, z = given["accel"]
    return math.atan2(y, z), math.atan2(-x, math.hypot(y, z))


def measured_posture(given):
    ground, offsets = given["ground"], given["foot_offsets"]
    posture = forward_kinematics(
        PlatformGeometry(), given["extension_measured"], ground, foot_offsets=offsets
    )
    return np.append(posture, np.zeros(3))


class Moved:
    """Controls that somebody has moved, and buttons that somebody has clicked."""

    VALUES: ClassVar = {"roll [deg]": 1.0, "pitch [deg]": -0.5, "height [mm]": 480.0}

    def GetSliderNames(self):
        return list(self.VALUES)

    def GetSliderValue(self, name):
        return self.VALUES.get(name, 0.1)

    def GetButtonClicks(self, name):
        return 1

    def SetSliderRange(self, name, low, high):
        assert low <= high

    def GetHoldNames(self):
        return ["walk", "lift limb 2"]

    def IsHeld(self, name):
        return name in ("walk", "ahead", "leg 2 down", "lift limb 2")

    def silence(self):
        return 0.1


BINARY = (0.0, 1.0)
JOB = Job(row_of_holes(Panel(), (0.0, 0.0), 0.0, 2, 0.03))
BODIES = {
    add: {port: of_plant(add, port) for port in ("contact_results", "body_poses", "state")}
    for add in (add_platform, add_chair)
}
BRANCHES = {name: around(LENGTH, 1e-3) for name in ("position", "length", "position_measured")}
BUILT = PlatformGeometry(deviations=(LegDeviation(l_3=1e-3, beta=2e-3),) + (LegDeviation(),) * 3)
SLOW = PiControllerParams(pole=5.0, rate_feedforward=1.0, friction_feedforward=(0.2, 0.3))
STEPS = (Step(Phase.TRANSPORT, 0.0, Command.GO), Step(Phase.HOLD, 0.0, arm=(0.1, 0.2)))
DRIVES = {"params": WHEEL_DRIVE, "channels": 4}
PLATFORM = PlatformDesign()
NOT_BUILT = "NaN where an extension cannot be built"
OF_A_PLANT = "posture attitude angular_velocity specific_force inertial_motion contact_force "
OF_A_CHAIR = "body_position body_attitude force contact_force foot_height body_pose passenger_pose"

ENTRIES: dict[str, Entry] = {
    "MechanismForces": Entry(
        lambda: {"mechanism": three_rps(), "frame": "platform"},
        inputs={
            "positions": lambda random, size: three_rps().forward(legs_of_rps(random, size)),
            "velocity": around(0.0, 0.1),
            "acceleration": around(0.0, 1.0),
            "wrench": around(0.0, 30.0),
        },
        passes={"where anything is not finite": "force"},
    ),
    "MechanismForward": Entry(
        lambda: {"mechanism": three_rps(), "frame": "platform"},
        inputs={"position": legs_of_rps, "velocity": around(0.0, 0.1)},
        passes={"where the loops cannot follow": "pose pose_rate positions"},
    ),
    "MechanismInverse": Entry(
        lambda: {"mechanism": three_rps(), "frame": "platform"},
        inputs={"pose_desired_state": pose_of_rps},
        passes={"where the frame cannot get there": "motor_desired_state positions"},
    ),
    "MechanismControls": Entry(
        lambda: {
            "controls": Moved(),
            "elements": [("x [mm]", 100.0, 0.1, 1e-3)],
            "first": [0.2],
            "speeds": [0.1],
        }
    ),
    "FramePose": Entry(
        lambda: {"frame": model_of(add_pedal)[0].plant.GetFrameByName("plate")},
        inputs={"body_poses": of_bodies("body_poses", add_pedal)},
    ),
    "LoopGaps": Entry(
        lambda: {"mechanism": three_rps()},
        inputs={
            "positions": lambda random, size: three_rps().forward(legs_of_rps(random, size)),
        },
        passes={"where a position is not finite": "loop_error"},
    ),
    "CentreControls": Entry(lambda: {"controls": Moved()}, limits={"limb_asked": (0.0, 3.0)}),
    "CentreFeedforward": Entry(
        inputs={
            **CENTRE,
            "mode": one_of(0, 1, 2, 2, 2, 2),
            "target": lambda random, size: around(random.choice((HOME, FOOT)), 2e-3)(random, 6),
            "loose_limb": one_of(2, 2, 2, 2, 0),
            "locks_closed": lambda random, size: np.array(
                [*(random.random(4) < 0.4), 1, 1, 1, 1, *(random.random(4) < 0.4)], dtype=float
            ),
            "locked_at": around(LOCKED_AT, 1e-3),
        },
        limits={"is_stuck": BINARY},
        passes={
            "what is known is shown as it is": "position_command "
            "pose_desired foot_desired length_error"
        },
        shares=True,
    ),
    "CentrePositions": Entry(
        of_model(add_tripod), inputs=CENTRE, passes={"positions that are not finite": "positions"}
    ),
    "CentrePosture": Entry(
        variants=({"is_sampled": True},),
        inputs={**CENTRE, "position": CENTRE["position_measured"]},
        limits={"is_determined": BINARY},
        shares=True,
    ),
    "CentreSequencer": Entry(
        variants=({"job": JOB, "params": SequenceParams(begin=0.0, settling=0.01)},),
        inputs={
            **CENTRE,
            "length_error": around(0.0, 1e-5),
            "locks_closed": one_of(*(0.0,) * 30, 1.0),
            "clamps_closed": one_of(*(1.0,) * 9, 0.0),
            "is_determined": one_of(1.0),
            "pose_asked": around(HOME, 2e-3),
            "limb_asked": one_of(0.0, 0.0, 2.0),
            "is_stuck": one_of(0.0),
            "emergency_stop": one_of(0.0, 0.0, 0.0, 1.0),
        },
        limits={
            **dict.fromkeys(("locks_command", "clamps_command", "brake", "done"), BINARY),
            **{"phase": (0.0, 12.0), "mode": (0.0, 2.0), "loose_limb": (0.0, 3.0)},
        },
        passes={"as planned: NaN": "toward"},
    ),
    "BeltSurface": Entry(inputs={"velocity": around(0.0, 2.0)}),
    "BenchControls": Entry(
        lambda: {"controls": Moved()}, inputs={"pose_desired": around(PLATE, 2e-3)}
    ),
    "BenchPositions": Entry(
        of_model(add_pedal_and_leg, order=lambda: (7, 8, 9, 10)),
        inputs={**BENCH, "hip": around((0.5, 0.9), 0.01), "leg": around((0.6, -1.2), 0.1)},
        passes={"positions that are not finite": "positions"},
    ),
    "BenchTruth": Entry(
        of_model(add_pedal),
        inputs={"body_poses": of_bodies("body_poses", add_pedal)},
    ),
    "ChairLegController": Entry(
        inputs={
            "position": around((0.706, 0.688, 0.688), 1e-4),
            "velocity": around(0.0, 1e-3),
            "foot_desired": around((0.0, -0.78, 0.0, 0.0, 0.0, 0.0), 1e-5),
            "plate_motion": around((0.5, 0.3, *(0.0,) * 7), 1e-4),
        },
        limits={"torque_command": FORCE_LIMIT},
    ),
    "ArmTip": Entry(
        lambda: {"arm": PAPER_ARM},
        inputs={
            "platform_pose": pose,
            "platform_velocity": around(0.0, 0.2),
            "arm_state": around(0.0, 0.2),
        },
        passes={"outputs are not finite": "pose velocity"},
    ),
    "BentRod": Entry(
        rod_of_platform,
        inputs={"clamp_pose": pose, "modal_state": around(0.0, 0.05)},
    ),
    "ExternalLoad": Entry(
        lambda: {"arm": PAPER_ARM},
        inputs={"base_pose": pose, "joint_state": around(0.0, 0.2), "pushes": around(0.0, 9.0)},
    ),
    "FlexibleArm": Entry(
        # So slow that any period carries it.
        lambda: {
            "rod": FlexibleRod(bending_stiffness=(200.0, 150.0), modes=1),
            "arm": PAPER_ARM,
        },
        variants=({"base_motion": "pose"}, {"base_pose": UPRIGHT}, {"payload": 0.5}),
        inputs={"base_velocity": around(0.0, 0.2), "joint_state": around(0.0, 0.2)},
        passes={"the tip are not finite either": "tip_pose tip_velocity clamp_pose"},
        shares=True,
    ),
    "YieldingDrives": Entry(
        lambda: {"arm": SOFT_ARM},
        inputs={"base_pose": pose, "drive_state": around(0.0, 0.2), "payload": around(0.5, 0.1)},
        passes={"numbers that are not finite are passed on": "joint_state"},
    ),
    "VibrationFeedforward": Entry(
        # So slow that any period carries it.
        lambda: {"rod": LumpedRod(1.9, (3.0, 2.5), 0.01), "arm": PAPER_ARM},
        inputs={"arm_command": around(0.0, 0.2)},
    ),
    "VibrationDamper": Entry(
        lambda: {"rod": LumpedRod(1.9, (3.0, 2.5), 0.01), "arm": PAPER_ARM},
        inputs={"posture": POSTURE, "fed_forward": one_of(0.0, 0.0, 0.1)},
    ),
    "DampedPosture": Entry(
        lambda: {"rod": LumpedRod(1.9, (14.0, 12.0), 0.01), "arm": PAPER_ARM},
        variants=({"limit": 0.2},),
        inputs={"displacement": around(0.0, 0.3)},
        passes={"is passed on": "posture_damped_state"},
        shares=True,
    ),
    "FootBalance": Entry(
        lambda: {
            "plant": standing_leg()[0],
            "slide": standing_leg()[0].GetJointByName("slide"),
            "leg": standing_leg()[0].GetJointByName("knee").model_instance(),
        },
        inputs={port: of_standing_leg(port) for port in ("state", "contact_results")}
        | {"column_force": around(0.0, 20.0), "slide_force": around(-300.0, 20.0)},
        passes={"are not are passed on": "foot_force"},
    ),
    "FootForce": Entry(inputs=BENCH),
    "FootImpedance": Entry(
        lambda: {"model": make_leg_model(LegDescription())},
        inputs=LEG,
        limits={"torque_command": 250.0},
    ),
    "ForceCells": Entry(
        variants=({"deviation": 1.0},),
        inputs={"reaction_forces": reactions},
        passes={"shown as it is": "force"},
    ),
    "HoldingForce": Entry(
        lambda: {
            "state_size": 4,
            "positions": [0, 1],
            "velocities": [2, 3],
            "stiffness": 1e3,
            "damping": 10.0,
        },
        variants=({"limit": 50.0},),
        inputs={"state": around(0.0, 0.02), "desired_state": around(0.0, 0.02)},
        passes={"are passed on": "force"},
    ),
    "MovingReference": Entry(
        lambda: {"count": 2},
        inputs={"arrival": around(0.0, 0.02)},
        passes={"are passed on": "now during"},
    ),
    "HipSupport": Entry(inputs=HIP, limits={"force_command": 2000.0}),
    "LoadEstimator": Entry(inputs=BENCH, shares=True),
    "PlatePose": Entry(inputs=BENCH, passes={"NaN where no pose": "pose"}),
    "SingularityGuard": Entry(
        inputs={**BENCH, "emergency_stop": one_of(0.0, 0.0, 0.0, 1.0)},
        limits={"share": BINARY, "brake": BINARY},
        shares=True,
    ),
    "TreadBalance": Entry(
        lambda: {
            "plant": standing_leg()[0],
            "joint": standing_leg()[0].GetJointByName("cells"),
        },
        inputs={port: of_standing_leg(port) for port in ("state", "contact_results")}
        | {"foot_force": around((0.0, 300.0), 20.0)},
        passes={"are not are passed on": "reaction_forces"},
    ),
    "TerrainReference": Entry(limits={"stance": BINARY, "done": BINARY}),
    "CentreStatics": Entry(inputs=CENTRE, passes={"forces that are not finite": "leg_force"}),
    "CentreTruth": Entry(
        of_model(add_tripod),
        inputs={port: of_bodies(port) for port in ("body_poses", "state")},
        passes={"shown as it is": "joints"},
    ),
    "DrillingProcess": Entry(
        inputs={"pose": around((0.0, 0.0, 0.438, 0.0, 0.0, 0.0), *(3e-3,) * 3, *(0.01,) * 3)},
        limits={"tool_force": (0.0, 225.0)},
    ),
    "PositionDrive": Entry(
        lambda: {"params": (PositionDriveParams(2.0, 30.0, -0.5, 1.0),) * 2},
        inputs={"position_command": around(0.0, 0.2)},
        limits={"velocity_measured": 2.0},
    ),
    "PiServo": Entry(
        lambda: {"actuator": LinearActuatorParams(), "control": SLOW, "channels": 4},
        inputs={"position_command": around(0.42, 0.01), "load_force": around(0.0, 100.0)},
    ),
    "PositionServo": Entry(
        lambda: DRIVES,
        inputs={"position_command": around(0.0, 0.2)},
        limits={"velocity_measured": 33.0},
    ),
    "Switches": Entry(
        variants=({"panel": Panel()}, {"panel": Panel(), "delay": 0.02}),
        inputs={**CENTRE, "locks_command": one_of(0.0, 1.0), "clamps_command": one_of(0.0, 1.0)},
        limits=dict.fromkeys(("locks_closed", "clamps_closed"), BINARY),
    ),
    "WrenchMonitor": Entry(inputs=CENTRE, limits={"wrench_index": (0.0, 1.0)}),
    "ChairControls": Entry(lambda: {"controls": Moved()}, limits={"halt": BINARY}),
    "AttitudeEstimator": Entry(
        limits={"attitude": math.pi, "gyro_bias": 0.035}, begins=("attitude", tilt)
    ),
    "ChairFeedforward": Entry(
        inputs={
            "body_motion": in_gait("body"),
            "foot_motion": in_gait("feet"),
            "references": one_of(1, 2, 3),
        },
        passes={"branches are NaN": "length velocity acceleration"},
        raises=(ValueError,),
    ),
    "ChairPose": Entry(
        of_model(add_chair), inputs=BRANCHES, passes={"NaN for the joints": "positions"}
    ),
    "ChairTruth": Entry(
        of_model(add_chair),
        inputs=BODIES[add_chair],
        passes={"is passed on": "foot_height"},
        shares=True,
    ),
    "CompoundPositionController": Entry(
        variants=({"channels": 12, "period": 0.02},), limits={"velocity_command": 0.08}
    ),
    "ContactKeeper": Entry(
        variants=({"patience": 0.015},),
        limits={"standing": BINARY},
        passes={"is passed on": "extension_trimmed_state"},
    ),
    "DeviceStatus": Entry(
        variants=({"devices": "ab", "periods": (0.01, 0.02), "delays": (0.0, 0.1)},),
        limits={"age": (0.0, 0.12), "fault": 0.0},
    ),
    "EasedStart": Entry(
        inputs=BRANCHES,
        passes={"nodes are the gait's": "position_node"},
        raises=(NotAtStart,),
        begins=("position_node", lambda given: given["position_measured"]),
    ),
    "EasedLegs": Entry(
        # At rest when a way begins, as its request is.
        inputs={"extension_request": around((0.405,) * 4 + (0,) * 4, *(0.004,) * 4, *(0,) * 4)},
        passes={"is passed on": "extension_desired_state"},
        limits={"legs_arrived": BINARY},
        begins=("extension_desired_state", lambda given: [*given["extension"], 0, 0, 0, 0]),
    ),
    "Encoder": Entry(variants=({"channels": 3, "resolution": 0.0},)),
    "FaultDetector": Entry(
        lambda: {"geometry": PLATFORM.geometry, "params": PLATFORM.fault_detector},
        inputs={
            "extension": around(0.405, 3e-4),
            "phase": one_of(Phase.POSTURE, Phase.HOLD, Phase.LOWER),
        },
        limits={"findings": BINARY, "severity": (0.0, 4.0)},
    ),
    "FaultInjector": Entry(
        variants=(
            {"size": 3, "faults": (Fault("wrong", 1, 0.02, 0.05), Fault("delayed", 2, 0.01))},
            {"size": 2, "faults": (Fault("off", 0, 0.02), Fault("stuck", 1, 0.01))},
            {"size": 2, "faults": (Fault("slow", 0), Fault("garbage", 1)), "span": (2.0, 3.0)},
            {"faults": (Fault("intermittent", missing_time=0.02, good_time=0.03),)},
        ),
        limits={"extra_age": BINARY, "changed": BINARY},
        passes={"a value that is not finite passes": "faulted"},
    ),
    "FootTruth": Entry(
        of_model(add_platform),
        inputs=BODIES[add_platform],
        passes={"is passed on": "foot_height"},
    ),
    "ForwardKinematics": Entry(variants=({"geometry": BUILT},), passes={NOT_BUILT: "posture"}),
    "FunctionSystem": Entry(
        lambda: {"inputs": {"signal": 2}, "outputs": {"norm": (1, lambda x: [x @ x])}},
        passes={"handed to the functions as it is": "norm"},
    ),
    "GaitPlanner": Entry(
        variants=({"begin": 0.02, "pause": 0.05},),
        limits={"support": BINARY, "done": BINARY, "references": (1.0, 3.0)},
    ),
    "GroundEstimator": Entry(limits={"valid": BINARY}),
    "InputShaper": Entry(
        lambda: {"shaper": Shaper.zv(3.0, 0.1)},
        variants=({"shaper": Shaper.by_name("ei", [8.0, 50.0], [0.0, 0.1]), "channels": 3},),
        inputs={"command": around(0.5, 0.5)},
        passes={"it is shown as it is": "shaped_command"},
        begins=("shaped_command", lambda given: given["command"]),
    ),
    "StepMean": Entry(
        lambda: {"size": 3},
        inputs={"signal": around(0.0, 1.0)},
        passes={"are passed on": "mean"},
    ),
    "Hold": Entry(variants=({"initial": (1.0, 2.0)},), passes={"passes as it is": "held"}),
    "Imu": Entry(
        variants=({"params": ImuParams.ideal(), "decimation": 2},),
        inputs={"attitude": around(0.0, 0.5)},
        limits={
            "gyro": ImuParams().gyro_range,
            "accel": ImuParams().accel_range,
            "mag": ImuParams().mag_range,
        },
        period=lambda system: sample_period(system.decimation),
    ),
    "InertialMotion": Entry(
        lambda: {"state_size": 13, "pose_start": 0, "velocity_start": 7, "period": 0.01},
        inputs={"state": pose, "last_state": pose},
        passes={"is passed on": "motion"},
    ),
    "KinematicChair": Entry(
        inputs=BRANCHES, passes={"NaN where a leg cannot be assembled": OF_A_CHAIR}, shares=True
    ),
    "KinematicFeedforward": Entry(
        variants=(
            {"law": "differential", "active_legs": (3, 1, 0), "period": 0.02},
            {"geometry": BUILT, "active_legs": (2, 0, 3)},
        ),
        passes={"gives NaN for that leg": "active_desired_state"},
    ),
    "KinematicPlatform": Entry(
        variants=({"wheels": WheelGeometry(), "ground": (0.01, 0.0)},),
        passes={NOT_BUILT: f"{OF_A_PLANT} load_force foot_height base_pose stance"},
        shares=True,
    ),
    "LegRamp": Entry(
        passes={"is passed on": "extension_desired_state"},
        begins=("extension_desired_state", lambda given: [*given["extension"], 0, 0, 0, 0]),
    ),
    "LegTransmission": Entry(passes={NOT_BUILT: "swing_state load_force"}),
    "LimitSwitches": Entry(
        inputs={"extension": one_of(-0.1, 0.5, 1.1)}, limits={"limits": BINARY}
    ),
    "LinearActuator": Entry(
        variants=(
            {"channels": 3, "extension": 0.41, "gain_scale": (1.0, 1.1, 0.9)},
            {"params": LinearActuatorParams(model="integrator"), "time_step": 0.005},
        ),
        limits={"extension": (0.38, 0.46), "velocity": 0.14, "next_state": (-0.14, 0.46)},
    ),
    "MujocoPlant": Entry(
        translated,
        inputs={
            "desired_state": around(0.0, 0.05),
            "applied_force": around(0.0, 5.0),
            "pushes": around(0.0, 5.0),
        },
        period=lambda system: system.model.plant.time_step(),
        shares=True,
    ),
    "NoiseSource": Entry(variants=({"size": 3, "seed": 5},)),
    "OperatorScript": Entry(variants=({"steps": STEPS},)),
    "ParallelLinks": Entry(
        of_model(
            add_platform,
            scene_graph=SceneGraph,
            size=lambda: model_of(add_platform)[0].plant.num_positions(),
        ),
        inputs={"positions": BODIES[add_platform]["state"]},
    ),
    "PassiveLegSolver": Entry(
        variants=({"geometry": BUILT, "active_legs": (3, 1, 0)},),
        passes={"NaN for the passive leg": "extension_desired_state"},
    ),
    "PayloadEstimator": Entry(inputs={**BRANCHES, "current": around(0.5, 0.1)}),
    "PiController": Entry(variants=({"params": SLOW, "period": 0.005},), limits={"voltage": 10.0}),
    "PlatformPose": Entry(of_model(add_platform), passes={NOT_BUILT: "positions"}),
    "PlatformTruth": Entry(
        of_model(add_platform),
        inputs=BODIES[add_platform],
        passes={"NaN for a pose that is not finite": "posture"},
    ),
    "PostureLoop": Entry(
        variants=({"params": PostureLoopParams(2.0, 0.1, 0.02), "period": 0.02},),
        passes={"is passed on": "posture_corrected_state"},
    ),
    "PostureReference": Entry(
        variants=({"on_unreachable": "clamp"},),
        passes={"measurements that are not": "posture_desired_state"},
        raises=(UnreachablePosture,),
        begins=("posture_desired_state", measured_posture),
    ),
    "PostureScript": Entry(
        variants=({"waypoints": (Waypoint(0.0, 0.01), Waypoint(0.02, 0.0, 0.2))},),
        limits={"posture_scale": BINARY},
    ),
    "OperatorControls": Entry(lambda: {"controls": Moved()}),
    "PushForces": Entry(
        variants=({"bodies": [BodyIndex(1)] * 2, "places": np.ones((2, 3))},),
        inputs={"pushes": around(0.0, 9.0)},
    ),
    "PostureSliders": Entry(lambda: {"controls": Moved()}, variants=({"controls": Meshcat()},)),
    "ServoGoal": Entry(
        lambda: DRIVES,
        inputs={"velocity_command": around(0.0, 5.0), "state": around(0.0, 5.0)},
        passes={"of a state that is not finite": "goal"},
    ),
    "TipFeedforward": Entry(
        lambda: {"carried": CARRIED, "height": 0.478},
        variants=({"on_unreachable": "clamp", "has_view": True}, {"answer_delay": 0.01}),
        inputs={"tip_command": tip},
        limits={"tip_refused": BINARY, "tip_answered": BINARY},
        passes={"NaN before the first": "tip_goal"},
        raises=(UnreachableTip, BarredTip),
    ),
    "TipLoop": Entry(
        lambda: {"carried": CARRIED},
        variants=({"carried": replace(CARRIED, rod=FlexibleRod())},),
        inputs={
            "tip_goal": around((1.03, 0.02, 2.36), 0.02),
            "tip_answered": one_of(0.0, 1.0),
        },
        limits={"tip_arrived": BINARY},
        passes={
            "is not finite is passed on": "posture_corrected_state",
            "as all of these see them": "posture_measured",
            "NaN unless enabled": "platform_pose_measured",
            "as all of these see it": "tip_estimated",
        },
    ),
    "TipScript": Entry(
        lambda: {"points": [(1.0, 0.0, 2.3), (0.5, 1.0, 2.3)]},
        inputs={"tip_arrived": one_of(0.0, 1.0)},
        passes={"NaN before the first": "tip_command"},
    ),
    "TipSliders": Entry(lambda: {"controls": Moved(), "carried": CARRIED, "height": 0.478}),
    "StabilityMonitor": Entry(
        limits={"refused": BINARY},
        passes={"margin minus infinity": "margin", "refuses every request": "margin_requested"},
    ),
    "Supervisor": Entry(
        lambda: {
            "geometry": PLATFORM.geometry,
            "params": PLATFORM.supervisor,
            "standing_height": PLATFORM.wheel_geometry.standing_height,
        },
        inputs={"limits": one_of(1.0, 1.0, 0.0), "severity": one_of(0, 1)},
        limits={
            **{"phase": (0.0, 9.0), "leg_rate": 0.006, "refusal": (0.0, 9.0)},
            **dict.fromkeys(("posture_control", "legs_enable", "legs_stop"), BINARY),
            **dict.fromkeys(("estimate_ground", "wheel_brake", "arm_enable"), BINARY),
        },
        prepare=in_some_phase,
    ),
    "SupportMonitor": Entry(
        inputs={
            "gait_time": around(10.0, 10.0),
            "payload": around((60.0, 0.0, 0.0), 10.0, 0.02, 0.02),
        },
        limits={"hold": BINARY},
        passes={"the margin is minus infinity": "margin"},
    ),
    "VelocityServo": Entry(lambda: DRIVES, limits={"velocity_measured": 33.0}),
}


# --- Discovery


def discovered():
    """Classes of systems that modules define, templates by their form for floats."""
    found, templates = {}, {}
    for info in pkgutil.walk_packages(parapod.systems.__path__, "parapod.systems."):
        if ".hardware" in info.name:
            continue
        module = importlib.import_module(info.name)
        for name, value in vars(module).items():
            if isinstance(value, TemplateSystem) and value.name == name:
                templates[name.rstrip("_")] = found[name.rstrip("_")] = value[None]
            elif (
                inspect.isclass(value)
                and issubclass(value, (LeafSystem, Diagram))
                and value.__module__ == module.__name__
                and name.isascii()  # not that of a template
                and not name.startswith("_")
            ):
                found.setdefault(name, value)
    # Base classes have no ports of their own.
    del found["OnInclinedGround"], found["LeafSystem"]
    return dict(sorted(found.items())), templates


SYSTEMS, TEMPLATES = discovered()


def is_vector(port):
    return port.get_data_type() == PortDataType.kVectorValued


class Kind:
    """A class of systems."""

    def __init__(self, name):
        self.name, self.type, self.entry = name, SYSTEMS[name], ENTRIES.get(name, Entry())
        self.is_template = name in TEMPLATES
        self.text = inspect.getdoc(self.type) or ""

    @property
    def specimens(self):
        return [Specimen(self, {}), *(Specimen(self, made) for made in self.entry.variants)]

    @property
    def rows(self):
        """Cells of the port table: direction, name, size, unit, meaning."""
        found = map(ROW.match, self.text.splitlines())
        return [[cell.strip() for cell in row.groups()] for row in found if row]

    def make(self, **arguments):
        """A system, made with what the entry says."""
        try:
            return self.type(**(self.entry.arguments() | arguments))
        except TypeError as error:
            pytest.fail(f"{self.name} needs arguments: add it to ENTRIES ({error})")


def numbers_of(value):
    """Numbers of an abstract output: signals of a bus, forces, or poses of frames."""
    if isinstance(value, BusValue):
        return [value.Find(name) for name in value]
    if isinstance(value, list) and isinstance(value[0], SpatialForce):
        return [force.get_coeffs() for force in value]
    if isinstance(value, list) and isinstance(value[0], ExternallyAppliedSpatialForce):
        return [np.append(force.F_Bq_W.get_coeffs(), force.p_BoBq_B) for force in value]
    if isinstance(value, list):
        return [pose.GetAsMatrix34() for pose in value]
    frames = sorted(value.ids(), key=lambda frame: frame.get_value())
    return [value.value(frame).GetAsMatrix34() for frame in frames]


class Specimen:
    """A class of systems with some arguments, and what can be done to its system."""

    def __init__(self, kind, arguments):
        self.kind, self.entry, self._arguments = kind, kind.entry, arguments

    @cached_property
    def system(self):
        return self.kind.make(**self._arguments)

    @cached_property
    def inputs(self):
        """Input ports by their names."""
        ports = map(self.system.get_input_port, range(self.system.num_input_ports()))
        return {port.get_name(): port for port in ports}

    @cached_property
    def outputs(self):
        ports = map(self.system.get_output_port, range(self.system.num_output_ports()))
        return {port.get_name(): port for port in ports}

    @cached_property
    def event(self):
        """The periodic update; None if there is none."""
        return self.system.GetUniquePeriodicDiscreteUpdateAttribute()

    def sample(self, random, **switched):
        """Usual values of all inputs, by their names; those that can be switched so."""
        usual, values = {**USUAL, **self.entry.inputs}, {}
        for name, port in self.inputs.items():
            if name not in usual:
                pytest.fail(f"{self.kind.name}: add what is usual at '{name}' to ENTRIES")
            values[name] = usual[name](random, port.size() if is_vector(port) else None)
        return values | {name: [v] for name, v in switched.items() if name in values}

    def fix(self, context, values):
        for name, value in values.items():
            self.system.GetInputPort(name).FixValue(context, value)

    def shown(self, context, order=1):
        """Values of all outputs by their names, evaluated in that order."""
        values = {}
        for name in list(self.outputs)[::order]:
            value = self.outputs[name].Eval(context)
            if not is_vector(self.outputs[name]):  # poses of a SceneGraph's frames
                value = numbers_of(value)
            values[name] = np.array(value)
        return values

    def ahead(self, context):
        """Discrete state after the next update, by groups; none if there is no update."""
        if self.event is None:
            return {}
        state = self.system.EvalUniquePeriodicDiscreteUpdate(context)
        return {i: state.value(i).copy() for i in range(state.num_groups())}

    def all_of(self, context):
        """Everything that follows from a context."""
        return {**self.ahead(context), **self.shown(context)}

    def step(self, context):
        """Updates the discrete state, and lets a period pass."""
        for i, value in self.ahead(context).items():
            context.get_mutable_discrete_state().set_value(i, value)
        if self.event is not None:
            context.SetTime(context.get_time() + self.event.period_sec())

    def moments(self, count=6, seed=0):
        """Contexts at the beginning, and after some updates with usual inputs; a generator."""
        random = np.random.default_rng(seed)
        for number in range(count):
            context = self.system.CreateDefaultContext()
            self.entry.prepare(context, random)
            given = self.sample(random)
            is_on = number % 2 == 1
            for k in range(number % 6):
                # Off, and then on, or on all the time: what starts does so on the way.
                self.fix(context, given | switched(given, is_on or k > 0))
                self.step(context)
            self.fix(context, given | (switched(given, is_on) if number < 4 else {}))
            yield context, random


def switched(values, on):
    """Those of some values that let a system do something, or nothing."""
    names = {"enable", "trigger", "ground_valid"} & set(values)
    return {name: [float(on)] for name in names} | {
        name: [0.0] for name in {"stop", "brake"} & set(values)
    }


def pytest_generate_tests(metafunc):
    kinds = [Kind(name) for name in SYSTEMS]
    specimens = [
        pytest.param(specimen, id=f"{kind.name}-{i}" if i else kind.name)
        for kind in kinds
        for i, specimen in enumerate(kind.specimens)
    ]
    for name, values in (
        ("system_kind", [pytest.param(kind, id=kind.name) for kind in kinds]),
        ("specimen", specimens),
        ("convertible", [one for one in specimens if one.values[0].kind.is_template]),
    ):
        if name in metafunc.fixturenames:
            metafunc.parametrize(name, values)
