"""Write the layouts for Foxglove: a machine in its 3D panel, and its usual plots beside it.

python docs/foxglove/layouts.py
"""

import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from parapod.diagrams.machine import Machine, list_machines
from parapod.diagrams.plots import parse
from parapod.sims.output.drawn_bodies import WORLD
from parapod.sims.output.logs.part_messages import part_messages
from parapod.sims.output.logs.scene_messages import SCENE


def as_layout(machine: Machine[Any]) -> str:
    """The layout of a machine's logs, as the text of a file that Foxglove imports.

    Raises:
        ImportError: foxglove-sdk is not installed.
    """
    fl: Any = importlib.import_module("foxglove.layouts")
    plots = [
        fl.PlotPanel(
            config=fl.PlotConfig(
                paths=[fl.PlotSeries(value=path) for path in _paths(machine, text)],
                show_legend=True,
                is_synced=True,
            )
        )
        for text in machine.view.plots
    ]
    scene = fl.ThreeDeePanel(
        config=fl.ThreeDeeConfig(
            fixed_frame=WORLD,
            follow_tf=WORLD,
            topics={SCENE: fl.BaseRendererRosMarkerTopicSettings(visible=True)},
        )
    )
    column = [fl.SplitItem(proportion=1, content=plot) for plot in plots]
    layout = fl.Layout(
        content=fl.SplitContainer(
            direction="row",
            items=[
                fl.SplitItem(proportion=1, content=scene),
                fl.SplitItem(
                    proportion=1, content=fl.SplitContainer(direction="column", items=column)
                ),
            ],
        )
    )
    return json.dumps(json.loads(layout.to_json()), indent=1) + "\n"


def _paths(machine: Machine[Any], text: str) -> Iterator[str]:
    """Message paths of a plot's curves."""
    sizes = {name: port.size for name, port in machine.table.items()}
    fields = {
        signal.name: f"{part.topic}.{signal.field}"
        for part in part_messages(dict.fromkeys(sizes, ""), [*sizes.values()])
        for signal in part.signals
    }
    for each in text.split("+"):
        name, elements = parse(each) or (each, None)
        if elements is None and sizes[name] > 1:
            elements = range(sizes[name])
        # A signal whose size is left open is a number, where a plot does not say otherwise.
        yield from (
            [fields[name]] if elements is None else (f"{fields[name]}[{k}]" for k in elements)
        )


if __name__ == "__main__":
    for machine in list_machines():
        Path(__file__).with_name(f"{machine.name}.json").write_text(as_layout(machine))
