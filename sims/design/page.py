"""Figures and page of a search for designs."""

import math
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.style import COLOURS
from parapod.sims.design.result import SearchResult
from parapod.sims.lab.pages import render_page
from parapod.sims.output.figures import Figure
from parapod.sims.output.moment import moment

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_PALE, _FRONT = "0.75", COLOURS[1]


def figures_of(result: SearchResult) -> Iterator[Figure]:
    """Front or course of a search, and the variables of the designs in front."""
    goals = result.search.goals
    if not result.front:
        return
    if len(goals) == 1:
        yield Figure(
            "course",
            "Course of the search",
            "Each admissible design, and the best one so far.",
            partial(_draw_course, result),
            (7.0, 3.4),
        )
    for first in range(len(goals)):
        for second in range(first + 1, len(goals)):
            yield Figure(
                f"front_{goals[first].name}_{goals[second].name}".replace(":", "_"),
                "Front",
                "Admissible designs (grey), and those that no other one beats.",
                partial(_draw_front, result, first, second),
                (7.0, 4.2),
            )
    yield Figure(
        "variables",
        "Designs in front",
        "Variables by their ranges: each line is a design; colours go with the first objective.",
        partial(_draw_variables, result),
        (7.0, 3.4),
    )


def _draw_course(result: SearchResult, canvas: "Canvas") -> None:
    axes: Any = canvas.add_subplot()
    (goal,) = result.search.goals
    values = goal.sign * result.scores[0][:, 0]
    is_held = result.admissible
    axes.plot(result.runs[is_held], values[is_held], ".", color=_PALE, markersize=3.0)
    order = np.minimum if goal.sign > 0.0 else np.maximum
    axes.plot(result.runs[is_held], order.accumulate(values[is_held]), color=_FRONT)
    axes.set_xlabel("design")
    axes.set_ylabel(goal.name)


def _draw_front(result: SearchResult, first: int, second: int, canvas: "Canvas") -> None:
    axes: Any = canvas.add_subplot()
    goals = result.search.goals
    x, y = (goals[i].sign * result.scores[0][result.admissible, i] for i in (first, second))
    axes.plot(x, y, ".", color=_PALE, markersize=3.0, rasterized=len(x) > 3000)
    rows = [[d.values[goals[i].name] for i in (first, second)] for d in result.front]
    along = np.array(rows)
    style = "o-" if len(goals) == 2 else "o"
    axes.plot(*along.T, style, color=_FRONT, markersize=3.5, linewidth=0.8)
    near = result.compromise
    if near is not None:
        place = near.values[goals[first].name], near.values[goals[second].name]
        axes.annotate(
            f"{near.number}", place, xytext=(6.0, 6.0), textcoords="offset points", fontsize=9.0
        )
    # Designs far off in what is not asked for would hide the front.
    for set_limits, values, ends in (
        (axes.set_xlim, x, along[:, 0]),
        (axes.set_ylim, y, along[:, 1]),
    ):
        low, high = float(ends.min()), float(ends.max())
        room = 0.6 * (high - low) or 0.05 * abs(high) or 1.0
        set_limits(max(low - room, float(values.min()) - 0.1 * room),
                   min(high + room, float(values.max()) + 0.1 * room))  # fmt: skip
    axes.set_xlabel(goals[first].name)
    axes.set_ylabel(goals[second].name)


def _draw_variables(result: SearchResult, canvas: "Canvas") -> None:
    from matplotlib import colormaps

    axes: Any = canvas.add_subplot()
    variables = [v for v in result.search.sampling.variables if v.is_number]
    spans = []
    for variable in variables:
        if variable.quantile is not None:
            low, high = variable.quantile(np.array([0.0, 1.0])).tolist()
        else:
            low, high = min(variable.values), max(variable.values)
        spans.append((low, high))
    for place, design in enumerate(result.front):
        shares = [
            (design.settings[v.key] - low) / (high - low) if high > low else math.nan
            for v, (low, high) in zip(variables, spans, strict=True)
        ]
        colour = colormaps["viridis"](place / max(1, len(result.front) - 1))
        axes.plot(shares, ".-", color=colour, linewidth=0.8, alpha=0.7)
    names = [
        f"{v.key.rpartition('.')[2]}\n{low:g} .. {high:g}"
        for v, (low, high) in zip(variables, spans, strict=True)
    ]
    axes.set_xticks(range(len(variables)), names)
    axes.set_yticks((0.0, 1.0), ("lowest", "highest"))
    axes.set_ylim(-0.05, 1.05)


def make_page(result: SearchResult) -> str:
    """The page."""
    heads, rows = result.columns()
    return render_page(
        "parapod.sims.design",
        search=result.search,
        result=result,
        date=moment(),
        figures=list(figures_of(result)),
        heads=heads,
        rows=rows,
    )
