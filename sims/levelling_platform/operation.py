"""View of an operation: its phase in the scene, its end, and the page of its operator."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.guard import Trip, Tripped
from parapod.diagrams.levelling_platform.controller import make_supervised_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.panel import Readout, Row
from parapod.sims.levelling_platform.levelling import read_posture
from parapod.systems.core.controls import Controls
from parapod.systems.core.errors import RefusedRequest, UnreachablePosture
from parapod.systems.core.ports import value_of
from parapod.systems.levelling_platform.fault_detection import RULES
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.reference import describe_range
from parapod.systems.levelling_platform.sliders import OperatorControls, slider_of
from parapod.systems.levelling_platform.stability_monitor import usual_margin
from parapod.systems.levelling_platform.supervisor import (
    TRANSITIONS,
    Event,
    Phase,
    Refusal,
    SupervisorParams,
)

_HEIGHT = 0.16  # height of capital letters [m]
_PLACE = np.array([-2.0, 1.1, 1.75])  # lower left corner of the text, beside the arm [m]
_PATH = "/phase"
# A refusal ends the operation after this long, in which the machine is seen to stand [s].
_STANDING = 2.0
# Ports of the controller that end an operation, or say why it has ended.
_WATCHED = (
    *("phase", "refusal", "findings"),
    *("ground_estimated", "foot_offsets_estimated"),
)
_WATCHED_OF_ARM = ("arm_margin", "arm_refused")
# After this long in a phase its requests have been judged [s].
_JUDGED = 0.1
_ADVICE = {
    Phase.FAULT: "nothing moves: 'Reset' once the cause is gone",
    Phase.STANDBY: "stands by: 'Stop' raises the legs, and 'leg' buttons move one while held",
}
# Phases in which a control does something; all others always do. So does "Stop" to a person.
_OBEYED = {
    **{
        name: {transition.source for transition in TRANSITIONS if transition.event is event}
        for name, event in (("Go", Event.GO), ("Reset", Event.RESET))
    },
    **{name: {Phase.TRANSPORT} for name, *_ in OperatorControls.HELD_DRIVE},
    **{name: {Phase.TRANSPORT, Phase.STANDBY} for name, *_ in OperatorControls.HELD_JOG},
}
_REFUSED = {
    Refusal.COMMAND: "that has no place in this phase",
    Refusal.GROUND: "this ground cannot be levelled with the stroke",
    Refusal.POSTURE: "the legs do not reach that posture",
    Refusal.NO_GROUND: "a leg found no ground within its stroke",
    Refusal.CAUSE: "the fault's cause is not gone",
    Refusal.UNSETTLED: "the attitude does not settle, so that the ground is not known",
}


class PhaseLabel:
    """One word above the machine, readable from the front."""

    def __init__(self, meshcat: Meshcat):
        """Creates the label, without a word yet.

        Args:
            meshcat: the scene.
        """
        self._meshcat = meshcat
        self._drawn: set[str] = set()
        self._shown = ""

    def show(self, word: str, time: float) -> None:
        """Shows another word from this time on, in a recording too [s]."""
        if word not in self._drawn:
            self._drawn.add(word)
            begin, end = _outline(word)
            path = f"{_PATH}/{word}"
            self._meshcat.SetLineSegments(path, begin, end, 3.0, Rgba(0.10, 0.20, 0.35))
            self._meshcat.SetTransform(path, RigidTransform(_PLACE))
            self._meshcat.SetProperty(path, "visible", False, time_in_recording=0.0)
        for name, visible in ((self._shown, False), (word, True)):
            if name:
                self._meshcat.SetProperty(
                    f"{_PATH}/{name}", "visible", visible, time_in_recording=time
                )
        self._shown = word


def _outline(word: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Line segments (3, n) from and to, upright in the plane y = 0 [m]."""
    from matplotlib.textpath import TextPath

    polygons: Any = TextPath((0.0, 0.0), word, size=1.0).to_polygons(closed_only=False)
    begin = np.vstack([polygon[:-1] for polygon in polygons])
    end = np.vstack([polygon[1:] for polygon in polygons])
    # Capital letters of that font are 0.73 high.
    scale = _HEIGHT / 0.73
    flat = [scale * np.column_stack([p[:, 0], np.zeros(len(p)), p[:, 1]]).T for p in (begin, end)]
    return flat[0], flat[1]


