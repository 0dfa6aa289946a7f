"""Runner of diagrams: simulates with progress, watches, records and draws them."""

import gc
import logging
import math
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatAnimation, MeshcatParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus, System
from rich.console import Console

from parapod.diagrams.block_diagram import BlockDiagram
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.wiring import inputs_of, outputs_of
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.run import Monitor, ReadOut, Run
from parapod.sims.lab.stage import Stage
from parapod.sims.lab.strip_chart import StripChart
from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import progress
from parapod.sims.output.scene_page import write_page
from parapod.sims.output.together import Wish
from parapod.systems.core.controls import shown
from parapod.systems.core.errors import MissingExtra, OutputError, ParapodError, WiringError
from parapod.systems.core.ports import value_of
from parapod.systems.core.quoting import quoted_path

# Simulated time between two reports of progress, and between two chances for Ctrl-C [s].
_CHUNK = 0.25
_FRAMES_PER_SECOND = 30.0
# Simulated time between two looks at a page, and between two changes of what it shows [s].
LOOK_PERIOD = 0.1
# Address at which scenes are served; all of this computer's would show them to its network.
served_at: ContextVar[str] = ContextVar("served_at", default="localhost")
_RENDERED = (".svg", ".png", ".pdf")
_AS_TEXT = (".dot", ".gv")


def simulate(simulator: Simulator, until: float, console: Console, what: str) -> float:
    """Advances a simulation and shows how far it is.

    Args:
        simulator: initialized; may have a target rate.
        until: simulated time at the end, unless a monitor ends it before [s].
        console: console for progress.
        what: name of the work, in a word or two.

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
        camera: first place of the camera (3) [m].
        target: point at which it looks (3) [m].
    """
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # Drake's "listening at ..."; we print our own.
    try:
        meshcat = Stage(MeshcatParams(host=served_at.get(), show_stats_plot=False))
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
def recording(
    meshcat: Meshcat, path: Path, title: str, facts: Sequence[str] = ()
) -> Iterator[None]:
    """Records what is drawn meanwhile into one HTML file that plays without a network.

    Args:
        meshcat: the scene.
        path: the file.
        title: title of the page.
        facts: origin of the recording, in a few words each.

    Raises:
        OutputError: the file cannot be written.
    """
    meshcat.StartRecording(_FRAMES_PER_SECOND)
    try:
        yield
        meshcat.StopRecording()
        meshcat.PublishRecording()
        write_page(path, meshcat.StaticHtml(), title, facts)
    finally:
        meshcat.StopRecording()
        meshcat.DeleteRecording()
        # An open page would go on playing what was published; nothing to play stops it.
        meshcat.SetAnimation(MeshcatAnimation(_FRAMES_PER_SECOND))


def write_graphviz(path: Path, drawing: BlockDiagram) -> None:
    """Writes a drawing of a diagram as Graphviz text (.dot, .gv) or picture (.svg, .png, .pdf).

    Args:
        path: the file.
        drawing: the drawing.

    Raises:
        OutputError: the file cannot be written, its suffix says no format, or a picture is asked
            for where Graphviz is missing.
    """
    suffix = path.suffix.lower()
    if suffix not in (*_AS_TEXT, *_RENDERED):
        suffixes = ", ".join((*_AS_TEXT, *_RENDERED))
        raise OutputError(
            f"cannot write {quoted_path(path)}: a diagram's suffix must be one of {suffixes}", path
        )
    try:
        content = drawing.text.encode() if suffix in _AS_TEXT else drawing.render(suffix[1:])
    except ParapodError as error:
        why = f"{error}; a .dot file needs nothing"
        raise OutputError(f"cannot write {quoted_path(path)}: {why}", path) from None
    with atomic_output(path) as temporary:
        temporary.write_bytes(content)


