"""What every experiment needs to run: simulating with progress, viewing, recording, drawing."""

import gc
import logging
import math
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, MeshcatAnimation, MeshcatParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram
from rich.console import Console

from parapod.sims.experiment import progress
from parapod.sims.outputs import atomic_output
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path

# Simulated time between two reports of progress, and between two chances for Ctrl-C [s].
_CHUNK = 0.25
_FRAMES_PER_SECOND = 30.0
_RENDERED = (".svg", ".png", ".pdf")
_AS_TEXT = (".dot", ".gv")


def simulate(simulator: Simulator, until: float, console: Console, what: str) -> float:
    """Advances a simulation and shows how far it is.

    Args:
        simulator: initialized; may have a target rate.
        until: simulated time at the end, unless a monitor ends it before [s].
        console: where progress is shown.
        what: what is going on, in a word or two.

    Returns:
        The wall-clock time that the simulation itself took [s].
    """
    gc.collect()  # Diagrams of earlier runs must not be collected while the clock runs.
    begin = simulator.get_context().get_time()
    count = math.ceil((until - begin) / _CHUNK)
    elapsed = 0.0
    with progress(console, what, until) as report:
        for i in range(1, count + 1):
            goal = min(begin + i * _CHUNK, until)
            started = time.perf_counter()
            simulator.AdvanceTo(goal)
            elapsed += time.perf_counter() - started
            report(simulator.get_context().get_time())
            if simulator.get_context().get_time() < goal:
                break  # a monitor has ended it
    return elapsed


@contextmanager
def in_real_time(simulator: Simulator) -> Iterator[None]:
    """Keeps a simulation from being faster than real time."""
    simulator.set_target_realtime_rate(1.0)
    simulator.ResetStatistics()
    try:
        yield
    finally:
        simulator.set_target_realtime_rate(0.0)
        simulator.ResetStatistics()


def make_viewer(camera: Sequence[float], target: Sequence[float]) -> Meshcat:
    """A plain scene for one machine, served on a free port.

    Args:
        camera: where the camera is at first (3) [m].
        target: what it looks at (3) [m].
    """
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # A recording needs no visitor, and a visitor is told by us.
    try:
        meshcat = Meshcat(MeshcatParams(show_stats_plot=False))
    finally:
        log.setLevel(level)
    for path in ("/Axes", "/Grid"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.80, 0.87, 0.94])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.97, 0.98, 0.99])
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 0.9)
    # A longer lens than Meshcat's own 75 deg, which distorts what is near.
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=36.0, near=0.1, far=100.0))
    meshcat.SetCameraPose(np.asarray(camera, dtype=float), np.asarray(target, dtype=float))
    return meshcat


@contextmanager
def recording(meshcat: Meshcat, path: Path) -> Iterator[None]:
    """Records what is drawn meanwhile into one HTML file that plays without a network.

    Raises:
        OutputError: the file cannot be written.
    """
    meshcat.StartRecording(_FRAMES_PER_SECOND)
    try:
        yield
        meshcat.StopRecording()
        meshcat.PublishRecording()
        with atomic_output(path) as temporary:
            temporary.write_text(meshcat.StaticHtml(), encoding="utf-8")
    finally:
        meshcat.StopRecording()
        meshcat.DeleteRecording()
        # An open page would go on playing what was published; nothing to play stops it.
        meshcat.SetAnimation(MeshcatAnimation(_FRAMES_PER_SECOND))


def write_graphviz(path: Path, diagram: Diagram) -> None:
    """Writes a diagram as Graphviz text (.dot, .gv) or as a picture (.svg, .png, .pdf).

    Raises:
        OutputError: the file cannot be written, its suffix says no format, or a picture is asked
            for where Graphviz is missing.
    """
    suffix = path.suffix.lower()
    text = diagram.GetGraphvizString()
    if suffix in _AS_TEXT:
        with atomic_output(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return
    if suffix not in _RENDERED:
        known = ", ".join((*_AS_TEXT, *_RENDERED))
        raise OutputError(
            f"cannot write {quoted_path(path)}: a diagram's suffix must be one of {known}", path
        )
    dot = shutil.which("dot")
    if dot is None:
        raise OutputError(
            f"cannot write {quoted_path(path)}: pictures need the program 'dot' of Graphviz; "
            "without it write a .dot file",
            path,
        )
    with atomic_output(path) as temporary:
        command = [dot, f"-T{suffix[1:]}", "-o", str(temporary)]
        done = subprocess.run(command, input=text, text=True, capture_output=True, check=False)
        if done.returncode != 0:
            reason = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
            raise OutputError(f"cannot write {quoted_path(path)}: dot: {reason}", path)
