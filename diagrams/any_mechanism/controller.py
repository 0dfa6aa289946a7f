"""Controller of a mechanism: from a pose of its frame to motors, and from encoders to the pose."""

import math
from typing import Any

from pydrake.systems.framework import Diagram, System
from pydrake.systems.primitives import Demultiplexer, PassThrough

from parapod.diagrams.any_mechanism.ports import PART
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.any_mechanism.track import Track, farthest
from parapod.diagrams.wiring import named, named_source, wired
from parapod.systems.mechanism.coordinates import PARTS, part_unit
from parapod.systems.mechanism.leaf_systems import MechanismForward, MechanismInverse
from parapod.systems.mechanism.operator import MechanismControls

_SHOWN = (
    *(f"{PART}.position_command", f"{PART}.brake"),
    *("motor_desired_state", "pose_estimated"),
)
# Share of the motors' speeds, and of the ways to their ends, that sliders ask for [-].
_SPEED, _WAY = 0.5, 0.95


def make_controller(scenario: MechanismScenario) -> Diagram:
    """Inverse kinematics to the motors' commands, forward kinematics of their encoders.

    Inputs: `pose_desired_state` (2k), `motors.position` (n), `motors.velocity` (n),
    `motors.emergency_stop` (1), which is the motors' brake.
    Outputs: those of `_SHOWN`.

    Args:
        scenario: its `machine` and `control` are taken.
    """
    built, period = scenario.machine.built, scenario.control.period
    mechanism, count = built.mechanism, len(built.motors.names)
    inverse = MechanismInverse(mechanism, built.frame, built.parts, period, built.q)
    forward = MechanismForward(mechanism, built.frame, period, built.q)
    halves = named("motor_command", Demultiplexer(2 * count, count))
    commanded = {
        "u0": "motor_desired_state",
        "y0": f"{PART}.position_command",
        "y1": "motor_velocity_desired",
    }
    measured = {
        "position": f"{PART}.position",
        "velocity": f"{PART}.velocity",
        "pose": "pose_estimated",
        "pose_rate": "pose_rate_estimated",
        "positions": "positions_estimated",
    }
    stop = named("stop", PassThrough(1))
    stopped = {"u": f"{PART}.emergency_stop", "y": f"{PART}.brake"}
    systems = (inverse, (halves, commanded), (forward, measured), (stop, stopped))
    return wired("controller", systems, _SHOWN)


def make_source(scenario: MechanismScenario, track: Track | None = None) -> System:
    """The source of the pose that is asked for, a period ahead.

    Args:
        scenario: its way and `control.period` are taken.
        track: way in the place of the scenario's.
    """
    way = (track or scenario.way).ahead(scenario.control.period)
    return named_source("pose_desired_state", way, derivatives=1)


def make_controls(scenario: MechanismScenario, controls: Any) -> MechanismControls:
    """A person's sliders, one for each coordinate of the frame, as far as the motors can.

    Args:
        scenario: its `machine` and `control` are taken.
        controls: owner of the sliders.
    """
    built = scenario.machine.built
    elements = []
    for i, part in enumerate(built.parts):
        unit, factor = part_unit(part)
        way = min(abs(farthest(built, i, sign)[0]) for sign in (1.0, -1.0))
        step = 0.1 if unit == "mm" else 0.05
        reach = step * math.floor(_WAY * factor * way / step)
        elements.append((f"{PARTS[part]} [{unit}]", reach, step, 1.0 / factor))
    return MechanismControls(
        controls, elements, built.home, built.speeds(_SPEED), scenario.control.period
    )
