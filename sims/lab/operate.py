"""A person operates a machine, simulated or real, on a page that another process serves."""

import socket
import time
from collections.abc import Callable
from typing import Any

from pydrake.systems.framework import Context

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.sims.lab.desk import Desk
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Readout
from parapod.sims.lab.runner import (
    LOOK_PERIOD,
    controls_shown,
    in_real_time,
    read_what_there_is,
    refuse_deaf,
)
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import waiting
from parapod.systems.core.errors import OutputError, ParapodError
from parapod.systems.core.quoting import quoted

END = "End"
# A page that has been opened for a while speaks more often than that [s].
_OPENED, _SILENCE, _LOOK = 1.0, 0.3, 0.05
# A machine without a page has come to stand after that [s].
_ABANDONED = 2.0
# Time in which an open page shows why the machine does not move any more [s].
_LAST_WORDS = 0.4


def operate(
    experiment: LoopExperiment[Any, Any],
    scenario: Any,
    options: RunOptions,
    host: str = "localhost",
) -> None:
    """Lets a person operate the machine until "End" is clicked.

    The machine begins when the page is opened. It holds when the page is closed or its process
    ends, and is neutral when this returns, however it ends.

    Args:
        experiment: its hooks give the loop that is operated, and what the page shows.
        scenario: its scenario; any backend.
        options: console, and for the backend "hardware" the file of a log.
        host: address at which the page is served; see `Panel`.

    Raises:
        OutputError: this experiment cannot be operated, or the page or the log cannot begin.
        ParapodError: whatever ends a job on the real machine.
    """
    if type(experiment).operated is LoopExperiment.operated:
        raise OutputError(f"'{experiment.name}' has nothing that a person operates", None)
    _check_host(host)
    with waiting(options.console, f"{experiment.name}: planning"):
        experiment.check(scenario)
    if scenario.backend == "hardware":
        from parapod.diagrams.drivers.driver import refuse_without_emulator

        drivers = experiment.machine.drivers(experiment.machine_scenario(scenario))
        refuse_without_emulator(drivers, experiment.name)
    title = f"{experiment.name}: {experiment.machine.title}"
    with Desk(experiment.name, scenario, title, host) as desk:
        loop = experiment.operated(scenario, desk)
        assert loop is not None
        refuse_deaf(loop)
        with controls_shown(loop):
            desk.AddButton(END)
            _wait_for_page(desk, options)
            try:
                _run(experiment, scenario, loop, desk, options)
            except ParapodError as error:
                messages = (str(error),)
                desk.show(Readout("ended", remarks=messages, is_alarming=True, idle=desk.controls))
                time.sleep(_LAST_WORDS)
                raise


def _check_host(host: str) -> None:
    """Refuses an address that this computer does not have."""
    try:
        socket.create_server((host, 0)).close()
    except OSError as error:
        why = f"no page can be served at {quoted(host)}: {error.strerror or error}"
        raise OutputError(why, None) from None


def _wait_for_page(desk: Desk, options: RunOptions) -> None:
    text = f"open {desk.web_url()} to begin"
    options.console.print(text, markup=False, highlight=False, soft_wrap=True)
    desk.show(Readout("the machine begins", idle=[n for n in desk.controls if n != END]))
    opened = time.monotonic()
    while time.monotonic() < opened + _OPENED:
        if desk.silence() > _SILENCE:
            opened = time.monotonic()
        time.sleep(_LOOK)


def _run(
    experiment: LoopExperiment[Any, Any],
    scenario: Any,
    loop: ClosedLoop[Any],
    desk: Desk,
    options: RunOptions,
) -> None:
    simulator = loop.simulator()
    visible = _shown_on(desk, experiment, loop, simulator.get_context())

    def is_over(root: Context) -> bool:
        visible(root)
        if desk.wrong and desk.silence() > _ABANDONED:
            raise OutputError(f"the operator's page is gone: {desk.wrong}", None)
        return desk.GetButtonClicks(END) > 0

    if scenario.backend == "hardware":
        from parapod.sims.real_machine.job import run_on_hardware, show_timing

        timing = run_on_hardware(loop, simulator, float("inf"), options, experiment.name, is_over)
        show_timing(timing, loop.station, options.console)
        return

    loop.reset(simulator.get_mutable_context())
    simulator.Initialize()
    with in_real_time(simulator):
        while not is_over(simulator.get_context()):
            simulator.AdvanceTo(simulator.get_context().get_time() + LOOK_PERIOD)


def _shown_on(
    desk: Desk, experiment: LoopExperiment[Any, Any], loop: ClosedLoop[Any], root: Context
) -> Callable[[Context], None]:
    """Shows numbers and drawing ten times a second, at ticks of their own."""
    readings = loop.readings(root, getattr(loop.machine.view.twin, "signals", ()))
    last = -LOOK_PERIOD

    def show(context: Context) -> None:
        nonlocal last
        now = context.get_time()
        if now < last + LOOK_PERIOD - 1e-9 and now >= last:
            return
        last = now
        signals = {name: read() for name, read in readings.items()}
        desk.show(read_what_there_is(experiment.read_out, loop, context), signals)

    return show
