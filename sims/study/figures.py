"""Figures of a study, in order of worth: maps of what holds, contributions, distributions."""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter  # type: ignore[import-untyped]

from parapod.diagrams.style import BOUND, COLOURS
from parapod.sims.output.figures import Figure
from parapod.sims.study.records import ALL_HELD, Column, Records
from parapod.sims.study.sensitivity import Contributions, contributions
from parapod.sims.study.study import Study
from parapod.sims.study.variables import Variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

type Array = NDArray[np.float64]

_HELD, _BROKEN, _REFUSED = COLOURS[2], COLOURS[1], "0.55"
# Beginning of the names of maps.
MAP = "border_"
# Metrics, panels, pairs and variables that are drawn; more of them would be too small to read.
_MOST_METRICS, _MOST_PANELS, _MOST_PAIRS, _MOST_VARIABLES = 12, 4, 3, 5
# Width of figures, as wide as the page, and of maps, two of which stand beside each other [inch].
_WIDTH, _MAP = 9.0, (6.0, 4.6)
# Height of a panel [inch]; size of letters, 10 pixels of the page or more [pt].
_PANEL, _LETTERS = 1.7, 8.5
# Cells along each variable of a map, and mean number of runs in each that is aimed at, where runs
# do not lie on a grid; there the border is that of shares smoothed over this number of cells.
_CELLS, _IN_CELL = 24, 8
# Most cells along a variable of a grid, whose runs have one each.
_MOST_CELLS = 200
# Size of the marks of runs, and of all those along an axis together [pt].
_MARK, _MARKS = 3.5, 180.0
_SMOOTHED = 1.0
# Points of runs are drawn as pixels: as shapes a million of them would be a page of gigabytes.
_PIXELS: dict[str, Any] = {"rasterized": True}


def draw_study(study: Study, records: Records) -> Iterator[Figure]:
    """The figures of what has been carried out; none where nothing has.

    Args:
        study: the study.
        records: runs of the study.
    """
    if not records.done.any():
        return
    bounded = [column for column in records.columns if column.is_bounded]
    # Those nearest to their bounds first.
    ranked = sorted(bounded, key=lambda c: -np.nan_to_num(_largest(c.use), nan=-1.0))
    metrics_shown = sorted(ranked[:_MOST_METRICS], key=bounded.index)
    shares = contributions(study.sampling, [records.verdict, *metrics_shown])
    numbers = [v for v in study.variables if v.is_number and v.key != "seed"]
    decisive = list(numbers)
    if shares and shares[0].key == ALL_HELD:
        keys = [variable.key for variable in study.variables]
        decisive.sort(key=lambda variable: -shares[0].total[keys.index(variable.key)])
    for one, other in itertools.islice(itertools.combinations(decisive, 2), _MOST_PAIRS):
        yield _map_of_feasibility(study, records, one, other)
    if shares:
        yield _contributions(study, shares)
    if ranked and numbers:
        yield _scatter(study, records, ranked[:_MOST_PANELS], numbers[:_MOST_VARIABLES])
    if metrics_shown:
        yield _distributions(metrics_shown, records)


def _largest(values: Array) -> float:
    return float(np.nanmax(values)) if not np.isnan(values).all() else math.nan


def _distributions(columns: Sequence[Column], records: Records) -> Figure:
    count = int(records.done.sum())
    width = min(4, len(columns))
    rows = math.ceil(len(columns) / width)

    def draw(canvas: "Canvas") -> None:
        axes = canvas.subplots(rows, width, squeeze=False).ravel()
        for ax, column in itertools.zip_longest(axes, columns):
            if column is None:
                ax.set_visible(False)
            else:
                _histogram(ax, column)

    caption = (
        f"Each metric over those of {count} runs that measured it, in green where its bound "
        "(dashed) is held and in orange where it is broken."
    )
    size = (_WIDTH, _PANEL * rows + 0.2)
    return Figure("distributions", "Distributions against the bounds", caption, draw, size)


