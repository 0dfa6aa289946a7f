"""The walking chair's station with a simulated plant, which can be exchanged."""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import MatrixGain

from parapod.diagrams.station import Station
from parapod.diagrams.walking_chair.kinematic_plant import add_kinematic_plant
from parapod.diagrams.walking_chair.multibody_plant import add_multibody_plant
from parapod.diagrams.walking_chair.plant import Plant, PlantMaker
from parapod.diagrams.walking_chair.ports import STATUS_PARTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.sensors.device_status import DeviceStatus
from parapod.systems.walking_chair.gait import starting_lengths
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY
from parapod.systems.walking_chair.payload import PayloadEstimatorParams

PLANTS: dict[str, PlantMaker] = {
    "multibody": add_multibody_plant,
    "kinematic": add_kinematic_plant,
}


@dataclass(frozen=True)
class SimulatedStation(Station[ChairScenario]):
    """A built station and the handles that a simulation needs to begin.

    Attributes:
        plant: its plant.
    """

    plant: Plant
    _drives: VelocityServo

    def reset(self, root_context: Context, scenario: ChairScenario | None = None) -> None:
        """Puts the chair where its walk begins and draws the drives' imperfections from the seed.

        The same station serves any passenger, seed and imperfection: nothing is rebuilt.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its passenger, drives' errors and seed are taken; None for what the station
                was built from. What is built in, such as the walk and the encoders' resolution,
                stays.
        """
        scenario = scenario or self.scenario
        walk = self.scenario.gait.walk
        lengths = starting_lengths(CHAIR_GEOMETRY, walk)
        random = np.random.default_rng(scenario.seed)
        error, offset = scenario.drives.gain_error, 1e-3 * scenario.drives.offset_mm_s
        self._drives.set_position(root_context, lengths.ravel())
        self._drives.set_imperfection(
            root_context,
            1.0 + random.uniform(-error, error, len(BRANCHES)),
            random.uniform(-offset, offset, len(BRANCHES)),
        )
        body = np.asarray(walk.motion(CHAIR_GEOMETRY, 0.0).body.position)
        self.plant.stand(root_context, lengths, body, scenario.passenger.passenger)


def make_simulated_station(
    scenario: ChairScenario, meshcat: Meshcat | None = None
) -> SimulatedStation:
    """Builds the station of a simulated backend.

    Args:
        scenario: what to build; its `backend` decides about the plant.
        meshcat: draws the machine there; None for no drawing.
    """
    builder = DiagramBuilder()
    period = scenario.control.period
    drives = add(
        builder,
        # Of the quasi-static plant only what is sampled counts: twice as often as the command.
        VelocityServo(
            drive_params(scenario),
            len(BRANCHES),
            period,
            scenario.plant.time_step if scenario.backend == "multibody" else 0.5 * period,
        ),
        "drives",
    )
    builder.ExportInput(drives.GetInputPort("velocity_command"), "legs.velocity_command")
    builder.ExportInput(drives.GetInputPort("brake"), "legs.brake")
    for name in ("position", "velocity"):
        builder.ExportOutput(drives.GetOutputPort(f"{name}_measured"), f"legs.{name}")
    plant = PLANTS[scenario.backend](builder, scenario, drives, meshcat)
    per_newton = 1.0 / PayloadEstimatorParams().force_per_current
    current = add(builder, MatrixGain(per_newton * np.eye(len(BRANCHES))), "motor_current")
    connect(builder, plant.signals["force"], current.get_input_port())
    builder.ExportOutput(current.get_output_port(), "legs.current")
    status = add(builder, DeviceStatus(STATUS_PARTS, (0.0,) * len(STATUS_PARTS)))
    for name in ("age", "fault"):
        builder.ExportOutput(status.GetOutputPort(name), f"status.{name}")
    for name, port in plant.signals.items():
        builder.ExportOutput(port, f"truth.{name}")
    builder.ExportOutput(drives.GetOutputPort("position"), "truth.position")
    diagram = builder.Build()
    diagram.set_name("station")
    return SimulatedStation(diagram, scenario, plant, drives)


def drive_params(scenario: ChairScenario) -> VelocityServoParams:
    """Of the twelve drives, with the stroke of each."""
    drives, strokes = scenario.drives, CHAIR_GEOMETRY.leg.strokes
    return VelocityServoParams(
        resolution=1e-3 * drives.encoder_resolution_mm,
        time_constant=1e-3 * drives.time_constant_ms,
        max_velocity=1e-3 * drives.max_velocity_mm_s,
        stop_min=tuple(strokes[:, 0].tolist()) * LEG_COUNT,
        stop_max=tuple(strokes[:, 1].tolist()) * LEG_COUNT,
    )
