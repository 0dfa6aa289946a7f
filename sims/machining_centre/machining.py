"""Drill a row of inclined holes into a curved panel, all feet clamped, with the drill's thrust.

Six axes at once: each hole has its own normal and is inclined besides. What the legs cannot carry
is refused before the first hole.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.plots import Limits
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
from parapod.systems.machining_centre.sequence import Phase

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Bounds of the tip's error, root mean square, without load and with it, and of the depth's, of the
# paper's centre [mm].
_FREE, _LOADED = 0.3, 0.5
_DEPTH = 0.1
# The material is felt from this thrust on [N].
_FELT = 1.0


class CentreMachining(CentreJob):
    """Drills the holes."""

    takes = "20 s"

    needed_key = ("holes.count", "drills nothing")
    picture = (
        "centre_machining",
        "A row of holes",
        "Blue: drilling. Above the error of the drill's tip, with its bound, and its "
        "thrust; below the legs' forces, and what the posture resists in every direction "
        "beyond drill and weight.",
        (8.0, 4.6),
    )

    def limits(self, scenario: CentreScenario) -> Limits:
        """Those of the machine, and the margin: all feet stand, so none may be without."""
        return {**super().limits(scenario), "wrench_margin": (0.0, None)}

    def of_truth(self, scenario: CentreScenario, run: Run) -> Iterator[Metric]:
        """See `CentreJob`."""
        return _errors(scenario, run)

    def draw_truth(self, scenario: CentreScenario, run: Run, canvas: "Canvas") -> None:
        """See `CentreJob`."""
        _draw(scenario, run, canvas)


def _errors(scenario: CentreScenario, run: Run) -> Iterator[Metric]:
    machining = run["phase"][:, 0] == Phase.MACHINING
    loaded = machining & (run["tool.force"][:, 0] > _FELT)
    tip, angle = tip_errors(scenario.plan.job.process, run)
    size, has_thrust = scenario.machine.geometry.size, scenario.process.thrust_N > 0.0
    yield Metric(
        "position_error_mm",
        1e3 * rms(tip[machining]),
        "mm",
        size * (_LOADED if has_thrust else _FREE),
        meaning="error of the drill's tip, root mean square while machining",
        undefined="the drill did not machine",
    )
    yield Metric(
        "position_error_free_mm",
        1e3 * rms(tip[machining & ~loaded]),
        "mm",
        size * _FREE,
        meaning="error of the drill's tip, root mean square outside the material",
        undefined="the drill was always in the material",
    )
    yield Metric(
        "angle_error_mrad",
        1e3 * rms(angle[machining]),
        "mrad",
        meaning="angle error of the platform, root mean square while machining",
        undefined="the drill did not machine",
    )
    if has_thrust:
        yield Metric(
            "peak_thrust_N",
            float(run["tool.force"][:, 0].max()),
            "N",
            meaning="largest thrust on the drill",
        )
    deepest = -float(run["truth.tip_height"][machining].min())
    depth = 1e-3 * scenario.holes.depth_mm * np.cos(np.radians(scenario.holes.tilt_deg))
    if scenario.stop_at is None:
        yield Metric(
            "depth_error_mm",
            1e3 * (deepest - depth),
            "mm",
            size * _DEPTH,
            meaning="depth error of the deepest hole, along the panel's normal",
        )
        holes = len(scenario.plan.job.operations)
        yield Metric(
            "holes",
            float(run["operation"][-1, 0]),
            at_least=holes,
            meaning="drilled holes",
        )


def _draw(scenario: CentreScenario, run: Run, canvas: "Canvas") -> None:
    axes: Any = canvas.subplots(2, 2, sharex=True)
    for panel in axes.ravel():
        shade_phases(panel, run)
    tip, _ = tip_errors(scenario.plan.job.process, run)
    axes[0, 0].plot(run.time, 1e3 * tip, color=COLOURS[0])
    axes[0, 0].set(ylabel="error of the tip [mm]", ylim=(0.0, None))
    bound = _LOADED if scenario.process.thrust_N > 0.0 else _FREE
    bound *= scenario.machine.geometry.size
    draw_bound(axes[0, 0], bound, "bound of the root mean square")
    axes[0, 1].plot(run.time, run["tool.force"][:, 0], color=COLOURS[1])
    axes[0, 1].set_ylabel("thrust [N]")
    for leg, force in enumerate(run["truth.leg_force"].T):
        style = "-" if leg % 2 == 0 else "--"
        axes[1, 0].plot(
            run.time,
            force,
            style,
            color=COLOURS[leg // 2],
            label=f"limb {leg // 2 + 1}" if leg % 2 == 0 else None,
        )
    axes[1, 0].set_ylabel("forces of the legs [N]")
    axes[1, 0].legend(ncols=4, fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    axes[1, 1].plot(run.time, run["wrench_margin"][:, 0], color=COLOURS[2])
    axes[1, 1].set(ylabel="wrench margin [N]", ylim=(0.0, None))
    for panel in axes[1]:
        panel.set_xlabel("time [s]")