class OperationWatch:
    """Looks at a running operation: shows its phase, and ends it when there is nothing to come."""

    def __init__(
        self,
        loop: ClosedLoop[Any],
        steps: int,
        label: PhaseLabel | None,
        ends_at_fault: bool = False,
    ):
        self._has_arm = has_arm(loop.scenario)
        loop.require((*_WATCHED, *(_WATCHED_OF_ARM if self._has_arm else ())))
        self._loop, self._steps, self._label = loop, steps, label
        self._ends_at_fault = ends_at_fault
        self._operator = loop.GetSubsystemByName("operator_script")
        self._phase: Phase | None = None
        self._entered, self._refused_at = 0.0, np.inf
        self._refusal, self._margin = [0, 0], np.nan

    def look(self, root_context: Context) -> EventStatus:
        """Monitor of the simulator."""
        now = root_context.get_time()
        phase = Phase(int(self._read(root_context, "phase")[0]))
        if phase is not self._phase:
            self._phase, self._entered = phase, now
            if self._label is not None:
                self._label.show(phase.name, now)
        if not np.isfinite(self._refused_at) and self._is_refused(root_context):
            # What the operator asks for next is not what was refused.
            self._refused_at = now
            self._refusal = self._read(root_context, "refusal").astype(int).tolist()
            if self._has_arm:
                self._margin = float(self._read(root_context, "arm_margin")[0])
        if self._is_faulty and now > self._entered + _STANDING:
            return EventStatus.ReachedTermination(self._loop.controller, "fault")
        if now > self._refused_at + _STANDING:
            return EventStatus.ReachedTermination(self._loop.controller, "refused")
        if not self.steps_left(root_context):
            return EventStatus.ReachedTermination(self._loop.controller, "done")
        return EventStatus.DidNothing()

    def steps_left(self, root_context: Context) -> int:
        """Number of the operator's steps that are still to come."""
        return self._steps - int(value_of(self._operator, "steps_done", root_context)[0])

    @property
    def _is_faulty(self) -> bool:
        """Whether a fault has occurred that cannot be reset."""
        return self._ends_at_fault and self._phase is Phase.FAULT

    def _is_refused(self, root_context: Context) -> bool:
        if self._read(root_context, "refusal")[0] != Refusal.NONE:
            return True
        if not self._has_arm:
            return False
        # The arm's request is judged anew once the posture is held.
        judged = root_context.get_time() > self._entered + _JUDGED
        in_hold = self._phase is Phase.HOLD and judged
        return in_hold and bool(self._read(root_context, "arm_refused")[0] > 0.5)

    def _read(self, root_context: Context, port: str) -> NDArray[np.float64]:
        return value_of(self._loop.controller, port, root_context)

    def raise_refusal(self, root_context: Context) -> None:
        """Says what was refused, or found to be wrong, if anything was.

        Raises:
            Tripped: a fault that ends the run, since it is not reset.
            UnreachablePosture: a ground that cannot be levelled, or a posture out of reach.
            RefusedRequest: anything else.
        """
        if self._is_faulty:
            findings = self._read(root_context, "findings")
            broken_rules = [rule for rule in RULES if findings[rule.finding] > 0.5]
            worst = max(broken_rules, key=lambda rule: rule.severity)
            raise Tripped(Trip(worst.finding.name.lower(), worst.sign))
        if not np.isfinite(self._refused_at):
            return
        code, detail = self._refusal
        phase = Phase(int(self._read(root_context, "phase")[0])).name.lower()
        if code in (Refusal.GROUND, Refusal.POSTURE):
            self._raise_unreachable(root_context, phase)
        if code == Refusal.NO_GROUND:
            raise RefusedRequest(f"leg {detail} found no ground within its stroke", phase)
        if code == Refusal.COMMAND:
            raise RefusedRequest(
                f"the operator's command has no place in {Phase(detail).name.lower()}", phase
            )
        if code == Refusal.CAUSE:
            raise RefusedRequest("no reset: the fault's cause is not gone", phase)
        if code == Refusal.UNSETTLED:
            limit = SupervisorParams.estimate_limit
            raise RefusedRequest(
                f"the ground could not be estimated: the attitude has not settled in {limit:g} s",
                phase,
            )
        margin = self._margin
        if not np.isfinite(margin):
            monitor = self._loop.scenario.machine.stability_monitor
            limits = ", ".join(
                f"{joint.name} {joint.shown(low)} to {joint.shown(high)}"
                for joint, (low, high) in zip(
                    monitor.platform.arm.joints, monitor.reach, strict=True
                )
            )
            raise RefusedRequest(f"the arm's move goes beyond its joints' limits: {limits}", phase)
        raise RefusedRequest(
            f"the arm's move would leave {1e3 * margin:.0f} mm to the edge between the feet, "
            f"which must be {1e3 * _least_margin(self._loop):.0f} mm or more",
            phase,
        )

    def _raise_unreachable(self, root_context: Context, phase: str) -> None:
        posture = value_of(self._operator, "posture_request", root_context)
        standing = (
            self._read(root_context, "ground_estimated"),
            self._read(root_context, "foot_offsets_estimated"),
        )
        geometry = self._loop.scenario.geometry_as_known
        try:
            inverse_kinematics(geometry, posture, *standing)
        except UnreachablePosture as error:
            hint = describe_range(geometry, posture, *standing)
            raise UnreachablePosture(
                error.leg,
                error.extension,
                error.admissible,
                hint=f"{hint}; the machine stays in {phase}",
            ) from None


