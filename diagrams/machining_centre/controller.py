"""The machining centres' controller: from a job and measurements to lengths, locks and clamps."""

import numpy as np
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import Adder, MatrixGain

from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.wiring import named, wired
from parapod.systems.machining_centre.feedforward import CentreFeedforward
from parapod.systems.machining_centre.posture import CentrePosture
from parapod.systems.machining_centre.sequence import SequenceParams
from parapod.systems.machining_centre.sequencer import CentreSequencer
from parapod.systems.machining_centre.wrench_monitor import WrenchMonitor

# Periods between two looks at whether the centre rests, where alone its pose is counted.
_LOOKS = 4
# Signals by the names of the ports inside.
_SIGNALS = {
    "position_measured": "legs.position",
    "position_command": "legs.position_command",
    "emergency_stop": "legs.emergency_stop",
    "brake": "legs.brake",
    "locks_closed": "locks.closed",
    "locks_command": "locks.command",
    "clamps_closed": "clamps.closed",
    "clamps_command": "clamps.command",
    "tool_force": "tool.force",
    "pose": "pose_estimated",
    "feet": "feet_estimated",
}
_SHOWN = (
    *("legs.position_command", "legs.brake", "locks.command", "clamps.command"),
    *("pose_desired", "foot_desired", "pose_estimated", "feet_estimated", "length_error"),
    *("phase", "operation", "fault", "loose_limb", "done", "wrench_index", "wrench_margin"),
)


def make_controller(scenario: CentreScenario, is_operated: bool = False) -> Diagram:
    """Wires posture, sequencer, feedforward and wrench monitor, by the names of their ports.

    Inputs: `legs.position` (2n), `legs.current` (2n), `legs.emergency_stop` (1), `locks.closed`
    (4n), `clamps.closed` (n), `tool.force` (2); where a person may end the job, `stop` (1).
    Outputs: those of `_SHOWN`.

    Where a person operates it: `pose_asked` (6) and `limb_asked` (1).

    Args:
        scenario: its job, `control`, `machine`, `begin` and `stop_at` are used.
        is_operated: true if a person operates it once its job is done.
    """
    geometry, plan, control = scenario.machine.geometry, scenario.plan, scenario.control
    params = SequenceParams(begin=scenario.begin, settling=control.settling)
    process, period = plan.job.process, _LOOKS * control.period
    # Legs yield to their forces: encoders do not see it, but currents show it.
    legs, count = scenario.machine.legs, geometry.legs
    by_current = legs.force_per_current_N_A / (1e6 * legs.stiffness_N_um)
    by_current *= float(control.knows_stiffness)
    lengths = named("lengths", Adder(2, count))
    yielding = named("yielding", MatrixGain(-by_current * np.eye(count)))
    systems = (
        CentrePosture(geometry, period, *plan.beginning, is_sampled=True),
        CentreSequencer(geometry, plan.job, control.period, params),
        CentreFeedforward(geometry, control.period),
        WrenchMonitor(geometry, process.largest_leg_force, process.masses),
        (lengths, {"u0": "legs.position", "u1": "yielding", "sum": "position"}),
        (yielding, {"u0": "legs.current", "y0": "yielding"}),
    )
    unused = () if is_operated else ("pose_asked", "limb_asked")
    if scenario.stop_at is None:
        unused = (*unused, "stop")
    return wired("controller", systems, _SHOWN, _SIGNALS, unused)
