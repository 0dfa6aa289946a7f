"""The walking chair's controller: from a gait and measurements to velocities of the drives."""

import numpy as np
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import named, wired
from parapod.systems.actuators.compound_position_controller import CompoundPositionController
from parapod.systems.walking_chair.feedforward import FARTHEST, ChairFeedforward, EasedStart
from parapod.systems.walking_chair.geometry import BRANCHES
from parapod.systems.walking_chair.payload import PayloadEstimator, PayloadEstimatorParams
from parapod.systems.walking_chair.planner import GaitPlanner
from parapod.systems.walking_chair.support import SupportMonitor, SupportMonitorParams

# Signals by the names of the ports inside.
_SIGNALS = {
    "position_measured": "legs.position",
    "position": "legs.position",
    "current": "legs.current",
    "velocity_command": "legs.velocity_command",
    "payload": "payload_estimated",
    "margin": "support_margin",
}
_SHOWN = (
    *("legs.velocity_command", "position_node", "gait_time", "support", "done"),
    *("payload_estimated", "support_margin", "hold", "legs.brake"),
)


def make_controller(scenario: ChairScenario, is_operated: bool = False) -> Diagram:
    """Wires gait planner, feedforward, position controllers, payload estimator and monitor.

    Inputs: `legs.position` (12), `legs.current` (12); where a person operates it, `halt` (1).
    Outputs: `legs.velocity_command` (12), `legs.brake` (1), `position_node` (12), `gait_time` (1),
    `support` (4), `done` (1), `payload_estimated` (3), `support_margin` (1), `hold` (1).

    Args:
        scenario: its `machine`, `gait`, `control` and `begin` are used.
        is_operated: true if a person operates it.
    """
    control, walk, machine = scenario.control, scenario.walk, scenario.machine
    geometry, masses, drives = machine.geometry, machine.masses, machine.drives
    estimator = PayloadEstimatorParams(drives.force_per_current)
    required = SupportMonitorParams(required=1e-3 * control.support_margin_mm)
    systems = (
        GaitPlanner(walk, geometry, control.period, scenario.begin),
        ChairFeedforward(geometry),
        EasedStart(period=control.period, farthest=FARTHEST * geometry.leg.size),
        CompoundPositionController(control.params(drives), len(BRANCHES), control.period),
        PayloadEstimator(estimator, geometry, masses),
        SupportMonitor(walk, required, geometry, masses),
        (named("brake_released", ConstantVectorSource(np.zeros(1))), {"y0": "legs.brake"}),
    )
    unused = ("enable",) if is_operated else ("enable", "halt")
    return wired("controller", systems, _SHOWN, _SIGNALS, unused)
