"""The whole operation (section 2.2): drive there, stand up, work, leave.

Nobody tells the platform about the ground. It drives on four wheels with its legs up, brakes,
lowers each leg until its contact switch closes, estimates the ground and how uneven it is, lifts
its wheels, takes the commanded posture, holds it while the arm works, and goes away again.
"""

from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus, System

from parapod.diagrams.levelling_platform.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.deployment import make_deployment
from parapod.diagrams.levelling_platform.scenario import SIMULATED
from parapod.sims.deploy_metrics import NEEDED, measure
from parapod.sims.deploy_scenario import DeployScenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.levelling_job import make_scene
from parapod.sims.phase_label import PhaseLabel
from parapod.sims.results import Result
from parapod.sims.signal_units import with_units
from parapod.sims.simulate import in_real_time, recording, simulate, write_graphviz
from parapod.systems.core.errors import RefusedRequest, UnreachablePosture
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.reference import describe_range
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitorParams
from parapod.systems.levelling_platform.supervisor import Phase, Refusal

# A refusal ends the operation after this long, in which the machine is seen to stand [s].
_STANDING = 2.0
# After this long in a phase its requests have been judged [s].
_JUDGED = 0.1


def run(scenario: DeployScenario, options: RunOptions) -> Result:
    """Carries out the operation.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        UnreachablePosture: a ground that cannot be levelled, or a posture out of reach.
        RefusedRequest: something else that the machine does not do.
        OutputError: a file cannot be written.
    """
    machine, steps = scenario.machine, scenario.steps()
    meshcat = make_scene(machine) if options.meshcat or options.html else None
    log = NEEDED if options.log is None else None
    loop = make_deployment(machine, steps, scenario.work.posture, meshcat, log)
    if options.graphviz is not None:
        write_graphviz(options.graphviz, loop.diagram)
    simulator = Simulator(loop.diagram)
    loop.reset(simulator.get_mutable_context())
    watch = _Watch(loop, len(steps), PhaseLabel(meshcat) if meshcat is not None else None)
    simulator.set_monitor(watch.look)
    if meshcat is not None and options.meshcat:
        where = f"The platform is shown at {meshcat.web_url()}"
        options.console.print(where, markup=False, highlight=False, soft_wrap=True)
    shown = options.html if meshcat is not None else None
    with (
        recording(meshcat, shown) if meshcat is not None and shown else nullcontext(),
        in_real_time(simulator) if options.meshcat else nullcontext(),
    ):
        simulator.Initialize()  # The first phase is shown in the recording too.
        elapsed = simulate(simulator, scenario.longest, options.console, "deploy")
    context = simulator.get_context()
    time, signals = loop.recorded(context)
    if options.log is not None:
        write_experiment_log(options.log, "deploy", scenario, time, with_units(signals))
    watch.raise_refusal(context)
    return measure(
        scenario, watch.steps_left(context), time, signals, context.get_time() / elapsed
    )


class _Watch:
    """Looks at a running operation: shows its phase, and ends it when there is nothing to come."""

    def __init__(self, loop: ClosedLoop, steps: int, label: PhaseLabel | None):
        self._loop, self._steps, self._label = loop, steps, label
        self._operator = loop.diagram.GetSubsystemByName("operator_script")
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
            self._margin = float(self._read(root_context, "arm_margin")[0])
        if now > self._refused_at + _STANDING:
            return EventStatus.ReachedTermination(self._loop.controller, "refused")
        if not self.steps_left(root_context):
            return EventStatus.ReachedTermination(self._loop.controller, "done")
        return EventStatus.DidNothing()

    def steps_left(self, root_context: Context) -> int:
        """Number of the operator's steps that are still to come."""
        return self._steps - int(_value(self._operator, "steps_done", root_context)[0])

    def _is_refused(self, root_context: Context) -> bool:
        if self._read(root_context, "refusal")[0] != Refusal.NONE:
            return True
        # The arm's request is judged anew once the posture is held.
        judged = root_context.get_time() > self._entered + _JUDGED
        in_hold = self._phase is Phase.HOLD and judged
        return in_hold and bool(self._read(root_context, "arm_refused")[0] > 0.5)

    def _read(self, root_context: Context, port: str) -> NDArray[np.float64]:
        return _value(self._loop.controller, port, root_context)

    def raise_refusal(self, root_context: Context) -> None:
        """Says what was refused, if anything was.

        Raises:
            UnreachablePosture: a ground that cannot be levelled, or a posture out of reach.
            RefusedRequest: anything else.
        """
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
        margin, params = self._margin, StabilityMonitorParams()
        if not np.isfinite(margin):
            turn, swing = np.degrees(params.reach)
            limits = f"{swing:.0f} deg of the arm or {turn:.0f} deg of the turntable"
            raise RefusedRequest(f"the arm's move goes beyond {limits}", phase)
        raise RefusedRequest(
            f"the arm's move would leave {1e3 * margin:.0f} mm to the edge between the feet, "
            f"which must be {1e3 * params.margin:.0f} mm or more",
            phase,
        )

    def _raise_unreachable(self, root_context: Context, phase: str) -> None:
        posture = _value(self._operator, "posture_request", root_context)
        standing = (
            self._read(root_context, "ground_estimated"),
            self._read(root_context, "foot_offsets_estimated"),
        )
        try:
            inverse_kinematics(MODEL_GEOMETRY, posture, *standing)
        except UnreachablePosture as error:
            hint = describe_range(MODEL_GEOMETRY, posture, *standing)
            raise UnreachablePosture(
                error.leg,
                error.extension,
                error.admissible,
                hint=f"{hint}; the machine stays in {phase}",
            ) from None


def _value(system: System, port: str, root_context: Context) -> NDArray[np.float64]:
    value: Any = system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(root_context))
    return np.asarray(value)


EXPERIMENT = Experiment(
    name="deploy",
    summary="The whole operation: the platform drives there, stands up, works and leaves.",
    scenario=DeployScenario,
    backends=SIMULATED,
    run=run,
)
