"""Recording of a machine in the browser's scene, drawn from logs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from parapod.diagrams.twin import DESIRED, MEASURED, PALE
from parapod.sims.lab.progress import counted
from parapod.sims.lab.subject import Subject
from parapod.sims.replay.digest import Digest
from parapod.sims.replay.replay import Replay

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from parapod.diagrams.twin import Twin

_OTHER = "other_"
_ROOT = "/drake/"  # of paths in Meshcat's scene
_TRANSLUCENT = 0.4  # opacity
_FASTEST = 64.0  # pictures a second


@dataclass(frozen=True)
class Scene:
    """Meshcat's page with a recording.

    Attributes:
        page: the page.
        pale: opacity of what is under a path. Meshcat's page forgets it: it takes the property of
            a path before there is anything under it.
    """

    page: str
    pale: Mapping[str, float]


def record(replay: Replay, against: Replay | None, begin: float, console: Console) -> Scene | None:
    """The scene in which the machine moves as its log tells.

    Args:
        replay: a log.
        against: another one whose machine is drawn translucent, or None.
        begin: time in the logs at which the recording begins [s].
        console: console for progress.

    Returns:
        The scene; None where no machine can be drawn.
    """
    shown = [each for each in (replay, against) if each is not None and each.subject.drawn_by]
    if not shown:
        return None
    host = shown[0].subject
    experiment: Any = host.experiment
    meshcat = experiment.scene(_scene_scenario(host))
    rate = min(_FASTEST, max(_rate(each.digest) for each in shown))
    meshcat.StartRecording(rate)
    total = sum(len(each.digest.pictures) for each in shown)
    done, pale = 0, {}
    with counted(console, f"drawing {host.label}", total) as report:
        for number, each in enumerate(shown):
            twin = _twin(each.subject, meshcat, _OTHER if number else "")
            for time, row in each.digest.pictures:
                # In the middle of a frame, so that no rounding puts two into one.
                frame = round((time - begin) * rate)
                twin.show(each.subject.values(row), (frame + 0.5) / rate)
                done += 1
                report(done)
            pale[f"{_ROOT}{twin.path(DESIRED)}"] = PALE
            if against is not None:  # translucent is the other machine, not what is asked for
                meshcat.SetProperty(twin.path(DESIRED), "visible", False)
            if each is against:
                pale[f"{_ROOT}{twin.path(MEASURED)}"] = _TRANSLUCENT
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return Scene(meshcat.StaticHtml(), pale)


def _scene_scenario(subject: Subject) -> Any:
    """Scenario for the scene; its experiment's default where the log has the machine's only."""
    experiment: Any = subject.experiment
    if isinstance(subject.scenario, experiment.schema):
        return subject.scenario
    return experiment.schema()


def _twin(subject: Subject, meshcat: "Meshcat", prefix: str) -> "Twin":
    assert subject.machine is not None
    assert subject.machine.twin is not None
    return subject.machine.twin(meshcat, subject.machine_scenario(), prefix)


def _rate(digest: Digest) -> float:
    """Pictures a second of a digest."""
    times = np.array([time for time, _ in digest.pictures])
    step = float(np.median(np.diff(times))) if len(times) > 1 else math.inf
    return 1.0 / step if step > 0.0 else _FASTEST
