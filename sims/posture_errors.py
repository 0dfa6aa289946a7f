"""Errors of postures in the units in which people read them, as metrics and as figures."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.sims.figures import COLOURS, Figure
from parapod.sims.results import Metric

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# A posture's elements: key of the error, unit, what the axis of a figure says.
AXES = (
    ("roll_error_deg", "deg", "roll [deg]"),
    ("pitch_error_deg", "deg", "pitch [deg]"),
    ("height_error_mm", "mm", "height [mm]"),
)


def in_deg_and_mm(posture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Postures (..., 3) in deg, deg, mm instead of rad, rad, m."""
    return posture * [math.degrees(1.0), math.degrees(1.0), 1e3]


def error_metrics(
    error: NDArray[np.float64],
    prefix: str = "",
    bounds: tuple[float | None, float | None] = (None, None),
    paper: tuple[float | None, float | None, float | None] = (None, None, None),
    meaning: str = "",
) -> list[Metric]:
    """The largest errors as metrics `<prefix>roll_error_deg`, and so on.

    Args:
        error: (n, 3) errors [deg, deg, mm].
        prefix: of the keys.
        bounds: of the angles [deg] and of the height [mm]; None for none.
        paper: what the paper reports of roll, pitch [deg] and height [mm].
        meaning: of the first metric, for people.
    """
    largest = np.abs(error).max(axis=0)
    return [
        Metric(
            prefix + key,
            float(largest[i]),
            unit,
            bounds[0] if unit == "deg" else bounds[1],
            paper=paper[i],
            meaning="likewise" if i and meaning else meaning,
        )
        for i, (key, unit, _) in enumerate(AXES)
    ]


def posture_figure(
    name: str,
    title: str,
    caption: str,
    time: NDArray[np.float64],
    lines: dict[str, NDArray[np.float64]],
    reference: str,
) -> Figure:
    """Roll, pitch and height over time, above their errors against one of the lines.

    Args:
        name: of the figure's file.
        title: a few words.
        caption: a sentence or two.
        time: (n) [s].
        lines: label -> (n, 3) posture [deg, deg, mm].
        reference: label of the line that the others are compared with.
    """

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(2, 3, sharex=True, height_ratios=(2, 1))
        for i, (_, _, label) in enumerate(AXES):
            for k, (line, posture) in enumerate(lines.items()):
                width = 2.2 if line == reference else 1.0
                colour = COLOURS[k % len(COLOURS)]
                axes[0, i].plot(time, posture[:, i], color=colour, linewidth=width, label=line)
                if line != reference:
                    error = posture[:, i] - lines[reference][:, i]
                    axes[1, i].plot(time, error, color=colour, linewidth=1.0)
            axes[0, i].set_ylabel(label)
            axes[1, i].set_ylabel(f"error [{label.split('[')[1]}")
            axes[1, i].set_xlabel("time [s]")
        canvas.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)

    return Figure(name, title, caption, draw, (9.0, 4.4))
