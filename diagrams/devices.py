"""Devices behind the ports of a station: checked against the machine's table, opened, wired."""

from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, Multiplexer

from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.diagrams.ports import Behind, Port
from parapod.diagrams.wiring import add, connect
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.io import DeviceThread, PartReader, PartWriter
from parapod.systems.hardware.signals import UninterruptedExit

# How long devices are asked to become neutral, and the pause in between [s].
_CONFIRMING, _PAUSE = 2.0, 0.05
# Pause between two looks for news of a device [s].
_NEWS_PAUSE = 1e-3


@dataclass
class Parts:
    """The devices of a machine, by part.

    Attributes:
        threads: threads of each part's devices.
        readers: readers by part.
        printed: remarks that `news` has given already.
    """

    threads: dict[str, list[DeviceThread]]
    readers: dict[str, PartReader] = field(default_factory=dict)
    printed: set[str] = field(default_factory=set)

    def behind(self, part: str) -> str:
        """Part whose devices stand behind a part's signals: itself, if it has any.

        Raises:
            KeyError: no device does.
        """
        if part in self.threads:
            return part
        for other, threads in self.threads.items():
            for thread in threads:
                signals = (*thread.device.measures, *thread.device.commands)
                if any(signal.startswith(f"{part}.") for signal in signals):
                    return other
        raise KeyError(part)

    @property
    def all_threads(self) -> list[DeviceThread]:
        """Threads of all parts."""
        return [thread for threads in self.threads.values() for thread in threads]

    def news(self) -> list[str]:
        """Remarks of the devices that have not been given before, with the devices' names."""
        messages = [
            f"{t.device.name}: {text}" for t in self.all_threads for text in t.device.remarks
        ]
        news = [text for text in messages if text not in self.printed]
        self.printed.update(news)
        return news

    def reset(self, root_context: Context, scenario: Any = None) -> None:
        """Begins with what the devices measure now; a scenario changes nothing about a machine.

        Raises:
            DeviceError: a device has a fault, or is not active yet.
        """
        for reader in self.readers.values():
            reader.reset(reader.GetMyMutableContextFromRoot(root_context))

    def await_measurements(self, patience: float) -> None:
        """Waits until every device has measured anew, or has a fault.

        Args:
            patience: longest wait [s]; what has not come by then is as old as its age says.
        """
        started = monotonic()
        for thread in self.all_threads:
            while thread.device.measures and not thread.error and thread.sample.stamp < started:
                if monotonic() > started + patience:
                    return
                sleep(_NEWS_PAUSE)

    @contextmanager
    def active(self) -> Iterator[None]:
        """Configures all devices, then activates them; neutral and closed at its end.

        No device is energised before every device has answered and been found to be the right
        one. Whatever ends it, every device is made neutral, in the reverse order; those that do
        not confirm it are asked again, for two seconds. No signal cuts this short.

        Raises:
            MissingExtra: a library is not installed.
            DeviceError: a device is not there, is another one, or refuses.
            NotNeutral: a device has not confirmed that its outputs are neutral.
        """
        unconfirmed: dict[DeviceThread, Exception] = {}

        def stop(thread: DeviceThread) -> None:
            if (error := thread.stop()) is not None and thread.device.commands:
                unconfirmed[thread] = error

        ended: BaseException | None = None
        try:
            with UninterruptedExit() as stack:
                for thread in self.all_threads:
                    stack.enter_context(thread.device)
                stack.callback(_ask_again, unconfirmed)
                for thread in self.all_threads:
                    stack.callback(stop, thread)
                    thread.start()
                yield
        except BaseException as error:
            ended = error
            raise
        finally:
            if unconfirmed:
                raise NotNeutral(ended, unconfirmed) from ended


class NotNeutral(ParapodError):
    """Devices that have not confirmed that they are neutral; says what stops them."""

    def __init__(self, ended: BaseException | None, unconfirmed: Mapping[DeviceThread, Exception]):
        """Words the error.

        Args:
            ended: error that ended the work; None if it ended as planned.
            unconfirmed: errors of the devices that have not confirmed it.
        """
        messages = [] if ended is None else [_words(ended)]
        live = []
        for thread, error in unconfirmed.items():
            if str(error) not in messages:
                messages.append(str(error))
            if thread.device.watchdog:
                messages.append(thread.device.watchdog)
            else:
                live.append(thread.device.name)
        if live:
            outputs = f"OUTPUTS OF {' AND '.join(live)} MAY STILL BE LIVE"
            messages.append(f"{outputs}: press the emergency stop")
        super().__init__("; ".join(messages))


