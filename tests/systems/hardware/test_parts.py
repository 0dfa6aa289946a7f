"""The systems between device threads and diagrams."""

import time

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import DiscreteTimeIntegrator, Gain

from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.io import DeviceThread, PartReader, PartWriter, Sample


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


class StillThread(DeviceThread):
    """Shows what a test says and remembers what is posted."""

    def __init__(self, device, clock):
        super().__init__(device, clock=clock)
        self.shown = Sample({"position": (1.0, 2.0)}, clock(), DeviceFault.NONE, "")
        self.posted = []

    @property
    def sample(self):
        return self.shown

    def taken(self):
        pass

    def post(self, commands, measured):
        self.posted.append((commands, measured))


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def still(fake, clock):
    return StillThread(fake(), clock)


def read(reader, context, name):
    return reader.GetOutputPort(name).Eval(context)


def test_ports_are_the_devices_signals(still, clock):
    reader, writer = PartReader("legs", [still], clock=clock), PartWriter("legs", [still])
    outputs = {p.get_name(): p.size() for p in map(reader.get_output_port, range(4))}
    assert outputs == {"position": 2, "age": 1, "fault": 1, "stamp": 1}
    inputs = {p.get_name(): p.size() for p in map(writer.get_input_port, range(3))}
    assert inputs == {"velocity": 2, "brake": 1, "stamp": 1}


def test_a_loop_begins_with_measurements(still, clock):
    reader = PartReader("legs", [still], clock=clock)
    context = reader.CreateDefaultContext()
    clock.now += 0.003
    reader.reset(context)
    np.testing.assert_array_equal(read(reader, context, "position"), [1.0, 2.0])
    assert read(reader, context, "age")[0] == pytest.approx(0.003)
    assert read(reader, context, "stamp")[0] == 100.0


def test_a_loop_does_not_begin_with_a_device_that_has_failed(still, clock):
    still.shown = still.shown._replace(fault=DeviceFault.SILENT, words="nobody there")
    reader = PartReader("legs", [still], clock=clock)
    with pytest.raises(DeviceError, match=r"^fake: nobody there$"):
        reader.reset(reader.CreateDefaultContext())


def test_stale_measurements_are_not_numbers_and_age_says_why(still, clock):
    reader = PartReader("legs", [still], stale_after=0.05, clock=clock)
    simulator = Simulator(reader)
    reader.reset(simulator.get_mutable_context())
    simulator.Initialize()
    still.shown = still.shown._replace(fault=DeviceFault.SILENT, words="quiet")
    clock.now += 0.04
    simulator.AdvanceTo(0.011)
    context = simulator.get_context()
    assert np.isfinite(read(reader, context, "position")).all()
    assert read(reader, context, "fault")[0] == DeviceFault.SILENT
    clock.now += 0.02
    simulator.AdvanceTo(0.021)
    assert np.isnan(read(reader, context, "position")).all()
    assert read(reader, context, "age")[0] == pytest.approx(0.06)


def test_the_oldest_device_of_a_part_says_how_old_it_is(fake, clock):
    old, new = StillThread(fake("a"), clock), StillThread(fake("b"), clock)
    new.device.measures = {"angle": 2}
    old.shown = old.shown._replace(stamp=99.0)
    new.shown = new.shown._replace(values={"angle": (3.0, 4.0)})
    reader = PartReader("legs", [new, old], clock=clock, stale_after=2.0)
    context = reader.CreateDefaultContext()
    reader.reset(context)
    assert read(reader, context, "age")[0] == pytest.approx(1.0)
    np.testing.assert_array_equal(read(reader, context, "angle"), [3.0, 4.0])


def test_commands_are_made_of_the_measurements_of_the_same_instant(still, clock):
    """Read in an unrestricted update, control in a discrete one, write: no tick in between."""
    builder = DiagramBuilder()
    reader = builder.AddSystem(PartReader("legs", [still], 0.01, clock=clock))
    gain = builder.AddSystem(Gain(10.0, 2))
    held = builder.AddSystem(DiscreteTimeIntegrator(2, 0.01))
    writer = builder.AddSystem(PartWriter("legs", [still], 0.01))
    builder.Connect(reader.GetOutputPort("position"), gain.get_input_port())
    builder.Connect(gain.get_output_port(), held.get_input_port())
    builder.Connect(gain.get_output_port(), writer.GetInputPort("velocity"))
    builder.Connect(reader.GetOutputPort("stamp"), writer.GetInputPort("stamp"))
    builder.ExportInput(writer.GetInputPort("brake"), "brake")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.get_input_port().FixValue(context, [0.0])
    reader.reset(reader.GetMyMutableContextFromRoot(context))
    simulator.Initialize()
    for k in range(5):
        clock.now += 0.01
        still.shown = Sample({"position": (k, -k)}, clock.now, DeviceFault.NONE, "")
        simulator.AdvanceTo((k + 0.5) * 0.01)
        commands, measured = still.posted[-1]
        assert commands == {"velocity": (10.0 * k, -10.0 * k), "brake": (0.0,)}
        assert measured == clock.now
    assert len(still.posted) == 5


def test_without_a_stamp_commands_are_of_now(still):
    writer = PartWriter("legs", [still], 0.01)
    simulator = Simulator(writer)
    context = simulator.get_mutable_context()
    writer.GetInputPort("velocity").FixValue(context, [0.0, 0.0])
    writer.GetInputPort("brake").FixValue(context, [0.0])
    simulator.AdvanceTo(0.005)
    assert abs(still.posted[0][1] - time.monotonic()) < 1.0
