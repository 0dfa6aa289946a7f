"""One page that needs no network: the machine, a slider of time, and plots below."""

import base64
import gzip
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from parapod.sims.lab.figures import COLOURS
from parapod.sims.lab.pages import render_page
from parapod.sims.replay.digest import Digest
from parapod.sims.replay.drawing import RecordedScene
from parapod.sims.replay.replay import Replay, near_limits
from parapod.systems.core.extras import need

_SPEEDS = (0.1, 0.25, 0.5, 1, 2, 5, 10, 60, 600)
# A log is played in so many seconds at most, unless somebody asks for another speed.
_LONGEST = 300.0
# Height of a plot, and of what stands above all of them and below [pixel].
_HEIGHT, _ABOVE, _BELOW = 190, 40, 44
_GAP = 58  # between two plots, with the legend of the lower one
_NAMED = 0.012  # share of the width that a letter of a phase's name takes
_BAND = ("rgba(90,120,150,0.16)", "rgba(90,120,150,0.04)")
# A first signal is seen under those that follow it.
_WIDE, _NARROW = 2.6, 1.2
_LIMIT = "rgba(140,140,140,0.9)"


def make_page(replay: Replay, against: Replay | None, scene: RecordedScene | None) -> str:
    """The page.

    Args:
        replay: a log.
        against: one that is laid over it, or None.
        scene: the machine's; None where the machine is not drawn.

    Raises:
        MissingExtra: plotly is not installed.
    """
    plotly: str = need("plotly.offline").get_plotlyjs()
    subject, digest = replay.subject, replay.digest
    logs = [replay] if against is None else [replay, against]
    begin, end = span([each.digest for each in logs])
    traces = [trace for number, each in enumerate(logs) for trace in _traces(each, number)]
    remarks = [text for each in logs for text in each.remarks]
    speeds = [speed for speed in _SPEEDS if speed <= 1.0 or (end - begin) / speed >= 1.0]
    layout = _layout(logs, (begin, end))
    content = {
        "begin": begin,
        "end": end,
        "decimals": 3 if end - begin < 10.0 else 2,
        "phases": [vars(phase) for phase in digest.phases],
        "pale": {} if scene is None else dict(scene.pale),
        "traces": traces,
        "layout": layout,
        "height": layout["height"],
        "count": len(replay.plots),
        "black": [k for k, trace in enumerate(traces) if trace["line"]["color"] == "#000000"],
    }
    packed = {"plotly": plotly} | ({"meshcat": scene.page} if scene else {})
    return render_page(
        __package__ or "",
        title=subject.title,
        logs=[[each.subject.label, *each.subject.facts] for each in logs],
        remarks=list(dict.fromkeys(remarks)),
        scene=scene is not None,
        speeds=speeds,
        usual_speed=next((s for s in speeds if s >= 1 and (end - begin) / s <= _LONGEST), 1),
        begin=begin,
        end=end,
        content=_as_script(content),
        packed={name: _packed(text) for name, text in packed.items()},
    )


def span(digests: Sequence[Digest]) -> tuple[float, float]:
    """First and last time of some logs [s]."""
    return min(each.begin for each in digests), max(each.end for each in digests)


def _traces(replay: Replay, number: int) -> list[dict[str, Any]]:
    traces = []
    for k, plot in enumerate(replay.plots, start=1):
        for colour, curve in enumerate(plot.curves):
            line = replay.digest.lines[curve.signal]
            suffix = "" if k == 1 else str(k)
            traces.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": plot.legend[colour],
                    "x": _array(line.time, "f8"),
                    "y": _array(plot.factor * line.values[:, curve.element], "f4"),
                    "xaxis": f"x{suffix}",
                    "yaxis": f"y{suffix}",
                    "legend": f"legend{suffix}",
                    "legendgroup": f"{k} {curve.label}",  # one entry for both logs
                    "showlegend": number == 0,
                    "line": {
                        "color": COLOURS[colour % len(COLOURS)],
                        "width": _WIDE if plot.is_first(curve) else _NARROW,
                        "dash": "5px,3px" if number else "solid",
                    },
                    "hovertemplate": f"%{{y:.5~g}} {plot.unit}"
                    f"<extra>{curve.label}{' (other)' if number else ''}</extra>",
                }
            )
    return traces