def _words(error: BaseException) -> str:
    """Text of what has ended the work."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return str(error) if isinstance(error, ParapodError) else f"{type(error).__name__}: {error}"


def _ask_again(unconfirmed: dict[DeviceThread, Exception]) -> None:
    """Asks devices to become neutral until all have confirmed it, or it has lasted too long."""
    deadline = monotonic() + _CONFIRMING
    while unconfirmed and monotonic() < deadline:
        for thread in list(unconfirmed):
            if (error := thread.stop()) is None:
                del unconfirmed[thread]
            else:
                unconfirmed[thread] = error
        sleep(_PAUSE)


def add_devices(
    builder: DiagramBuilder,
    drivers: Sequence[Driver],
    inputs: Sequence[Port],
    outputs: Sequence[Port],
    signals_used: Sequence[str],
    period: float,
) -> Behind:
    """Adds the devices of drivers; nothing is opened yet.

    Args:
        builder: builder of the station.
        drivers: drivers of the scenario.
        inputs: inputs of the station; each must be driven.
        outputs: outputs of the station but `status.*`; each that has no default must be measured,
            once.
        signals_used: parts of `status.age` and `status.fault`, in order.
        period: period of the loop [s].

    Raises:
        ScenarioError: drivers that do not make this machine.
    """
    parts = make_parts(drivers, inputs, outputs, period)
    driven, measured = _add_parts(builder, parts, {port.name for port in outputs}, period)
    for name in ("age", "fault"):
        each = add(builder, Multiplexer(len(signals_used)), f"status_{name}")
        for i, part in enumerate(signals_used):
            if any(port.part == part for port in (*inputs, *outputs)):
                port = parts.readers[parts.behind(part)].GetOutputPort(name)
            else:  # a part that this machine does not have never fails
                source = ConstantVectorSource(np.zeros(1))
                port = add(builder, source, f"{part}_{name}").get_output_port()
            connect(builder, port, each.get_input_port(i))
        measured[f"status.{name}"] = each.get_output_port(0)
    return Behind(driven, measured, parts.reset, parts.active, handle=parts)


def make_parts(
    drivers: Sequence[Driver],
    inputs: Sequence[Port],
    outputs: Sequence[Port],
    period: float,
) -> Parts:
    """Makes the devices of drivers and checks that they are the station's.

    Args:
        drivers: drivers of the scenario.
        inputs: inputs of the station; each must be driven.
        outputs: outputs of the station; each that has no default must be measured, once.
        period: period of the loop [s].

    Raises:
        ScenarioError: names the port or the driver that is wrong.
    """
    parts = {spec.name.partition(".")[0] for spec in (*inputs, *outputs)}
    devices: list[tuple[str, Device]] = []
    for i, driver in enumerate(drivers):
        if driver.part not in parts:
            key = f"hardware.drivers.{i}.part"
            raise ScenarioError(
                f"{key} = {quoted(driver.part)} is not one of {', '.join(sorted(parts))}", key
            )
        switches = [spec for spec in inputs if spec.is_switch]
        ports = PartPorts(
            _signals(outputs, driver.part),
            _signals(inputs, driver.part),
            frozenset(_signals(switches, driver.part)),
            {spec.name.removeprefix(f"{driver.part}."): spec.unit for spec in (*inputs, *outputs)},
        )
        device = driver.make(ports)
        for name in _ports(driver.part, device.commands):
            if name not in {spec.name for spec in inputs}:
                text = f"{device.name} takes {name}, which is not a port"
                raise ScenarioError(f"hardware.drivers: {text}", "hardware.drivers")
        devices.append((driver.part, device))
    for specs, what in ((outputs, "measures"), (inputs, "commands")):
        for spec in specs:
            _check(spec, devices, what)
    threads: dict[str, list[DeviceThread]] = {}
    for part, device in devices:
        threads.setdefault(part, []).append(DeviceThread(device, period))
    return Parts(threads)


def _ports(part: str, signals: Mapping[str, int]) -> dict[str, int]:
    """Sizes of a device's signals by the names of their ports.

    Those of other parts than its own it calls by these names itself.
    """
    return {name if "." in name else f"{part}.{name}": size for name, size in signals.items()}


def _signals(specs: Sequence[Port], part: str) -> dict[str, int]:
    """Names, within their part, and sizes of the ports of one part."""
    names = ((spec.name.partition("."), spec.size) for spec in specs)
    return {signal: size for (owner, _, signal), size in names if owner == part}


def _check(spec: Port, devices: Sequence[tuple[str, Device]], what: str) -> None:
    """Refuses a port that no device, or more than one, stands behind."""
    owner = spec.name.partition(".")[0]
    sizes = [(part, device, _ports(part, getattr(device, what))) for part, device in devices]
    missing = [
        (part, device, ports[spec.name]) for part, device, ports in sizes if spec.name in ports
    ]
    key = "hardware.drivers"
    verb = "measured" if what == "measures" else "driven"
    if not missing and (what == "commands" or spec.default is None):
        among = ", ".join(device.name for part, device in devices if part == owner) or "none"
        raise ScenarioError(
            f"{key}: {spec.name} is {verb} by no driver (those with part: {owner}: {among})", key
        )
    # Commands are handed to the devices of one part at a time.
    if len({part for part, _, _ in missing} if what == "commands" else missing) > 1:
        names = " and ".join(device.name for _, device, _ in missing)
        one = "one" if what == "measures" else "of one part"
        raise ScenarioError(f"{key}: {spec.name} is {verb} by {names}; it must be {one}", key)
    for _, device, size in missing:
        if size != spec.size:
            raise ScenarioError(
                f"{key}: {device.name} has {size} elements of {spec.name}, the port {spec.size}",
                key,
            )


def _add_parts(
    builder: DiagramBuilder, parts: Parts, visible: Set[str], period: float
) -> tuple[dict[str, InputPort], dict[str, OutputPort]]:
    """Adds a reader, which shows these measurements, and for commands a writer, for each part."""
    inputs: dict[str, InputPort] = {}
    outputs: dict[str, OutputPort] = {}
    for part, threads in parts.threads.items():
        reader = add(builder, PartReader(part, threads, period))
        parts.readers[part] = reader
        for signal, name in _named(part, threads, "measures"):
            if name in visible:
                outputs[name] = reader.GetOutputPort(signal)
        if commanded := _named(part, threads, "commands"):
            writer = add(builder, PartWriter(part, threads, period))
            connect(builder, reader.GetOutputPort("stamp"), writer.GetInputPort("stamp"))
            for signal, name in commanded:
                inputs[name] = writer.GetInputPort(signal)
    return inputs, outputs


def _named(part: str, threads: Sequence[DeviceThread], what: str) -> list[tuple[str, str]]:
    """Signals of a part's devices, each with the name of its port."""
    signals = {s: size for thread in threads for s, size in getattr(thread.device, what).items()}
    return list(zip(signals, _ports(part, signals), strict=True))
