"""Walk over a curved panel between two rows of holes that are drilled: Figs. 7 and 8.

One foot after the other is let go while joints are locked, swung by all legs, and clamped where it
has come to. The walk's plan is found, and refused where a leg, a lock or the drill would not do.

| multibody, 1 ms | tripod | quadruped |
|---|---|---|
| tip while machining, rms, with thrust / outside | .037 / .040 mm | .030 / .033 mm |
| foot from its foothold, largest | .25 mm | .56 mm |
| platform sinks when a clamp opens | .47 mm | 1.84 mm |
| foot's way in the second after its clamp has closed | .07 mm | .004 mm |
| tip's error after the walk | .11 mm | .38 mm |
| largest force of a leg | 340 N | 350 N |

Encoders do not see legs yield, but currents show their forces: `control.knows_stiffness` has the
posture account for it, which leaves a fifth of the drift of a walk (.39 mm of 1.85 mm after two
steps of each foot).
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.recording import spans
from parapod.diagrams.style import COLOURS
from parapod.sims.lab.run import Run
from parapod.sims.machining_centre.jobs import (
    CentreJob,
    rms,
    shade_phases,
    tip_errors,
)
from parapod.sims.output.figures import draw_bound
from parapod.sims.output.results import Metric
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.job import Swing
from parapod.systems.machining_centre.sequence import Phase

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Bounds of the paper's centre; those in mm go with its size [mm, mrad, mm, mm].
_FOOT, _DRIFT, _JUMP, _MACHINED = 1.0, 0.1, 0.1, 0.5
# Largest distance of its feet from their way, in sum over all steps [mm].
_SHORT = 1.0
# Time after a clamp has closed in which its foot might jump [s].
_AFTER = 1.0


class CentreWalk(CentreJob):
    """Machines, walks, and machines again."""

    takes = "1 min"

    needed_key = ("walk.advance_mm", "goes nowhere")
    picture = (
        "centre_walk",
        "A walk between two rows of holes",
        "Blue: drilling, orange: a foot swings, grey: the platform goes where the next "
        "swing begins. Figs. 7 and 8 show such a cycle without numbers.",
        (8.0, 5.0),
    )

    def of_truth(self, scenario: CentreScenario, run: Run) -> Iterator[Metric]:
        """See `CentreJob`."""
        return _walk_metrics(scenario, run)

    def draw_truth(self, scenario: CentreScenario, run: Run, canvas: "Canvas") -> None:
        """See `CentreJob`."""
        _draw(scenario, run, canvas)


def _walk_metrics(scenario: CentreScenario, run: Run) -> Iterator[Metric]:
    n = scenario.machine.limbs
    plan, feet = scenario.plan, run["truth.feet"].reshape(len(run.time), n, 6)
    panel = plan.job.panel
    travelled = panel.place(feet[-1, :, :3]) - panel.place(plan.beginning.feet[:, :3])
    shift = np.array(plan.shift)
    walked = travelled[:, :2] @ shift / np.linalg.norm(shift)
    whole, size = scenario.stop_at is None, scenario.machine.geometry.size
    yield Metric(
        "walked_mm",
        1e3 * float(walked.min()),
        "mm",
        at_least=scenario.walk.advance_mm - size * _SHORT if whole else None,
        meaning="smallest advance of any foot, in the direction of the walk",
    )
    yield Metric(
        "foot_error_mm",
        1e3 * _foot_error(scenario, run, feet),
        "mm",
        size * _FOOT,
        meaning="largest distance of a clamped foot from its foothold of the plan",
    )
    drift, jump, sink = _switched(run, feet)
    yield Metric(
        "lock_drift_mrad",
        1e3 * drift,
        "mrad",
        _DRIFT,
        meaning="largest drift of a joint while it is locked",
    )
    yield Metric(
        "clamp_jump_mm",
        1e3 * jump,
        "mm",
        size * _JUMP,
        meaning=f"largest way of a foot in the {_AFTER:g} s after its clamp has closed",
    )
    yield Metric(
        "platform_sink_mm",
        1e3 * sink,
        "mm",
        meaning="largest way of the platform when a clamp is opened",
    )
    yield Metric(
        "clamp_gap_mm",
        1e3 * float(run["truth.clamp_gap"][run["clamps.closed"] > 0.5].max()),
        "mm",
        meaning="largest distance of a clamped foot from its clamp, which yields with the step",
    )
    machining = run["phase"][:, 0] == Phase.MACHINING
    if machining.any():
        tip, _ = tip_errors(plan.job.process, run)
        after = machining & (run["operation"][:, 0] > scenario.holes.count)
        if after.any():
            yield Metric(
                "position_error_mm",
                1e3 * rms(tip[after]),
                "mm",
                size * _MACHINED,
                meaning="error of the drill's tip after the walk, by the known footholds",
            )
        first = machining & ~after
        yield Metric(
            "position_error_before_mm",
            1e3 * rms(tip[first]),
            "mm",
            size * _MACHINED,
            meaning="error of the drill's tip before the walk",
        )


def _foot_error(scenario: CentreScenario, run: Run, feet: Array) -> float:
    """Largest distance of a foot from its foothold once its swing is done [m]."""
    operations, worst = scenario.plan.job.operations, 0.0
    for number, operation in enumerate(operations, start=1):
        settled = np.flatnonzero(run["operation"][:, 0] >= number)
        if isinstance(operation, Swing) and settled.size:
            foot = feet[settled[0], operation.lock_set.limb - 1, :3]
            worst = max(worst, float(np.linalg.norm(foot - operation.foothold[:3])))
    return worst


def _switched(run: Run, feet: Array) -> tuple[float, float, float]:
    """Largest drift of a lock [rad], jump of a clamped foot, and sinking of the platform [m]."""
    drift = jump = sink = 0.0
    locked, joints = run["locks.closed"] > 0.5, run["truth.joints"]
    for k in range(locked.shape[1]):
        for begin, end in spans(locked[:, k]):
            drift = max(drift, float(np.ptp(joints[begin:end, k])))
    clamped = run["clamps.closed"] > 0.5
    samples = max(1, round(_AFTER / float(np.median(np.diff(run.time)))))
    for i in range(clamped.shape[1]):
        for begin, end in spans(~clamped[:, i]):
            after = feet[end : end + samples, i, :3]
            if len(after):
                jump = max(jump, float(np.linalg.norm(after - after[0], axis=-1).max()))
            # Until the foot is swung the platform only yields.
            swung = begin + int(np.argmax(run["phase"][begin:end, 0] == Phase.SWING))
            way = run["truth.pose"][begin:swung, :3] - run["truth.pose"][max(begin - 1, 0), :3]
            if len(way):
                sink = max(sink, float(np.linalg.norm(way, axis=-1).max()))
    return drift, jump, sink


def _draw(scenario: CentreScenario, run: Run, canvas: "Canvas") -> None:
    axes: Any = canvas.subplots(2, 2)
    panel, n = scenario.plan.job.panel, scenario.machine.limbs
    feet = panel.place(run["truth.feet"].reshape(len(run.time), n, 6)[..., :3])
    platform = panel.place(run["truth.pose"][:, :3])
    for i in range(n):
        axes[0, 0].plot(1e3 * feet[:, i, 0], 1e3 * feet[:, i, 1], color=COLOURS[i], lw=1)
        for k, marker in ((0, "o"), (-1, "s")):
            axes[0, 0].plot(*(1e3 * feet[k, i, :2]), marker, color=COLOURS[i], ms=5)
        axes[0, 1].plot(run.time, 1e3 * feet[:, i, 2], color=COLOURS[i], label=f"foot {i + 1}")
    axes[0, 0].plot(*(1e3 * platform[:, :2].T), color="0.4", lw=0.8, label="platform")
    axes[0, 0].set(xlabel="along the panel [mm]", ylabel="across [mm]", aspect="equal")
    axes[0, 1].set(ylabel="height of the feet [mm]")
    axes[0, 1].legend(ncols=4, fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    tip, _ = tip_errors(scenario.plan.job.process, run)
    axes[1, 0].plot(run.time, 1e3 * tip, color=COLOURS[0])
    axes[1, 0].set(ylabel="error of the tip [mm]", ylim=(0.0, None))
    bound = scenario.machine.geometry.size * _MACHINED
    draw_bound(axes[1, 0], bound, "bound of the root mean square")
    for leg, force in enumerate(run["truth.leg_force"].T):
        axes[1, 1].plot(run.time, force, color=COLOURS[leg // 2], lw=0.8)
    axes[1, 1].set(ylabel="forces of the legs [N]")
    for plot in (axes[0, 1], axes[1, 0], axes[1, 1]):
        shade_phases(plot, run)
        plot.set_xlabel("time [s]")
