"""Figures of the experiment `calibrate`."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from parapod.sims.lab.figures import COLOURS, Figure
from parapod.sims.levelling_platform.calibrate import Comparison
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    LEG_PARAMETERS,
    LEG_WIDTH,
)
from parapod.systems.levelling_platform.calibration.solve import Calibration
from parapod.systems.levelling_platform.geometry import LEG_COUNT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

type Floats = NDArray[np.float64]

_DEG = float(np.degrees(1.0))
_CALIBRATED, _OTHER = COLOURS[0], COLOURS[1]
# What is shown of the largest error's decades.
_DECADES = 1e-3
# As people write the parameters.
_SYMBOLS = {"beta": r"$\beta$", "alpha": r"$\alpha$", "offset": "offset"}


def figures(
    calibration: Calibration, tolerance: Floats, truth: Floats | None, comparison: Comparison
) -> tuple[Figure, ...]:
    """What can be drawn of a calibration.

    Args:
        calibration: the result.
        tolerance: (36) of the parameters.
        truth: (36) parameters of the simulated machine, or None.
        comparison: on poses that were not used.
    """
    known = "" if truth is None else " Crosses: the simulated machine."
    return (
        Figure(
            "calibrate_parameters",
            "Calibrated parameters",
            "Deviations from the drawing in tolerances, with one standard deviation; shaded: what "
            "the tolerances alone say. Only combinations of l_3, l_4, alpha and offset are sure: "
            f"together they place the foot to a few hundredths of a millimetre.{known}",
            partial(_draw_parameters, calibration, tolerance, truth),
            (10.0, 3.6),
        ),
        Figure(
            "calibrate_residuals",
            "Posture predicted on poses that were not used",
            "Share of the poses whose error is smaller, for the drawing and for the calibrated "
            "machine.",
            partial(_draw_residuals, comparison),
            (9.0, 3.0),
        ),
    )


def _draw_parameters(
    calibration: Calibration, tolerance: Floats, truth: Floats | None, canvas: "Canvas"
) -> None:
    ratios = [LEG_WIDTH] * LEG_COUNT + [2]
    panels = canvas.subplots(1, len(ratios), sharey=True, gridspec_kw={"width_ratios": ratios})
    legs = [slice(LEG_WIDTH * i, LEG_WIDTH * (i + 1)) for i in range(LEG_COUNT)]
    names = [_SYMBOLS.get(name, rf"${name[0]}_{name[2]}$") for name in LEG_PARAMETERS]
    for i, (axes, part) in enumerate(zip(panels, [*legs, BIAS], strict=True)):
        is_leg = i < LEG_COUNT
        _draw_group(axes, calibration, tolerance, truth, part)
        axes.set_title(f"leg {i + 1}" if is_leg else "bias", fontsize=9)
        labels = names if is_leg else ["roll", "pitch"]
        axes.set_xticks(range(len(labels)), labels, rotation=90 if not is_leg else 0)
        for label in axes.get_xticklabels():
            if label.get_text() == "offset":
                label.set_rotation(90)
        axes.grid(visible=False, axis="x")
    panels[0].set_ylabel("deviation [tolerances]")
    handles, labels = panels[0].get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)


def _draw_group(
    axes: "Axes", calibration: Calibration, tolerance: Floats, truth: Floats | None, part: slice
) -> None:
    unit = tolerance[part]
    x = np.arange(len(unit))
    spread = float((calibration.prior[part] / unit).max())
    axes.axhspan(-spread, spread, color="0.92", zorder=0, label="tolerance alone")
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
    if truth is not None:
        axes.plot(x, truth[part] / unit, "x", color=_OTHER, markersize=6, label="simulated")
    axes.errorbar(
        x,
        calibration.parameters[part] / unit,
        calibration.standard_deviations[part] / unit,
        fmt="o",
        color=_CALIBRATED,
        markersize=4,
        capsize=2,
        label="calibrated",
    )
    axes.set_xlim(-0.6, len(unit) - 0.4)


def _draw_residuals(comparison: Comparison, canvas: "Canvas") -> None:
    panels = canvas.subplots(1, 3, sharey=True)
    columns = (("height", "mm", 2, 1e3), ("roll", "deg", 0, _DEG), ("pitch", "deg", 1, _DEG))
    for axes, (name, unit, column, scale) in zip(panels, columns, strict=True):
        for label, prediction, colour in (
            ("drawing", comparison.nominal, _OTHER),
            ("calibrated", comparison.calibrated, _CALIBRATED),
        ):
            error = np.sort(np.abs(prediction.posture[:, column])) * scale
            share = np.arange(1, len(error) + 1) / len(error)
            axes.step(error, 100.0 * share, where="post", color=colour, label=label)
        axes.set_xscale("log")
        # Errors that happen to be next to nothing would take most of the axis.
        axes.set_xlim(
            left=_DECADES * float(np.abs(comparison.nominal.posture[:, column]).max()) * scale
        )
        axes.set_xlabel(f"error of {name} [{unit}]")
    panels[0].set_ylabel("share of the poses [%]")
    panels[0].legend(loc="upper left", fontsize=8)
