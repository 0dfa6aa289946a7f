"""A machine on a bus: its station, simulated or real, for a controller in another program."""

import math
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from pydrake.systems.framework import Context

from parapod.diagrams.bus_controller import bus_controller
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import Machine
from parapod.sims.output.options import RunOptions
from parapod.sims.real_machine.job import logged, punctuality_of, run_on_hardware
from parapod.sims.real_machine.real_time import RealTimeLoop, Timing, rehearse, undisturbed
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.buses.controller import BusController, Sizes
from parapod.systems.hardware.signals import ended_by_signals

# Longer than anybody serves a machine [s].
_FOREVER = 1e6
# Delay up to which instants are made up for [s].
_PATIENCE = 0.05


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
        address: address of the bus, see `address_of`.
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
    controller = bus_controller(one, period, address, "the bus", patience=0.0)
    loop = ClosedLoop(machine, scenario, controller=controller, sources=())
    until, what = min(duration, _FOREVER), f"{machine.experiment} on {controller.station.bus.name}"

    def say(text: str) -> None:
        options.console.print(text, markup=False, highlight=False, soft_wrap=True)

    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        stack.callback(controller.close)
        introduce(controller, f"{machine.title}, {scenario.backend}", period, say)
        news = _News(controller, say)
        if scenario.backend == "hardware":

            def look(root: Context) -> bool:
                news.tell(root)
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
    for channel, sizes in station.published.items():
        if not sizes:
            continue
        say(f"  publishes {channel}: {_listed(sizes)}")
    for channel, sizes in station.taken.items():
        say(f"  takes {channel}: {_listed(sizes)}, active")


def _listed(sizes: Sizes) -> str:
    return ", ".join(f"{name}[{size}]" if size > 1 else name for name, size in sizes.items())


class _News:
    """Tells what happens to the parts of a machine on a bus."""

    def __init__(self, controller: BusController, say: Callable[[str], None]):
        self._controller, self._say = controller, say
        self._states: dict[str, str] = {}

    def tell(self, root: Context) -> None:
        """Tells what has changed since the last call."""
        for part in self._controller.station.parts:
            if not part.inbox.layout.sizes:
                continue
            state = "is neutral"
            if part.latched is not None:
                state = f"is neutral until its controller gives it up: {part.latched.words}"
            elif not part.is_neutral:
                state = "is controlled"
            if state != self._states.get(part.part, "is neutral"):
                self._say(f"{root.get_time():.2f} s: {part.part} {state}")
            self._states[part.part] = state
