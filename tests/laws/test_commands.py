"""Devices are commanded what a simulated plant is commanded: by the same measurements, the same.

A loop is simulated and what its controllers see and say at each of their instants is noted. Then
devices show the same to the loop that commands devices, and note what is written to them.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams import devices
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machine import list_machines
from parapod.sims.lab.discovery import list_entries
from parapod.sims.lab.experiment import LoopExperiment
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.hardware.device import Device, DeviceFault
from parapod.systems.hardware.io import PartReader, Sample

_DURATION = 1.6  # [s]; every job has begun to move by then
# Settings with which it has.
SOON = {"job": {"estimate_at": 0.5}}
# A tenth as many instants are as good a proof.
SELDOM = {"control": {"period": 0.01}}
SETTINGS = {
    **dict.fromkeys(("levelling_platform", "level", "track-posture", "inspect"), SOON),
    **dict.fromkeys(("terrain_simulator", "bench-walk"), SELDOM),
}


def _loops():
    """By a name, what makes a loop of a backend with drivers."""
    for machine in list_machines():
        yield machine.name, partial(_of_machine, machine)
    for entry in list_entries():
        experiment = entry.load()
        if isinstance(experiment, LoopExperiment) and "hardware" in experiment.backends:
            yield entry.name, partial(_of_experiment, entry)


def _set(scenario, name):
    for part, settings in SETTINGS.get(name, {}).items():
        for key, value in settings.items():
            setattr(getattr(scenario, part), key, value)
    return scenario


def _of_machine(machine, **fields):
    return ClosedLoop(machine, _set(machine.scenario(**fields), machine.name), log=())


def _of_experiment(entry, **fields):
    experiment = entry.load()
    scenario = _set(load_scenario(experiment.schema, entry.default_scenario), entry.name)
    return experiment.loop(replace(scenario, **fields), log=())


class _Played(Device):
    """Shows what is put into it and notes what is written."""

    def __init__(self, part, ports):
        self.name, self.part = f"played {part}", part
        self.measures, self.commands = dict(ports.measures), dict(ports.commands)
        self.shown, self.written = {}, []

    def configure(self):
        """Nothing is there."""

    def read(self):
        return {signal: self.shown[f"{self.part}.{signal}"] for signal in self.measures}

    def write(self, commands):
        self.written.append({f"{self.part}.{name}": value for name, value in commands.items()})

    def close(self):
        """Nothing is there."""


@dataclass
class _PlayedDriver(Driver):
    part: str = field(default="legs")

    def make(self, ports):
        return _Played(self.part, ports)


class _InStep:
    """Takes the place of a device's thread: samples and commands are those of the instant."""

    error = None

    def __init__(self, device, period):
        self.device = device

    @property
    def sample(self):
        return Sample(self.device.read(), 0.0, DeviceFault.NONE, "")

    def taken(self):
        """The next sample is there at any time."""

    def post(self, commands, measured):
        self.device.write(commands)


def simulated(loop):
    """(time, n): measurements and commands by name, at each instant before the loop's updates."""
    simulator, machine = Simulator(loop), loop.machine
    root = simulator.get_mutable_context()
    loop.reset(root)
    names = [port.name for port in (*machine.measured, *machine.inputs)]
    readings = loop.readings(root, names)
    simulator.Initialize()
    period, rows = loop.station.scenario.control.period, []
    for k in range(round(_DURATION / period) + 1):
        if k:  # to the beginning it would be advanced beyond the updates there
            simulator.AdvanceTo(k * period)
        rows.append({name: np.array(read()) for name, read in readings.items()})
    return rows


def written(loop, rows):
    """Commands to the devices at each instant, by name."""
    played = [thread.device for thread in loop.station.behind.handle.all_threads]
    simulator = Simulator(loop)
    period = loop.station.scenario.control.period

    def show(row):
        for device in played:
            device.shown = row

    show(rows[0])
    loop.reset(simulator.get_mutable_context())
    simulator.Initialize()
    for k, row in enumerate(rows):
        show(row)
        simulator.AdvanceTo((k + 0.5) * period)
    found = [{} for _ in rows]
    for device in played:
        if device.commands:
            assert len(device.written) == len(rows)
            for commands, new in zip(found, device.written, strict=True):
                commands |= new
    return found


LOOPS = list(_loops())


@pytest.mark.parametrize(("name", "make"), LOOPS, ids=[name for name, _ in LOOPS])
def test_devices_are_commanded_what_a_simulated_plant_is(name, make, monkeypatch):
    rows = simulated(make(backend="kinematic"))
    monkeypatch.setattr(devices, "DeviceThread", _InStep)
    # However long this computer pauses, no measurement grows old.
    monkeypatch.setattr(devices, "PartReader", partial(PartReader, clock=lambda: 0.0))
    machine = make(backend="kinematic").machine
    parts = sorted({port.part for port in (*machine.measured, *machine.inputs)})
    drivers = HardwareScenario([_PlayedDriver(part) for part in parts])
    loop = make(backend="hardware", hardware=drivers)
    found = written(loop, rows)
    moves = False
    for port in machine.inputs:
        if port.name not in rows[0]:
            continue  # nothing drives it
        # A sampled command counts at its instant; another is held from its instant to the next.
        later = 0 if port.is_sampled else 1
        for k in range(len(rows) - 1):
            wanted, got = rows[k + later][port.name], found[k][port.name]
            np.testing.assert_array_equal(got, wanted, f"{port.name} at instant {k}")
            moves = moves or bool(np.any(wanted != rows[0][port.name]))
    assert moves, "nothing is ever commanded"
