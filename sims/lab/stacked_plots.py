"""Plots one above the other with one axis of time, as plotly draws them in pages."""

from collections.abc import Sequence
from typing import Any

from parapod.diagrams.plots import Plot
from parapod.systems.core.extras import need

# Height of a plot, and of what stands above all of them and below [pixel].
_HEIGHT, _ABOVE, _BELOW = 190, 40, 44
_GAP = 58  # between two plots, with the legend of the lower one
# A first signal is seen under those that follow it.
_WIDE, _NARROW = 2.6, 1.2
_BLACK = "#000000"
_LIMIT = "rgba(140,140,140,0.9)"


def library() -> str:
    """Plotly's script.

    Raises:
        MissingExtra: plotly is not installed.
    """
    script: str = need("plotly.offline").get_plotlyjs()
    return script


def traces(plots: Sequence[Plot]) -> list[dict[str, Any]]:
    """A trace for each curve, in the order of the plots, as plotly takes it; without points."""
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": plot.legend[place],
            "xaxis": axis("x", k),
            "yaxis": axis("y", k),
            "legend": axis("legend", k),
            "legendgroup": f"{k} {curve.label}",  # one entry where a curve is drawn twice
            "line": {
                "color": plot.colours[place],
                "width": _WIDE if plot.is_first(curve) else _NARROW,
            },
            "hovertemplate": f"%{{y:.5~g}} {plot.unit}<extra>{curve.label}</extra>",
        }
        for k, plot in enumerate(plots)
        for place, curve in enumerate(plot.curves)
    ]


def black(curves: Sequence[dict[str, Any]]) -> list[int]:
    """Indices of the traces that are white on a dark page."""
    return [k for k, trace in enumerate(curves) if trace["line"]["color"] == _BLACK]


def layout(plots: Sequence[Plot]) -> dict[str, Any]:
    """Axes and legends; `height` is that of a page on which each plot is easily read [pixel]."""
    count = len(plots)
    inner = count * _HEIGHT + (count - 1) * _GAP
    figure_layout: dict[str, Any] = {
        "height": inner + _ABOVE + _BELOW,
        "margin": {"l": 62, "r": 14, "t": _ABOVE, "b": _BELOW},
        "font": {"size": 12},
        "hovermode": "x",
        "hoversubplots": "axis",
        "dragmode": "zoom",
    }
    for k, plot in enumerate(plots):
        top = 1.0 - k * (_HEIGHT + _GAP) / inner
        is_last = k == count - 1
        figure_layout[axis("xaxis", k)] = {
            "anchor": axis("y", k),
            "showticklabels": is_last,
            "ticks": "outside",
            "zeroline": False,
            "showspikes": False,
            **({"matches": "x"} if k else {}),
            **({"title": {"text": "time [s]", "standoff": 6}} if is_last else {}),
        }
        figure_layout[axis("yaxis", k)] = {
            "domain": [max(0.0, top - _HEIGHT / inner), top],
            "anchor": axis("x", k),
            "title": {"text": plot.quantity, "standoff": 4},
            "automargin": True,
            "exponentformat": "e",
        }
        figure_layout[axis("legend", k)] = {
            "orientation": "h",
            "x": 0,
            "y": top,
            "yanchor": "bottom",
            "font": {"size": 10},
            "bgcolor": "rgba(0,0,0,0)",
            "entrywidth": 0,
        }
    return figure_layout


def limit_line(place: int, limit: float, colour: str = _LIMIT) -> dict[str, Any]:
    """A limit, drawn through the plot at a place.

    Args:
        place: place of the plot, counted from 0.
        limit: value on its axis.
        colour: colour of the curve to which it belongs; by default it belongs to all curves.
    """
    return {
        "type": "line",
        "xref": f"{axis('x', place)} domain",
        "x0": 0,
        "x1": 1,
        "yref": axis("y", place),
        "y0": limit,
        "y1": limit,
        "line": {"color": colour, "width": 1, "dash": "dot"},
    }


def axis(kind: str, place: int) -> str:
    """Plotly's name for an axis or a legend of the plot at a place, counted from 0."""
    return kind if place == 0 else f"{kind}{place + 1}"
