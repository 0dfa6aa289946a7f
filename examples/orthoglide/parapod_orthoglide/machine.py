"""The Orthoglide as a machine of parapod: scenario, plant, controller, declaration."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from parapod import FunctionSystem, In, Inner, Machine, MachineScenario, Out, Schema, Truth
from parapod import ScenarioError, add, connect, named_source, quantity
from parapod.diagrams.simulated import Plant, Simulation
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from pydrake.trajectories import PiecewisePolynomial

from parapod_orthoglide.kinematics import forward, inverse


@dataclass
class Design(Schema):
    """Dimensions of an Orthoglide.

    Attributes:
        leg_mm: length of the legs [mm].
        cube_mm: edge of the cube in which its tool works [mm].
        middle_mm: coordinate of the cube's middle along each axis, from where the legs are along
            the axes [mm].
    """

    leg_mm: float = quantity(400.0, 1.0, 10_000.0)
    cube_mm: float = quantity(200.0, 1.0, 10_000.0)
    middle_mm: float = quantity(0.0, -10_000.0, 10_000.0)

    @property
    def leg(self):
        """Length of the legs [m]."""
        return 1e-3 * self.leg_mm

    @property
    def corners(self):
        """The cube's lowest and highest coordinate along each axis (2) [m]."""
        return 1e-3 * (self.middle_mm + 0.5 * self.cube_mm * np.array((-1.0, 1.0)))

    def check(self):
        """Refuses legs that are too short for the cube."""
        needed = 1e3 * np.sqrt(2.0) * np.abs(self.corners).max()
        if self.leg_mm <= needed:
            text = f"machine.leg_mm = {self.leg_mm:g} mm does not reach the corners of the cube"
            raise ScenarioError(f"{text}: more than {needed:.1f} mm would", "machine.leg_mm")


@dataclass
class Scenario(MachineScenario):
    """One run of the Orthoglide: along the diagonal of its cube and back.

    Attributes:
        machine: see `Design`.
        duration: time for the way there, and for the way back [s].
    """

    machine: Design = field(default_factory=Design)
    duration: float = quantity(1.0, 0.1, 60.0)


def add_plant(builder, scenario, meshcat):
    """Adds drives, and the tool where their positions have it."""
    design, period = scenario.machine, scenario.control.period
    simulation = Simulation(builder, lambda scenario: scenario, scenario)
    drive = VelocityServoParams(resolution=1e-6, time_constant=0.005, max_velocity=2.0)
    start = inverse(design.leg, np.full(3, design.corners[0]))
    servo = PositionServo(drive, 3, period, 0.5 * period, start)
    drives = simulation.add_drives(servo, "drives")
    place = FunctionSystem({"position": 3}, {"place": (3, partial(forward, design.leg))})
    tool = add(builder, place, "tool")
    connect(builder, drives.GetOutputPort("position"), tool.GetInputPort("position"))
    signals = {"place": tool.GetOutputPort("place")}
    simulation.add_plant(Plant(signals, lambda root_context, scenario: None))
    return simulation.behind(("drives",))


def make_controller(scenario):
    """Inverse kinematics."""
    inner = partial(inverse, scenario.machine.leg)
    return FunctionSystem({"place_desired": 3}, {"drives.position_command": (3, inner)})


def make_sources(scenario):
    """The way along the diagonal and back, at rest at its ends."""
    low, high = scenario.machine.corners
    times = scenario.duration * np.arange(3.0)
    way = np.array([[low, high, low]] * 3)
    rest = np.zeros((3, 3))
    return [named_source("place_desired", PiecewisePolynomial.CubicHermite(times, way, rest))]


ORTHOGLIDE = Machine(
    name="orthoglide",
    title="the Orthoglide",
    experiment="orthoglide-diagonal",
    scenario=Scenario,
    ports=(
        In("drives.position_command", 3, "m", "positions of the drives to take", is_sampled=True),
        In("drives.brake", 1, "0/1", "1 while the drives are held"),
        Out("drives.position", 3, "m", "encoders: positions of the drives"),
        Out("drives.velocity", 3, "m/s", "encoders: velocities of the drives"),
        Truth("place", 3, "m", "place of the tool"),
        Inner("place_desired", "m", "place that the tool is led to"),
    ),
    parts=("drives",),
    plants={"kinematic": add_plant},
    controller=make_controller,
    sources=make_sources,
)