def _histogram(ax: "Axes", column: Column) -> None:
    is_finite = column.is_there & np.isfinite(column.values)
    values, is_held = column.values[is_finite], column.held[is_finite]
    limits = [column.limit(limits) for limits in (column.bound, column.at_least)]
    signed = values.min(initial=0.0) < 0.0 and limits[0] is not None
    ends = [*values, *(x for x in limits if x is not None)]
    if signed and limits[0] is not None:
        ends.append(-limits[0])
    edges = np.linspace(min(ends, default=0.0), max(ends, default=1.0), 41)
    colours = {"color": [_HELD, _BROKEN], "stacked": True}
    ax.hist([values[is_held], values[~is_held]], edges, **colours)  # type: ignore[arg-type]
    for limit in (*limits, -limits[0] if signed and limits[0] is not None else None):
        if limit is not None:
            ax.axvline(limit, **BOUND)
    infinite_count = int((column.is_there & ~np.isfinite(column.values)).sum())
    if infinite_count:
        ax.set_title(
            f"{infinite_count} not finite", fontsize=_LETTERS, color=_BROKEN, loc="right", pad=2
        )
    ax.set_xlabel(_label(column), fontsize=_LETTERS)
    ax.set_yticks([])
    ax.tick_params(labelsize=_LETTERS)
    ax.spines["left"].set_visible(False)
    ax.grid(visible=False)


def _label(column: Column) -> str:
    """Name with its unit, which most names end with already."""
    name = column.key.removesuffix(f"_{column.unit}").replace("_", " ")
    return f"{name} [{column.unit}]" if column.unit else name


def _contributions(study: Study, shares: Sequence[Contributions]) -> Figure:
    names = [variable.key for variable in study.variables]

    def draw(canvas: "Canvas") -> None:
        ax = canvas.subplots()
        middle = np.arange(len(shares), dtype=float)
        height = 0.8 / len(names)
        for i, name in enumerate(names):
            at = middle - 0.4 + (i + 0.5) * height
            colour = COLOURS[i % len(COLOURS)]
            total = np.array([one.total[i] for one in shares])
            low, high = (
                np.array([getattr(one, end)[i] for one in shares]) for end in ("low", "high")
            )
            error = np.abs(np.stack((total - low, high - total)))
            style = {"linewidth": 0.8, "ecolor": "0.4", "capsize": 1.5}
            ax.barh(at, total, height, color=colour, alpha=0.35, xerr=error, error_kw=style)
            ax.barh(at, [one.first[i] for one in shares], height, color=colour, label=name)
        ax.set_yticks(middle, [one.key for one in shares], fontsize=_LETTERS)
        ax.invert_yaxis()
        ax.set_xlim(0.0, 1.05)
        ax.set_xlabel("share of the variance")
        columns = min(3, len(names))
        ax.legend(fontsize=_LETTERS, ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0))

    is_exact = study.sampling.kind == "grid"
    how = "exact for the grid" if is_exact else "with the 95 % interval of the total share"
    caption = (
        "Sobol indices of each metric: the share of its variance that a variable has alone "
        f"(full colour) and that in which it has a part (pale), {how}."
    )
    size = (_WIDTH, 1.2 + max(0.14 * len(names), 0.3) * len(shares))
    return Figure("contributions", "What each variable contributes", caption, draw, size)


def _scatter(
    study: Study, records: Records, columns: Sequence[Column], variables: Sequence[Variable]
) -> Figure:
    values = {variable.key: _numbers(study, records, variable) for variable in variables}
    runs_done = np.flatnonzero(records.done)

    def draw(canvas: "Canvas") -> None:
        axes = canvas.subplots(
            len(columns), len(variables), squeeze=False, sharex="col", sharey="row"
        )
        for row, column in zip(axes, columns, strict=True):
            use, is_held = column.use[runs_done], column.held[runs_done]
            is_finite = np.isfinite(use)
            for ax, variable in zip(row, variables, strict=True):
                x = values[variable.key]
                for which, colour in ((is_held, _HELD), (~is_held, _BROKEN)):
                    which = which & is_finite
                    style = {"color": colour, "markersize": 2.5}
                    ax.plot(x[which], 100.0 * use[which], ".", **_PIXELS | style)
                ax.axhline(100.0, **BOUND)
                ax.set_ylim(bottom=0.0)
                ax.tick_params(labelsize=_LETTERS)
            row[0].set_ylabel(f"{column.key}\n[% of its bound]", fontsize=_LETTERS)
        for ax, variable in zip(axes[-1], variables, strict=True):
            ax.set_xlabel(variable.key, fontsize=_LETTERS)

    caption = (
        "The metrics that come nearest to their bounds, over each variable: share of the bound "
        "that each run uses; above the dashed line the bound is broken."
    )
    size = (_WIDTH, 0.5 + _PANEL * len(columns))
    return Figure("over_variables", "Metrics over the variables", caption, draw, size)