class Runner:
    """Runs what an experiment needs, as the options ask.

    Attributes:
        name: name of the experiment.
        options: ways to watch and record.
        console: console for progress.
    """

    def __init__(self, name: str, options: RunOptions):
        """Prepares the runner for one run of an experiment."""
        self.name, self.options, self.console = name, options, options.console

    def run(
        self,
        loop: Callable[..., ClosedLoop[Any]],
        duration: float,
        read_out: ReadOut,
        *,
        title: str,
        backend: str,
        seed: int,
        is_simulated: bool,
        scene: Callable[[], Meshcat],
        signals_needed: Sequence[str],
        structure: Hashable | None = None,
        begin: Any = None,
        watched: bool = True,
        monitor: Callable[[ClosedLoop[Any], Meshcat | None], Monitor] | None = None,
    ) -> Run:
        """Runs a closed loop, simulated or real.

        Args:
            loop: builds it, with `meshcat` and `log` as `ClosedLoop` has them.
            duration: end of the run [s].
            read_out: says what the page shows.
            title: the machine's.
            backend: backend behind the machine's ports.
            seed: seed of everything random.
            is_simulated: true if the machine is simulated.
            scene: makes the scene around the machine.
            signals_needed: ports whose signals are recorded where no log is written.
            structure: all that the loop is built from; None: it serves no other scenario.
            begin: machine's scenario that a loop of this structure is reset to.
            watched: true for the run that the options show and write.
            monitor: makes the simulator's monitor, which may end the run.

        Raises:
            ScenarioError: a scenario whose parts do not fit together.
            OutputError: a file cannot be written.
        """
        options = self.options if watched else RunOptions(console=self.console)
        for name in ("meshcat", "html"):
            if getattr(options, name) and not is_simulated:
                raise OutputError(f"--{name} shows a simulated machine; the backend is {backend}")
        meshcat = scene() if options.meshcat or options.html else None
        log = tuple(signals_needed) if options.log is None else None
        reset_to = None
        if meshcat or self.options.loops is None or structure is None:
            closed_loop = loop(meshcat=meshcat, log=log)
        else:
            closed_loop = self.options.loops.loop((structure, log), partial(loop, log=log))
            reset_to = begin
        closed_loop.require(signals_needed)
        if options.graphviz is not None:
            write_graphviz(options.graphviz, BlockDiagram(closed_loop))
        if reset_to is not None and options.together is not None:
            look = monitor(closed_loop, None) if monitor is not None else None
            wish = Wish(closed_loop, reset_to, duration, look)
            if (granted := options.together.simulate(wish)) is not None:
                return Run(
                    granted.recording.time,
                    granted.recording.signals,
                    granted.recording.units,
                    closed_loop,
                    granted.context,
                    granted.elapsed,
                    None,
                    lambda: granted.elapsed,
                )
        simulator = closed_loop.simulator()

        def again() -> float:
            if backend == "hardware":
                from parapod.sims.real_machine.job import run_on_hardware, show_timing

                look = monitor(closed_loop, None) if monitor is not None else None
                start = time.perf_counter()
                timing = run_on_hardware(
                    closed_loop, simulator, duration, options, self.name, partial(_is_ended, look)
                )
                show_timing(timing, closed_loop.station, self.console)
                return time.perf_counter() - start
            closed_loop.reset(simulator.get_mutable_context(), reset_to)
            monitors = [] if closed_loop.monitor is None else [closed_loop.monitor]
            if monitor is not None:
                monitors.append(monitor(closed_loop, meshcat))
            if panel is not None:
                root, remark = simulator.get_context(), partial(_say, self.console)
                monitors.append(shown_on(panel, read_out, closed_loop, root, remark))
            if monitors:
                simulator.set_monitor(_all_of(monitors))
            simulator.Initialize()
            with in_real_time(simulator) if options.meshcat else nullcontext():
                return simulate(simulator, duration, self.console, self.name)

        panel = None
        if meshcat is not None and options.meshcat:
            panel = Panel(meshcat, f"{self.name}: {title}")
            say_where(panel, title, self.console)
        page = options.html if meshcat is not None else None
        facts = [f"backend {backend}", f"seed {seed}"]
        with (
            recording(meshcat, page, f"{self.name}: {title}", facts)
            if meshcat and page
            else nullcontext()
        ):
            elapsed = again()
        recorded = closed_loop.recording(simulator.get_context())
        return Run(
            recorded.time,
            recorded.signals,
            recorded.units,
            closed_loop,
            simulator.get_context,
            elapsed,
            panel,
            again,
        )

    def simulate(self, simulator: Simulator, until: float, what: str = "") -> float:
        """Advances a simulation with progress; returns the wall-clock time that it took [s]."""
        return simulate(simulator, until, self.console, what or self.name)


def say_where(page: Panel, what: str, console: Console) -> None:
    """Prints the address at which something is shown."""
    _say(console, f"{what[:1].upper()}{what[1:]} is shown at {page.web_url()}")


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def shown_on(
    panel: Panel,
    read_out: ReadOut,
    loop: ClosedLoop[Any],
    simulated: Context,
    remark: Callable[[str], None] = lambda text: None,
) -> Monitor:
    """A monitor that shows on a page what a loop does.

    Args:
        panel: the page.
        read_out: says what the page shows.
        loop: the loop.
        simulated: the root context that its simulator advances.
        remark: called with the reason why nothing is plotted.
    """
    shown_at, chart = -math.inf, None
    try:
        sizes = {name: port.size() for name, port in loop.ports.items()}
        chart = StripChart(loop.machine, sizes, loop.machine.all_limits(loop.scenario))
    except MissingExtra as error:
        remark(f"no plots beside the scene: {error}")
    panel.plot(chart)
    readings = loop.readings(simulated, chart.signals) if chart is not None else {}

    def look(root_context: Context) -> EventStatus:
        nonlocal shown_at
        now = root_context.get_time()
        if chart is not None and chart.wants(now):
            chart.add(now, {name: read() for name, read in readings.items()})
        if not shown_at <= now < shown_at + LOOK_PERIOD:
            shown_at = now
            panel.show(read_what_there_is(read_out, loop, root_context))
        return EventStatus.DidNothing()

    return look


