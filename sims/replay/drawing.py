"""Recording of a machine in the browser's scene, drawn from logs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from parapod.diagrams.twin import DESIRED, MEASURED, PALE
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.subject import Subject
from parapod.sims.output.progress import counted
from parapod.sims.output.scene_page import bare_page
from parapod.sims.replay.digest import Digest
from parapod.sims.replay.replay import Replay
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import printable

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


_OTHER = "other_"
_ROOT = "/drake/"  # root of paths in Meshcat's scene
_TRANSLUCENT = 0.4  # opacity
_FASTEST = 64.0  # pictures a second


@dataclass(frozen=True)
class RecordedScene:
    """Meshcat's page with a recording.

    Attributes:
        page: the page.
        pale: opacity of what is under a path. Meshcat's page forgets it: it takes the property of
            a path before there is anything under it.
    """

    page: str
    pale: Mapping[str, float]


def record(
    replay: Replay, against: Replay | None, begin: float, console: Console
) -> RecordedScene | None:
    """The scene in which the machine moves as its log shows.

    Args:
        replay: a log.
        against: another one whose machine is drawn translucent, or None.
        begin: time in the logs at which the recording begins [s].
        console: console for progress.

    Returns:
        The scene; None where no machine can be drawn.
    """
    drawable = [each for each in (replay, against) if each is not None and each.subject.drawn]
    if not drawable:
        return None
    host = drawable[0].subject
    meshcat = scene_of(host)
    rate = min(_FASTEST, max(_rate(each.digest) for each in drawable))
    meshcat.StartRecording(rate)
    pale: dict[str, float] = {}
    pictures_done = 0
    for number, each in enumerate(drawable):
        prefix = _OTHER if number else ""
        try:
            _draw(each, meshcat, prefix, begin, rate, console)
        except (ParapodError, RuntimeError, ValueError) as error:  # of Drake and numpy, too
            each.subject.give_up(printable(error))
            for drawing in (MEASURED, DESIRED):
                meshcat.Delete(prefix + drawing)
            continue
        pictures_done += 1
        pale[f"{_ROOT}{prefix}{DESIRED}"] = PALE
        if against is not None:  # translucent is the other machine, not what is asked for
            meshcat.SetProperty(prefix + DESIRED, "visible", False)
        if each is against:
            pale[f"{_ROOT}{prefix}{MEASURED}"] = _TRANSLUCENT
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return RecordedScene(bare_page(meshcat.StaticHtml()), pale) if pictures_done else None


def _draw(
    replay: Replay, meshcat: "Meshcat", prefix: str, begin: float, rate: float, console: Console
) -> None:
    """Draws one log's machine.

    Raises:
        ParapodError: its signals are not those of the machine.
    """
    pictures, drawing = replay.digest.pictures, replay.subject.drawn
    assert drawing is not None
    twin = drawing.make(meshcat, prefix)
    with counted(console, f"drawing {replay.subject.label}", len(pictures)) as report:
        for count, (time, row) in enumerate(pictures):
            # In the middle of a frame, so that no rounding puts two into one.
            frame = round((time - begin) * rate)
            twin.show(drawing.values(row), (frame + 0.5) / rate)
            report(count)


def scene_of(subject: Subject) -> "Meshcat":
    """The scene; that of the experiment that the machine names, where its own has none."""
    experiment: Any = subject.experiment
    scenario = subject.scenario
    if not hasattr(experiment, "scene"):
        experiment = find_experiment(subject.machine.experiment)  # type: ignore[union-attr]
        scenario = subject.machine_scenario()
    # Its default where the log has the machine's only.
    is_its = isinstance(scenario, experiment.schema)
    meshcat: Meshcat = experiment.scene(scenario if is_its else experiment.schema())
    return meshcat


def _rate(digest: Digest) -> float:
    """Pictures a second of a digest."""
    times = np.array([time for time, _ in digest.pictures])
    step = float(np.median(np.diff(times))) if len(times) > 1 else math.inf
    return 1.0 / step if step > 0.0 else _FASTEST
