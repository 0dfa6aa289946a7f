"""A machine on a bus: its station, simulated or real, for a controller in another program."""

import logging
import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from parapod.diagrams.bus_controller import bus_controller
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import Machine
from parapod.diagrams.wiring import inputs_of, outputs_of
from parapod.sims.output.drawn_bodies import DrawnBodies
from parapod.sims.output.options import RunOptions
from parapod.sims.real_machine.job import logged, punctuality_of, run_on_hardware
from parapod.sims.real_machine.privileges import FIFO, privileges
from parapod.sims.real_machine.real_time import RealTimeLoop, Timing, rehearse, undisturbed
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.ports import read
from parapod.systems.hardware.buses.bus import Bus
from parapod.systems.hardware.buses.controller import CONTROLLER, BusController
from parapod.systems.hardware.buses.message import Table
from parapod.systems.hardware.signals import ended_by_signals

_LOG = logging.getLogger(__name__)

# Longer than anybody serves a machine [s].
_FOREVER = 1e6
# Delay up to which instants are made up for [s].
_PATIENCE = 0.05
# Period of pictures [s].
_PICTURE = 0.05
# Difference between sums of periods that are the same [s].
_ROUNDING = 1e-6


def serve(
    machine: Machine[Any],
    scenario: Any,
    address: str,
    options: RunOptions,
    duration: float = math.inf,
) -> Timing:
    """Serves a machine on a bus, in real time, until Ctrl-C or for a time.

    Args:
        machine: the machine.
        scenario: one of its scenarios; its job and its controller are left out.
        address: address of the bus, see `HardwareScenario.address`.
        options: console for remarks, and file of the log.
        duration: duration [s].

    Raises:
        ScenarioError: another kind of bus, or a controller that the scenario names.
        DeviceError: the bus cannot be opened, or a device has failed.
    """
    if scenario.control.controller:
        key = "control.controller"
        raise ScenarioError(f"{key} must be empty: the controller is on the bus", key)
    period = scenario.control.period
    one = machine.for_scenario(scenario)
    # Its signals, such as estimates, may come from the controller on the bus, and be logged.
    usual = one.controller(one.scenario())
    bus = scenario.hardware.address(address, f"--{address.partition(':')[0]}")
    controller = bus_controller(one, period, bus, usual, patience=0.0)
    loop = ClosedLoop(machine, scenario, controller=controller, sources=(), log=())
    is_real = scenario.backend == "hardware"

    def say(text: str) -> None:
        options.console.print(text, markup=False, highlight=False, soft_wrap=True)

    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        # The bus's threads have the loop's priority, or they would wait for it.
        stack.enter_context(privileges((FIFO,) if is_real else ()))
        stack.callback(controller.close)
        until = min(duration, _FOREVER)
        what = machine.experiment  # by which a replay finds the machine
        introduce(controller, f"{machine.title}, {scenario.backend}", period, say)
        news, scene = _News(controller, say), _Scene(one, scenario, controller, say)
        stack.callback(scene.close)
        if is_real:

            def look(root: Context) -> bool:
                news.tell(root)
                scene.show(root)
                return root.get_time() >= until

            return run_on_hardware(loop, loop.simulator(), math.inf, options, what, look)
        write = stack.enter_context(
            logged(options, loop, root := loop.CreateDefaultContext(), what)
        )
        simulator = loop.simulator(root)
        simulator.Initialize()
        rehearse(loop, simulator.get_context())

        def on_tick(root: Context) -> None:
            write(root.get_time())
            news.tell(root)
            scene.show(root)

        with undisturbed(()):
            running = RealTimeLoop(simulator, period, on_tick, is_strict=False, patience=_PATIENCE)
            try:
                running.run(until)
            finally:
                if running.timing.ticks:
                    say(punctuality_of(running.timing))
        return running.timing


def introduce(
    controller: BusController, title: str, period: float, say: Callable[[str], None]
) -> None:
    """Says what is on the bus.

    Args:
        controller: system in the controller's place.
        title: the machine.
        period: period of its messages [s].
        say: takes a line.
    """
    station, rate = controller.station, 1.0 / period
    say(f"{title}, on {station.bus.name}, {rate:g} messages a second on a channel")
    for channel, signals in station.published.items():
        say(f"  publishes {channel}: {_listed(signals)}")
    for channel, layout in station.taken.items():
        others = "".join(f", or {kind}" for kind in station.bus.also(layout))
        say(f"  takes {channel}: {_listed(layout.signals)}, active{others}")


