"""Typed scenario of a machine made of a model file: `parapod scenario mechanism-track`."""

from dataclasses import dataclass, field

import numpy as np

from parapod.diagrams.any_mechanism.design import MechanismDesign
from parapod.diagrams.any_mechanism.drivers import Epos2MotorAxes, Epos2MotorScrews
from parapod.diagrams.any_mechanism.track import Track, TrackScenario, make_track
from parapod.diagrams.disturbances import Disturbance
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machine import ControlScenario
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.core.vectors import Array

# Drivers that a scenario can name.
DRIVERS = (Epos2MotorScrews, Epos2MotorAxes)
MULTIBODY, KINEMATIC = "multibody", "kinematic"
SIMULATED = (KINEMATIC, MULTIBODY)
BACKENDS = (*SIMULATED, "mock", "hardware")


@dataclass
class MechanismPlantScenario(Schema):
    """The simulated machine.

    Attributes:
        time_step: step of the rigid bodies and of the drives [s].
        accuracy: largest error of a position in a step, with which Drake's CENIC integrates the
            rigid bodies [m, rad]; null: they take steps of `time_step`. Of the multibody backend
            alone.
    """

    time_step: float = quantity(1e-3, 1e-5, 1e-2)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)


def emulated_hardware() -> HardwareScenario:
    """The devices of `parapod emulate mechanism-track`."""
    return HardwareScenario([Epos2MotorScrews()])


@dataclass
class MechanismScenario(Schema):
    """A mechanism whose frame is led along a way.

    Attributes:
        backend: plant behind the station's ports: "kinematic" (loops closed at every instant, at
            rest), "multibody" (rigid bodies with constraints), "mock" (commands are mirrored) or
            "hardware".
        seed: seed of the errors of the encoders' zeros.
        machine: see `MechanismDesign`; or a file: `!File my_machine.yaml`.
        track: see `TrackScenario`.
        plant: see `MechanismPlantScenario`.
        control: see `ControlScenario`.
        disturbances: forces on bodies, of simulated ones: `Push`, `Weight`, `Cable`, `Wind`; and
            ground that gives, `Subsidence`.
        hardware: see `HardwareScenario`; the defaults are the emulated devices of motors that
            push. Ones that turn have `Epos2MotorAxes`.
    """

    backend: str = choice(MULTIBODY, BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: MechanismDesign = field(default_factory=MechanismDesign)
    track: TrackScenario = field(default_factory=TrackScenario)
    plant: MechanismPlantScenario = field(default_factory=MechanismPlantScenario)
    control: ControlScenario = field(default_factory=ControlScenario)
    disturbances: list[Disturbance] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def zero_errors(self) -> Array:
        """Positions of the motors less those of their encoders (n) [m, rad]."""
        largest, count = self.machine.zero_error, len(self.machine.built.motors.names)
        return np.random.default_rng(self.seed).uniform(-largest, largest, count)

    @property
    def way(self) -> Track:
        """The way, looked at throughout.

        Raises:
            ScenarioError: a pose that the frame does not get to, or waypoints out of order.
        """
        return make_track(self.machine, self.track)
