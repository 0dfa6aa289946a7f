"""The levelling platform, as the commands for hardware know it."""

from dataclasses import replace
from functools import partial

from parapod.diagrams.levelling_platform.closed_loop import make_closed_loop
from parapod.diagrams.levelling_platform.ports import IDLE, INPUTS, OUTPUTS, TRUTH_OUTPUTS
from parapod.diagrams.levelling_platform.scenario import SIMULATED, LevellingScenario
from parapod.diagrams.levelling_platform.station import make_station
from parapod.diagrams.machine import Machine, Motion
from parapod.systems.actuators.linear_actuator import LinearActuatorParams

SIGNALS = {
    # Of the controller.
    "posture_command": "rad, rad, m",
    "posture_desired_state": "rad, rad, m, and their rates",
    "extension_desired_state": "m, m/s",
    "ground_estimated": "rad",
    "ground_valid": "0/1",
    "foot_offsets_estimated": "m",
    "attitude_estimated": "rad",
    # Of the supervision and the operator.
    "phase": "-",
    "findings": "0/1",
    "severity": "-",
    "refusal": "-",
    "arm_command": "rad",
    "arm_refused": "0/1",
    "arm_margin": "m",
    "stability_margin": "m",
    "operator": "-",
    "drive_request": "m/s, rad/s",
    "posture_request": "rad, rad, m",
    "arm_request": "rad",
    "steps_done": "-",
}


def _behind_devices(scenario: LevellingScenario, period: float) -> LevellingScenario:
    """With everything that is sampled at the exchange's period."""
    return replace(scenario, control=replace(scenario.control, period=period))


LEVELLING_PLATFORM = Machine(
    name="the levelling platform",
    experiment="level",
    scenario=LevellingScenario,
    simulated=dict.fromkeys(SIMULATED, 2e-3),
    inputs=INPUTS,
    outputs=OUTPUTS,
    truth=TRUTH_OUTPUTS,
    idle=IDLE,
    signals=SIGNALS,
    motions={
        "legs": Motion(
            command="voltage",
            unit="V",
            usual=1.0,
            largest=2.0,
            measured="extension",
            measured_unit="m",
            gain=LinearActuatorParams().gain,
            rest={"stop": 0.0},
        ),
        "wheels": Motion(
            command="velocity_command",
            unit="rad/s",
            usual=1.0,
            largest=2.0,
            measured="position",
            measured_unit="rad",
            gain=1.0,
            rest={"brake": 0.0},
        ),
    },
    make_station=make_station,
    make_closed_loop=partial(make_closed_loop, log=()),
    behind_devices=_behind_devices,
)
