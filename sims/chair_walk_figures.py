"""Figures of a walk of the chair."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.chair_walk_metrics import body_desired
from parapod.sims.figures import COLOURS, Figure
from parapod.sims.job import Signals
from parapod.sims.results import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_BRANCHES = ("UP", "UPS 2", "UPS 3")


def figures(
    result: Result, scenario: ChairScenario, time: NDArray[np.float64], signals: Signals
) -> Result:
    """The result with the figures that its signals allow."""
    drawn: tuple[Figure, ...] = (_currents(scenario, time, signals),)
    if "truth.body_position" in signals:
        drawn = (_body(scenario, time, signals), *drawn, _margin(scenario, time, signals))
    return replace(result, figures=drawn)


def _shade_swings(axes: "Axes", time: NDArray[np.float64], signals: Signals) -> None:
    """Shades the times at which two feet are in the air."""
    swings = signals["support"].min(axis=1) < 0.5
    edges = np.flatnonzero(np.diff(np.concatenate(([False], swings, [False])).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        axes.axvspan(time[begin], time[min(end, len(time) - 1)], color="0.93", zorder=0)


def _body(scenario: ChairScenario, time: NDArray[np.float64], signals: Signals) -> Figure:
    desired = body_desired(scenario, signals)
    true = signals["truth.body_position"]
    error = 1e3 * (true - desired)
    attitude = np.degrees(signals["truth.body_attitude"])

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(2, 2, sharex=True)
        for row in axes.ravel():
            _shade_swings(row, time, signals)
        for axis, name, colour in ((1, "ahead y", COLOURS[0]), (2, "up z", COLOURS[1])):
            start = desired[0, axis]
            axes[0, 0].plot(time, 1e3 * (desired[:, axis] - start), color=colour, lw=3, alpha=0.3)
            axes[0, 0].plot(time, 1e3 * (true[:, axis] - start), color=colour, label=name)
        axes[0, 0].set_ylabel("body, from its start [mm]")
        axes[0, 0].legend(ncols=2, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        for axis, name in enumerate("xyz"):
            axes[0, 1].plot(time, error[:, axis], label=name)
            label = ("roll", "pitch", "yaw")[axis]
            axes[1, 0].plot(time, attitude[:, axis], label=label)
        axes[0, 1].set_ylabel("error of the body [mm]")
        axes[1, 0].set_ylabel("attitude [deg]")
        heights = 1e3 * signals["truth.foot_height"].reshape(-1, 4, 3).min(axis=2)
        for leg in range(4):
            axes[1, 1].plot(time, heights[:, leg], label=f"leg {leg + 1}")
        axes[1, 1].set_ylabel("lowest corner [mm]")
        for panel in (axes[0, 1], axes[1, 0], axes[1, 1]):
            panel.legend(ncols=4, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        for panel in axes[1]:
            panel.set_xlabel("time [s]")

    return Figure(
        "chair_walk_body",
        "The walk",
        "Where the body is (pale: where the gait has it), how far it is off, and the feet; "
        "two feet are in the air where the ground is grey.",
        draw,
        (9.0, 5.0),
    )


def _currents(scenario: ChairScenario, time: NDArray[np.float64], signals: Signals) -> Figure:
    currents = signals["legs.current"].reshape(-1, 4, 3)

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(1, 4, sharex=True, sharey=True)
        for leg, panel in enumerate(axes):
            _shade_swings(panel, time, signals)
            for branch, name in enumerate(_BRANCHES):
                panel.plot(time, currents[:, leg, branch], label=name)
            panel.set(title=f"leg {leg + 1}", xlabel="time [s]")
        axes[0].set_ylabel("motor current [A]")
        handles = axes[0].get_legend_handles_labels()
        canvas.legend(*handles, loc="outside upper center", ncols=3)

    return Figure(
        "chair_walk_currents",
        "Currents of the motors",
        "With all branches equally stiff (Fig. 17 for 57 kg; its branches 1 carry more).",
        draw,
        (9.0, 3.2),
    )


def _margin(scenario: ChairScenario, time: NDArray[np.float64], signals: Signals) -> Figure:
    margin = 1e3 * signals["support_margin"][:, 0]
    payload = signals["payload_estimated"]

    def draw(canvas: "Canvas") -> None:
        left, right = canvas.subplots(1, 2, sharex=True)
        for panel in (left, right):
            _shade_swings(panel, time, signals)
            panel.set_xlabel("time [s]")
        left.plot(time, margin, label="this phase and the next")
        required = scenario.control.support_margin_mm
        left.axhline(required, color=COLOURS[1], label="required")
        left.set(ylabel="support margin [mm]", ylim=(0.0, None))
        left.legend(ncols=2, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        known = time >= scenario.begin
        mass = payload[known, 0] - scenario.passenger.mass_kg
        right.plot(time[known], mass, label="mass [kg]")
        places = (scenario.passenger.x_mm, scenario.passenger.y_mm)
        for axis, (name, place) in enumerate(zip("xy", places, strict=True), start=1):
            away = 1e3 * payload[known, axis] - place
            right.plot(time[known], away, label=f"{name} of its centre [mm]")
        right.set_ylabel("error of the estimated payload")
        right.legend(ncols=3, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return Figure(
        "chair_walk_margin",
        "Support margin and payload",
        "From the motors' currents alone: how far the centre of mass is inside the support "
        "polygon, and how well the passenger is known.",
        draw,
        (9.0, 3.2),
    )