def _numbers(study: Study, records: Records, variable: Variable) -> Array:
    """Values of a variable in the runs that have been carried out."""
    place = study.variables.index(variable)
    runs = np.flatnonzero(records.done).tolist()
    return np.array([study.sampling.values(run)[place] for run in runs], float)


def _map_of_feasibility(study: Study, records: Records, one: Variable, other: Variable) -> Figure:
    x, y = (_numbers(study, records, variable) for variable in (one, other))
    runs_done = np.flatnonzero(records.done)
    is_passed, refused = records.passed[runs_done], records.refused[runs_done]

    def draw(canvas: "Canvas") -> None:
        ax = canvas.subplots()
        most = _MOST_CELLS if study.sampling.kind == "grid" else _CELLS
        xs, ys = _edges(x, most), _edges(y, most)
        every, _, _ = np.histogram2d(x, y, (xs, ys))
        counts, _, _ = np.histogram2d(x[is_passed], y[is_passed], (xs, ys))
        with np.errstate(invalid="ignore"):
            share = 100.0 * counts / every  # NaN where no run is
        scale: Any = {"cmap": _map(), "vmin": 0.0, "vmax": 100.0}
        image = ax.pcolormesh(xs, ys, share.T, **_PIXELS | scale)
        _draw_contour(ax, (xs, ys), counts, every)
        size = min(_MARK, _MARKS / max(xs.size, ys.size))
        for which, marker, colour, label in (
            (~is_passed & ~refused, "x", "0.1", "a bound is broken"),
            (refused, "+", _REFUSED, "refused or failed"),
        ):
            if which.any():
                style = {"markersize": size, "markeredgewidth": 0.23 * size, "linestyle": "none"}
                ax.plot(x[which], y[which], marker, color=colour, label=label, **_PIXELS | style)
        ax.set_xlabel(one.key)
        ax.set_ylabel(other.key)
        ax.tick_params(labelsize=_LETTERS)
        ax.grid(visible=False)
        if not is_passed.all():
            place: Any = {"loc": "upper left", "bbox_to_anchor": (0.0, 1.12), "ncols": 2}
            ax.legend(fontsize=_LETTERS, markerscale=_MARK / size, **place)
        canvas.colorbar(image, ax=ax, label="runs with all bounds held [%]")

    others = [v.key for v in study.variables if v not in (one, other)]
    over = f", over all values of {', '.join(others)}" if others else ""
    caption = (
        f"Share of the runs in which all bounds are held{over}; the line is the border between "
        "more and less than half of them."
    )
    name = f"{MAP}{one.key}_{other.key}".replace(".", "_")
    title = f"Where the bounds hold: {one.key} and {other.key}"
    return Figure(name, title, caption, draw, _MAP)


def _edges(values: Array, most: int) -> Array:
    """Edges of the cells of a map: one cell for each value unless there are more than `most`."""
    values_in_use = np.unique(values)
    if 1 < values_in_use.size <= most:
        middles = 0.5 * (values_in_use[1:] + values_in_use[:-1])
        first, last = (
            1.5 * values_in_use[0] - 0.5 * values_in_use[1],
            1.5 * values_in_use[-1] - 0.5 * values_in_use[-2],
        )
        return np.concatenate(([first], middles, [last]))
    low, high = float(values_in_use[0]), float(values_in_use[-1])
    margin = 1e-9 + 1e-6 * abs(high) if low == high else 0.0
    cells = max(4, min(_CELLS, math.isqrt(values.size // _IN_CELL)))
    return np.linspace(low - margin, high + margin, cells + 1)


def _draw_contour(ax: "Axes", edges: tuple[Array, Array], is_held: Array, every: Array) -> None:
    """The border between cells in which most runs hold all bounds and the others."""
    if min(every.shape) < 2:
        return
    if (every != every[0, 0]).any():  # not a grid: neighbours help to tell the share
        is_held, every = (
            gaussian_filter(one, _SMOOTHED, mode="nearest") for one in (is_held, every)
        )
    share = is_held / every
    if np.isfinite(share).all() and share.min() < 0.5 < share.max():
        middles = [0.5 * (ends[1:] + ends[:-1]) for ends in edges]
        ax.contour(*middles, share.T, [0.5], colors="0.1", linewidths=1.5)


def _map() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("held", ["#F6C8A8", "#FFFFFF", "#A5D8C6"])