def _layout(logs: Sequence[Replay], ends: tuple[float, float]) -> dict[str, Any]:
    plots, digest = logs[0].plots, logs[0].digest
    count = len(plots)
    inner = count * _HEIGHT + (count - 1) * _GAP
    layout: dict[str, Any] = {
        "height": inner + _ABOVE + _BELOW,
        "margin": {"l": 62, "r": 14, "t": _ABOVE, "b": _BELOW},
        "font": {"size": 12},
        "hovermode": "x",
        "hoversubplots": "axis",
        "dragmode": "zoom",
        "shapes": [],
        "annotations": [],
    }
    for k, plot in enumerate(plots, start=1):
        suffix = "" if k == 1 else str(k)
        top = 1.0 - (k - 1) * (_HEIGHT + _GAP) / inner
        bottom = top - _HEIGHT / inner
        layout[f"xaxis{suffix}"] = {
            "anchor": f"y{suffix}",
            "range": list(ends),
            "showticklabels": k == count,
            "ticks": "outside",
            "zeroline": False,
            "showspikes": False,
            **({"matches": "x"} if k > 1 else {}),
            **({"title": {"text": "time [s]", "standoff": 6}} if k == count else {}),
        }
        layout[f"yaxis{suffix}"] = {
            "domain": [max(0.0, bottom), top],
            "anchor": f"x{suffix}",
            "title": {"text": f"[{plot.unit}]", "standoff": 4},
            "automargin": True,
            "exponentformat": "e",
        }
        layout[f"legend{suffix}"] = {
            "orientation": "h",
            "x": 0,
            "y": top,
            "yanchor": "bottom",
            "font": {"size": 10},
            "bgcolor": "rgba(0,0,0,0)",
            "entrywidth": 0,
        }
        for limit in near_limits(logs, k - 1):
            layout["shapes"].append(
                {
                    "type": "line",
                    "xref": f"x{suffix} domain",
                    "x0": 0,
                    "x1": 1,
                    "yref": f"y{suffix}",
                    "y0": limit,
                    "y1": limit,
                    "line": {"color": _LIMIT, "width": 1, "dash": "dot"},
                }
            )
        for number, phase in enumerate(digest.phases):
            layout["shapes"].append(
                {
                    "type": "rect",
                    "layer": "below",
                    "xref": f"x{suffix}",
                    "x0": phase.begin,
                    "x1": phase.end,
                    "yref": f"y{suffix} domain",
                    "y0": 0,
                    "y1": 1,
                    "line": {"width": 0},
                    "fillcolor": _BAND[number % 2],
                }
            )
    for phase in digest.phases:
        if phase.end - phase.begin >= _NAMED * len(phase.name) * (ends[1] - ends[0]):
            layout["annotations"].append(
                {
                    "text": phase.name,
                    "x": 0.5 * (phase.begin + phase.end),
                    "xref": "x",
                    "yref": "y domain",
                    "y": 1.0,
                    "yanchor": "top",
                    "showarrow": False,
                    "font": {"size": 10},
                    "opacity": 0.7,
                }
            )
    return layout


def _array(values: Any, kind: str) -> dict[str, str]:
    """Numbers as plotly takes them without a text for each."""
    data = np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    return {"dtype": kind, "bdata": base64.b64encode(data).decode()}


def _as_script(content: Any) -> Any:
    """JSON that no text in it can end the script of."""
    from markupsafe import Markup

    text = json.dumps(content, allow_nan=False, ensure_ascii=False)
    return Markup(text.replace("<", "\\u003c"))


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()
