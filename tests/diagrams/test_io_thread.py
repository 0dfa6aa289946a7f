"""Functions beside a loop: read, written, neutral in time, never waited for."""

import math
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, VectorLogSink

import parapod
from parapod.diagrams.wiring import connect
from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.device import DeviceError, DeviceFault
from tests.systems.hardware.buses.conftest import until

PAGE = Path(__file__).parents[2] / "docs" / "your_own" / "driver.md"


class Bus:
    """A motor whose calls take their time."""

    def __init__(self):
        self.position, self.voltages, self.fails = [0.5, -0.25], [], None
        self.hangs = threading.Event()
        self.hangs.set()

    def read(self):
        assert self.hangs.wait(60.0)
        if self.fails is not None:
            raise self.fails
        time.sleep(1e-3)
        return self.position

    def write(self, voltages):
        self.voltages.append(tuple(voltages))


def loop_of(io, command=(1.0, 2.0)):
    builder = DiagramBuilder()
    builder.AddSystem(io)
    if io.num_input_ports():
        source = builder.AddSystem(ConstantVectorSource(command))
        connect(builder, source.get_output_port(), io.GetInputPort("command"))
    sinks = {}
    for i in range(io.num_output_ports()):
        port = io.get_output_port(i)
        sink = builder.AddSystem(VectorLogSink(port.size(), 0.01))
        connect(builder, port, sink.get_input_port())
        sinks[port.get_name()] = sink
    simulator = Simulator(builder.Build())
    simulator.set_target_realtime_rate(1.0)
    return simulator, lambda name: sinks[name].FindLog(simulator.get_context()).data().T


def test_numbers_are_read_and_written_and_neutral_at_the_end():
    bus = Bus()
    io = parapod.IoThread(read=bus.read, size=2, write=bus.write, count=2)
    simulator, logged = loop_of(io)
    with io:
        io.reset(simulator.get_mutable_context())
        simulator.AdvanceTo(0.1)
        until(lambda: (1.0, 2.0) in bus.voltages)
    assert (logged("measurement") == bus.position).all(axis=1).any()
    assert DeviceFault.NONE in logged("fault")
    assert bus.voltages[-1] == (0.0, 0.0)


def test_silence_of_the_loop_makes_it_neutral():
    bus, neutral = Bus(), []
    io = parapod.IoThread(
        write=bus.write, count=2, neutral=lambda: neutral.append(time.monotonic()), timeout=0.05
    )
    simulator, _ = loop_of(io)
    with io:
        simulator.AdvanceTo(0.02)
        until(lambda: bus.voltages)
        # The loop stands.
        until(lambda: neutral)
    assert (0.0, 0.0) not in bus.voltages


def test_a_command_that_is_not_finite_is_neutral():
    bus = Bus()
    io = parapod.IoThread(write=bus.write, count=2)
    simulator, _ = loop_of(io, (1.0, math.nan))
    with io:
        simulator.AdvanceTo(0.02)
        until(lambda: bus.voltages)
    assert set(bus.voltages) == {(0.0, 0.0)}


def test_a_call_that_hangs_stops_no_loop_and_its_numbers_grow_old():
    bus = Bus()
    io = parapod.IoThread(read=bus.read, size=2, stale_after=0.05)
    simulator, logged = loop_of(io)
    with io:
        simulator.AdvanceTo(0.05)
        bus.hangs.clear()
        time.sleep(0.06)
        simulator.AdvanceTo(0.2)
        bus.hangs.set()
    assert np.isnan(logged("measurement")[-1]).all()
    assert logged("age")[-1] > 0.05
    assert np.isfinite(logged("measurement")).any()


def test_a_call_that_raises_is_a_fault_and_is_tried_again():
    bus = Bus()
    io = parapod.IoThread(read=bus.read, size=2)
    simulator, logged = loop_of(io)
    with io:
        bus.fails = OSError("no such device")
        until(lambda: io._io.error is not None)
        simulator.AdvanceTo(0.02)
        assert "no such device" in str(io._io.error)
        bus.fails = None
        until(lambda: io._io.error is None)
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.02)
    assert DeviceFault.FAILED in logged("fault")
    assert logged("fault")[-1] == DeviceFault.NONE


def test_what_cannot_be_read_at_first_is_refused():
    def read():
        raise OSError("no such device")

    with pytest.raises(DeviceError, match=r"^arm: OSError no such device"):
        parapod.IoThread(read=read, size=2, name="arm").__enter__()


def test_another_number_of_values_is_told():
    with pytest.raises(DeviceError, match="arm: read returned 3 numbers, not 2"):
        parapod.IoThread(read=lambda: (1.0, 2.0, 3.0), size=2, name="arm").__enter__()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "io: there must be a function to read or one to write"),
        ({"read": list}, "io: size must be above 0 with its function alone"),
        ({"count": 2}, "io: count must be above 0 with its function alone"),
    ],
)
def test_functions_and_numbers_belong_together(options, words):
    with pytest.raises(ParapodError, match=words):
        parapod.IoThread(**options)


def test_the_ten_lines_of_the_page_run():
    text = PAGE.read_text(encoding="utf-8").partition("## Without a machine")[2]
    program = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    program = program.replace("AdvanceTo(10.0)", "AdvanceTo(0.1)")
    bus = Bus()
    bus.set_voltage, readings = bus.write, bus.position
    bus.position = lambda: readings
    exec(program, {"bus": bus})
    until(lambda: (-1.5, 0.75) in bus.voltages)
    assert bus.voltages[-1] == (0.0, 0.0)
