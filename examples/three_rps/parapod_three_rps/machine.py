"""The 3-RPS platform as a machine of parapod: scenario, plant, controller, declaration."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from parapod import Behind, FunctionSystem, In, Inner, Machine, MachineScenario, Out, Schema, Truth
from parapod import add, connect, named_source, quantity, wired
from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiController, PiControllerParams
from parapod.systems.sensors.encoder import Encoder
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from parapod_three_rps.kinematics import Geometry, forward, inverse
from parapod_three_rps.kinematics import jacobian, leg_forces, platform_joints

GEOMETRY = Geometry()
HOME = np.array([0.0, 0.0, 0.50])  # pose [rad, rad, m]
STROKE = 0.08  # stroke of a leg to either side of its length at home [m]
_MIDDLE = inverse(GEOMETRY, HOME)[0]
ACTUATOR = LinearActuatorParams(stop_min=_MIDDLE - STROKE, stop_max=_MIDDLE + STROKE)


@dataclass
class Motion(Schema):
    """Tilting in a circle: the platform's normal goes round while the height stays.

    Attributes:
        tilt_deg: angle between the platform's normal and the vertical [deg].
        period: duration of one round [s].
    """

    tilt_deg: float = quantity(10.0, 0.0, 30.0)
    period: float = quantity(6.0, 1.0, 60.0)


@dataclass
class Scenario(MachineScenario):
    """One run of the 3-RPS platform.

    Attributes:
        gain_error: largest error of an actuator's gain, drawn from the seed [-].
        motion: see `Motion`.
    """

    gain_error: float = quantity(0.15, 0.0, 0.5)
    motion: Motion = field(default_factory=Motion)


class Drawing(LeafSystem):
    """Draws the platform on its legs thirty times a second."""

    def __init__(self, meshcat: Meshcat):
        super().__init__()
        self._meshcat = meshcat
        self._pose = self.DeclareVectorInputPort("pose", 3)
        self.DeclarePeriodicPublishEvent(1.0 / 30.0, 0.0, self._draw)

    def _draw(self, context: Context) -> None:
        tops = platform_joints(GEOMETRY, self._pose.Eval(context))
        feet = platform_joints(Geometry(platform=GEOMETRY.base), np.zeros(3))
        for name, corners in (("platform", tops), ("base", feet)):
            self._meshcat.SetLine(f"/{name}", corners[:, [0, 1, 2, 0]], 6.0, Rgba(0, 0.3, 0.6))
        for i, leg in enumerate(np.stack([feet, tops], axis=-1).swapaxes(0, 1)):
            self._meshcat.SetLine(f"/leg_{i + 1}", leg, 8.0, Rgba(0.3, 0.3, 0.3))


def add_plant(builder: DiagramBuilder, scenario: Scenario, meshcat: Meshcat | None) -> Behind:
    """Adds actuators, encoders and the platform, at rest on its legs at every instant."""
    step = scenario.control.period
    actuators = add(builder, LinearActuator(ACTUATOR, channels=3, time_step=step))
    encoder = add(builder, Encoder(channels=3, gate_time=step))
    pose = partial(forward, GEOMETRY)
    outputs = {"pose": (3, pose), "load": (3, lambda lengths: leg_forces(GEOMETRY, pose(lengths)))}
    platform = add(builder, FunctionSystem({"lengths": 3}, outputs), "platform")
    for source, sink in (
        (actuators.GetOutputPort("extension"), platform.GetInputPort("lengths")),
        (actuators.GetOutputPort("extension"), encoder.GetInputPort("position")),
        (actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity")),
        (platform.GetOutputPort("load"), actuators.GetInputPort("load_force")),
    ):
        connect(builder, source, sink)
    if meshcat is not None:
        drawing = add(builder, Drawing(meshcat), "drawing")
        connect(builder, platform.GetOutputPort("pose"), drawing.GetInputPort("pose"))

    def reset(root_context: Context, beginning: Scenario) -> None:
        error = np.random.default_rng(beginning.seed).uniform(-1.0, 1.0, 3) * beginning.gain_error
        context = actuators.GetMyMutableContextFromRoot(root_context)
        actuators.set_gain_scale(context, 1.0 + error)

    return Behind(
        {"legs.voltage": actuators.GetInputPort("voltage")},
        {
            "legs.length": encoder.GetOutputPort("position_measured"),
            "truth.pose": platform.GetOutputPort("pose"),
        },
        reset,
    )


def legs_of(state):
    """Lengths and rates (6) of the legs for a pose and its rates (6)."""
    pose, rates = np.split(state, 2)
    return np.concatenate([inverse(GEOMETRY, pose), jacobian(GEOMETRY, pose) @ rates])


# Signals by the names of ports inside the controller.
SIGNALS = {"measured": "legs.length", "desired_state": "length_desired_state"}
SIGNALS |= {"voltage": "legs.voltage"}


def make_controller(scenario: Scenario):
    """Inverse kinematics and a PI controller a leg."""
    lengths = {"length_desired_state": (6, legs_of)}
    params = PiControllerParams(rate_feedforward=1.0, friction_feedforward=(0.05, 0.05))
    systems = [
        FunctionSystem({"pose_desired_state": 6}, lengths),
        PiController(params, channels=3, period=scenario.control.period),
    ]
    outputs = ["legs.voltage", "length_desired_state"]
    return wired("controller", systems, outputs, SIGNALS, skip=["enable"])


def make_sources(scenario: Scenario):
    """The motion: out to the tilt within a period, then round."""
    tilt, period = np.radians(scenario.motion.tilt_deg), scenario.motion.period
    times = np.linspace(0.0, 4.0 * period, 401)
    angle = 2.0 * np.pi * times / period
    size = tilt * np.clip(times / period, 0.0, 1.0) ** 2
    poses = np.array([size * np.cos(angle), size * np.sin(angle), 0.0 * angle + HOME[2]])
    motion = PiecewisePolynomial.CubicShapePreserving(times, poses)
    return [named_source("pose_desired_state", motion, derivatives=1)]


THREE_RPS = Machine(
    name="three_rps",
    title="the 3-RPS platform",
    experiment="rps-tilt",
    scenario=Scenario,
    ports=(
        In("legs.voltage", 3, "V", "motor voltages"),
        Out("legs.length", 3, "m", "encoders: lengths of the legs"),
        Truth("pose", 3, "rad, rad, m", "rotation vector's x and y, and height"),
        Inner("pose_desired_state", "rad, rad, m, and their rates", "pose to take"),
        Inner("length_desired_state", "m, m/s", "lengths that the legs are led to"),
    ),
    parts=("legs",),
    plants={"kinematic": add_plant},
    controller=make_controller,
    sources=make_sources,
)