def _listed(signals: Table) -> str:
    return ", ".join(f"{n}[{each.size}]" if each.size > 1 else n for n, each in signals.items())


class _Scene:
    """Shows the machine to the tools of its bus, where that has some: poses of its links.

    A thread of its own calculates them: no tick waits for a picture.
    """

    def __init__(
        self,
        machine: Machine[Any],
        scenario: Any,
        controller: BusController,
        say: Callable[[str], None],
    ):
        self._controller, self._next, self._say = controller, 0.0, say
        self._artist = ThreadPoolExecutor(1, "scene")
        self._picture: Future[None] | None = None
        self._twin: Any = None
        bus, kind = controller.station.bus, machine.view.twin
        if not bus.draws or kind is None:
            return
        inputs, outputs = inputs_of(controller), outputs_of(controller)
        self._ports: dict[str, Any] = {
            n: p for n, p in {**inputs, **outputs}.items() if n in kind.signals
        }
        self._needed = sorted(kind.needed)
        if missing := kind.needed - self._ports.keys():
            say(f"  is not drawn: nothing on the bus tells {', '.join(sorted(missing))}")
            return
        if estimates := kind.needed - inputs.keys():
            channel = bus.address.channels_of(CONTROLLER).status
            say(f"  is drawn once {channel} has {', '.join(sorted(estimates))}")
        self._twin = kind(None, scenario)
        # What Drake makes at the first picture is made now, and not within an instant.
        simulated = replace(scenario, backend=machine.scenario().backend)
        usual = ClosedLoop(machine, simulated)
        context = usual.CreateDefaultContext()
        first = {name: np.array(take()) for name, take in usual.readings(context).items()}
        self._twin.show({name: first[name] for name in self._ports if name in first}, 0.0)
        self._bodies = DrawnBodies(self._twin)
        self._bodies.poses()
        try:
            bus.describe(self._bodies.description(machine.name), self._bodies.visuals())
        except ParapodError as error:  # a machine that cannot be drawn is served all the same
            self._twin = None
            say(f"  is not drawn: {error}")

    def show(self, root: Context) -> None:
        """Shows the machine as its signals are, some times a second, while somebody looks."""
        time, bus = root.get_time(), self._controller.station.bus
        if self._twin is None or time < self._next - _ROUNDING:
            return
        self._next = time + _PICTURE
        if self._picture is not None and not self._picture.done():
            return
        self._finish()
        if self._twin is None or not bus.is_watched:
            return
        context = self._controller.GetMyContextFromRoot(root)
        values = {n: np.array(read(p, context)) for n, p in self._ports.items()}
        if all(np.isfinite(values[name]).all() for name in self._needed):
            signals = {n: v for n, v in values.items() if np.isfinite(v).all()}
            self._picture = self._artist.submit(self._draw, bus, signals, time)

    def _draw(self, bus: Bus, values: dict[str, NDArray[np.float64]], time: float) -> None:
        self._twin.show(values, time)
        bus.place(self._bodies.poses(), time)

    def _finish(self) -> None:
        """Draws nothing any more if the last picture could not be drawn, and says why."""
        picture, self._picture = self._picture, None
        error = picture.exception() if picture is not None else None
        if error is None:
            return
        self._twin = None
        self._say(f"is not drawn any more: {error}")
        if not isinstance(error, ParapodError):
            _LOG.error("scene", exc_info=error)

    def close(self) -> None:
        """Ends the thread, after the picture that it draws."""
        self._artist.shutdown()
        self._finish()


class _News:
    """Tells what happens to the parts of a machine on a bus."""

    def __init__(self, controller: BusController, say: Callable[[str], None]):
        self._controller, self._say = controller, say
        self._states: dict[str, str] = {}

    def tell(self, root: Context) -> None:
        """Tells what has changed since the last call."""
        for part in self._controller.station.parts:
            if not part.inbox.layout.signals:
                continue
            state = "is neutral"
            if part.latched is not None:
                state = f"is neutral until its controller gives it up: {part.latched.words}"
            elif not part.is_neutral:
                state = "is controlled"
            if state != self._states.get(part.part, "is neutral"):
                self._say(f"{root.get_time():.2f} s: {part.part} {state}")
            self._states[part.part] = state
