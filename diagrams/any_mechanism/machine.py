"""A machine made of a model file: one declaration, whatever the file."""

from collections.abc import Mapping
from typing import Any

from parapod.diagrams.any_mechanism.controller import make_controller, make_source
from parapod.diagrams.any_mechanism.design import GROUND
from parapod.diagrams.any_mechanism.plants import add_bodies, add_kinematics, mirror
from parapod.diagrams.any_mechanism.ports import PART, PARTS_OF_STATION, ports_of
from parapod.diagrams.any_mechanism.real import make_real
from parapod.diagrams.any_mechanism.scenario import KINEMATIC, MULTIBODY, MechanismScenario
from parapod.diagrams.any_mechanism.view import VIEW
from parapod.diagrams.disturbances import FORCES, Subsidence
from parapod.diagrams.machine import Machine
from parapod.diagrams.plots import Limits


def _limits(scenario: MechanismScenario) -> Limits:
    """Ends, speeds and forces of the motors."""
    motors = scenario.machine.built.motors
    ends = motors.lower, motors.upper
    speeds = tuple(-speed for speed in motors.velocities), motors.velocities
    forces = tuple(-force for force in motors.forces), motors.forces
    return {
        f"{PART}.position": ends,
        f"{PART}.position_command": ends,
        f"{PART}.velocity": speeds,
        "truth.motor_force": forces,
    }


def _variant(scenario: MechanismScenario) -> Mapping[str, Any]:
    """Ports, axes and limits by the model's motors, and the coordinates of its frame."""
    built = scenario.machine.built
    return {
        "ports": ports_of(built),
        "axes": {PART: built.motors.names},
        "real": make_real(scenario),
        "feet": len(scenario.machine.feet_mm) if scenario.machine.base == GROUND else 0,
    }


MECHANISM = Machine(
    name="any_mechanism",
    title="the mechanism",
    experiment="mechanism-track",
    scenario=MechanismScenario,
    parts=PARTS_OF_STATION,
    plants={MULTIBODY: add_bodies, KINEMATIC: add_kinematics},
    mirror=mirror,
    controller=make_controller,
    sources=lambda scenario: (make_source(scenario),),
    view=VIEW,
    limits=_limits,
    resets=lambda scenario: ("seed",),
    disturbances={MULTIBODY: (*FORCES, Subsidence)},
    over_rows={},
    variant=_variant,
    **_variant(MechanismScenario()),
)