def read_what_there_is(read_out: ReadOut, loop: ClosedLoop[Any], root_context: Context) -> Readout:
    """A loop's numbers; the time alone where a controller of one's own lacks their ports."""
    try:
        return read_out(loop, root_context)
    except WiringError as error:
        time = Row("time", measured=root_context.get_time(), unit="s")
        return Readout(rows=(time,), remarks=(f"no more numbers: {error}",))


def refuse_deaf(loop: ClosedLoop[Any]) -> None:
    """Refuses a loop in which nothing takes a command of the person's.

    Raises:
        WiringError: names the commands.
    """
    systems = (loop.station, loop.controller, *loop.sources)
    inputs = {name for system in systems for name in inputs_of(system)}
    persons = (source for source in loop.sources if hasattr(source, "shown"))
    if deaf := [name for one in persons for name in outputs_of(one) if name not in inputs]:
        raise WiringError(
            f"a person operates the machine by the controller's input {', '.join(deaf)}, "
            f"which is missing; it has: {', '.join(inputs_of(loop.controller))}"
        )


@contextmanager
def controls_shown(loop: ClosedLoop[Any]) -> Iterator[None]:
    """Shows sliders and buttons of a loop's sources, and takes them away at the end."""
    with ExitStack() as stack:
        for source in loop.sources:
            if hasattr(source, "shown"):
                stack.enter_context(source.shown())
        yield


def _is_ended(look: Monitor | None, root_context: Context) -> bool:
    """Whether a monitor would end a run."""
    going_on = (EventStatus.Severity.kDidNothing, EventStatus.Severity.kSucceeded)
    return look is not None and look(root_context).severity() not in going_on


def _all_of(monitors: Sequence[Monitor]) -> Monitor:
    """A monitor that ends a run as soon as one of several would."""

    def look(root_context: Context) -> EventStatus:
        ended = EventStatus.DidNothing()
        for monitor in monitors:
            status = monitor(root_context)
            if status.severity() != EventStatus.Severity.kDidNothing:
                ended = status
        return ended

    return look


RESTART, END = "Restart", "End"


class Live:
    """A closed loop that goes on in real time and obeys what a person does on a page.

    Attributes:
        panel: the page.
        loop: the loop.
        simulator: its simulator; `begin` initializes it.
    """

    def __init__(self, panel: Panel, loop: ClosedLoop[Any], read_out: ReadOut):
        """Prepares the loop.

        Args:
            panel: the page.
            loop: the loop, drawn in the page's scene.
            read_out: says what the page shows.

        Raises:
            WiringError: see `refuse_deaf`.
        """
        refuse_deaf(loop)
        self.panel, self.loop = panel, loop
        self.simulator = loop.simulator()
        monitors = [] if loop.monitor is None else [loop.monitor]
        visible = shown_on(panel, read_out, loop, self.simulator.get_context())
        self.simulator.set_monitor(_all_of([*monitors, visible]))

    def begin(self) -> None:
        """Puts the loop where its scenario begins."""
        self.loop.reset(self.simulator.get_mutable_context())
        self.simulator.Initialize()

    def advance(self, duration: float = LOOK_PERIOD) -> None:
        """Simulates for a duration [s]."""
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + duration)

    def signal(self, system: System, port: str) -> NDArray[np.float64]:
        """Present value of a port of one of the loop's systems."""
        return value_of(system, port, self.simulator.get_context())

    def shown(self) -> AbstractContextManager[None]:
        """Shows what a person operates it by, and takes it away at the end."""
        return controls_shown(self.loop)

    def obey(self) -> str:
        """Begins, and obeys a person in real time until a button is clicked; returns which."""
        self.begin()
        with self.shown():
            return self.go_on()

    def go_on(self) -> str:
        """Goes on in real time until a person clicks "Restart" or "End"; returns which."""
        with shown(self.panel, buttons=(RESTART, END)), in_real_time(self.simulator):
            while True:
                self.advance()
                for name in (END, RESTART):
                    if self.panel.GetButtonClicks(name):
                        return name


def stay_live(panel: Panel, live: Callable[[], str], console: Console, advice: str) -> None:
    """Repeats the live phase until "End" or Ctrl-C, and closes the page.

    Args:
        panel: the page.
        live: goes on until a person clicks a button, and returns which.
        console: console for the advice.
        advice: purpose of the controls.
    """
    _say(console, f"{advice} '{RESTART}' begins anew; '{END}' or Ctrl-C ends.")
    try:
        while live() != END:
            pass
    except KeyboardInterrupt:
        return
    finally:
        panel.close()
