"""One page that needs no network: the machine, a slider of time, and plots below."""

import base64
import gzip
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from parapod.sims.lab.pages import render_page
from parapod.sims.lab.stacked_plots import axis, black, layout, library, limit_line, traces
from parapod.sims.replay.digest import Digest
from parapod.sims.replay.drawing import RecordedScene
from parapod.sims.replay.replay import Replay, least_ends, near_limits

_SPEEDS = (0.1, 0.25, 0.5, 1, 2, 5, 10, 60, 600)
# Longest time in which a log is played, unless another speed is chosen [s].
_LONGEST = 300.0
_NAMED = 0.012  # share of the width that a letter of a phase's name takes
_BAND = ("rgba(90,120,150,0.16)", "rgba(90,120,150,0.04)")


def make_page(replay: Replay, against: Replay | None, scene: RecordedScene | None) -> str:
    """The page.

    Args:
        replay: a log.
        against: one that is laid over it, or None.
        scene: the machine's; None where the machine is not drawn.

    Raises:
        MissingExtra: plotly is not installed.
    """
    plotly = library()
    subject, digest = replay.subject, replay.digest
    logs = [replay] if against is None else [replay, against]
    begin, end = span([each.digest for each in logs])
    traces = [trace for number in range(len(logs)) for trace in _traces(logs, number)]
    remarks = [text for each in logs for text in each.remarks]
    speeds = [speed for speed in _SPEEDS if speed <= 1.0 or (end - begin) / speed >= 1.0]
    axes = _layout(logs, (begin, end))
    content = {
        "begin": begin,
        "end": end,
        "decimals": 3 if end - begin < 10.0 else 2,
        "phases": [vars(phase) for phase in digest.phases],
        "pale": {} if scene is None else dict(scene.pale),
        "traces": traces,
        "layout": axes,
        "height": axes["height"],
        "count": len(replay.plots),
        "black": black(traces),
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


def _traces(logs: Sequence[Replay], number: int) -> list[dict[str, Any]]:
    """Curves of one of the logs, dashed of another one than the first."""
    each, page_traces = logs[number], []
    curves = [(plot, curve) for plot in each.plots for curve in plot.curves]
    for trace, (plot, curve) in zip(traces(each.plots), curves, strict=True):
        if not each.has(curve):
            continue
        trace["x"] = _array(each.digest.lines[curve.signal].time, "f8")
        trace["y"] = _array(each.values(plot, curve), "f4")
        trace["showlegend"] = not any(before.has(curve) for before in logs[:number])
        trace["line"]["dash"] = "5px,3px" if number else "solid"
        if number:
            trace["hovertemplate"] = trace["hovertemplate"].replace("</extra>", " (other)</extra>")
        page_traces.append(trace)
    return page_traces


def _layout(logs: Sequence[Replay], ends: tuple[float, float]) -> dict[str, Any]:
    """Axes of the plots, with limits and phases."""
    phases = logs[0].digest.phases
    page_layout = layout(logs[0].plots)
    page_layout["shapes"] = []
    for k in range(len(logs[0].plots)):
        x, y = axis("x", k), axis("y", k)
        page_layout[axis("xaxis", k)]["range"] = list(ends)
        if least := least_ends(logs, k):
            page_layout[axis("yaxis", k)]["autorangeoptions"] = {"include": list(least)}
        plot = logs[0].plots[k]
        for limit in near_limits(logs, k):
            of = plot.place_of_limit(limit)
            colours = () if of is None else (plot.colours[of],)
            page_layout["shapes"].append(limit_line(k, limit, *colours))
        page_layout["shapes"] += [
            {
                "type": "rect",
                "layer": "below",
                "xref": x,
                "x0": phase.begin,
                "x1": phase.end,
                "yref": f"{y} domain",
                "y0": 0,
                "y1": 1,
                "line": {"width": 0},
                "fillcolor": _BAND[number % 2],
            }
            for number, phase in enumerate(phases)
        ]
    page_layout["annotations"] = [
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
        for phase in phases
        if phase.end - phase.begin >= _NAMED * len(phase.name) * (ends[1] - ends[0])
    ]
    return page_layout


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