def operated_platform(
    machine: LevellingScenario, height: float, controls: Controls, meshcat: Meshcat | None = None
) -> ClosedLoop[LevellingScenario]:
    """The platform with its supervisor, operated by a person.

    Args:
        machine: the platform.
        height: height of the posture that is asked for at first [m].
        controls: the person's sliders and buttons.
        meshcat: scene in which a simulated platform is drawn; None for no drawing.
    """
    if meshcat is not None:
        meshcat.Delete(_PATH)  # the word of a recording
    return ClosedLoop(
        PLATFORM,
        machine,
        meshcat=meshcat,
        controller=partial(make_supervised_controller, is_operated=True),
        sources=(
            OperatorControls(
                controls,
                height,
                machine.geometry_as_known,
                period=0.02,
                joints=machine.machine.masses.arm.joints,
            ),
        ),
        log=(),
    )


def has_arm(scenario: LevellingScenario) -> bool:
    """Whether a platform has an arm."""
    return scenario.machine.masses.arm.count > 0


def _least_margin(loop: ClosedLoop[Any]) -> float:
    return usual_margin(loop.scenario.machine.geometry)


def read_operation(loop: ClosedLoop[Any], root_context: Context) -> Readout:
    """Phase, posture, margin, faults and refusals."""
    controller = loop.controller
    read = partial(value_of, controller, root_context=root_context)
    phase = Phase(int(read("phase")[0]))
    readings = read_posture(loop, root_context, "posture_request")
    margin = 1e3 * float(read("stability_margin")[0])
    least = 1e3 * _least_margin(loop)
    rows = list(readings.rows) if phase in (Phase.POSTURE, Phase.HOLD) else [readings.rows[-1]]
    if np.isfinite(margin):  # on its wheels it has none
        rows.append(Row("margin", least, margin, None, "mm", 0))
    findings = read("findings")
    broken_rules = [rule for rule in RULES if findings[rule.finding] > 0.5]
    remarks = [f"{rule.finding.name.lower()}: {rule.sign}" for rule in broken_rules]
    if phase in _ADVICE:
        remarks.append(_ADVICE[phase])
    code = Refusal(int(read("refusal")[0]))
    if code is not Refusal.NONE:
        remarks.append(f"refused: {_REFUSED[code]}")
    if has_arm(loop.scenario) and read("arm_refused")[0] > 0.5 and phase is Phase.HOLD:
        remarks.append("refused: the arm's move would leave too small a margin")
    is_alarming = bool(broken_rules) or phase is Phase.FAULT
    idle = [name for name, phases in _OBEYED.items() if phase not in phases]
    if phase is not Phase.HOLD:
        joints = loop.scenario.machine.masses.arm.joints
        idle += [slider_of(joint)[0] for joint in joints]
    return Readout(phase.name.lower(), rows, remarks, is_alarming, idle)
