"""Write the layouts for Foxglove: a machine in its 3D panel, and its usual plots beside it.

python docs/foxglove/layouts.py
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from parapod.diagrams.machine import Machine, list_machines
from parapod.diagrams.plots import parse
from parapod.sims.output.logs.scene_messages import SCENE, WORLD
from parapod.systems.core.extras import need


def as_layout(machine: Machine[Any]) -> str:
    """The layout of a machine's logs, as the text of a file that Foxglove imports.

    Raises:
        MissingExtra: Foxglove's package is not installed.
    """
    fl = need("foxglove.layouts")
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
            topics={SCENE: fl.BaseRendererSceneUpdateTopicSettings(visible=True)},
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
    """Message paths of a plot's curves, with quotes for the dots in names of topics."""
    for each in text.split("+"):
        name, elements = parse(each) or (each, None)
        if elements is None:  # of a signal whose size is left open the first
            elements = range(machine.table[name].size or 1)
        yield from (f'"{name}".value[{element}]' for element in elements)


if __name__ == "__main__":
    for machine in list_machines():
        Path(__file__).with_name(f"{machine.name}.json").write_text(as_layout(machine))
