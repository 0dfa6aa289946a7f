import os
import subprocess
import sys
import time

import grpc
import nidaqmx
import numpy as np
import pytest
from nidaqmx import constants
from nidaqmx.constants import EncoderType, Level, TaskMode
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError, RpcError
from nidaqmx.stream_readers import (
    AnalogMultiChannelReader,
    CounterReader,
    DigitalSingleChannelReader,
)
from nidaqmx.stream_writers import AnalogMultiChannelWriter, DigitalSingleChannelWriter
from nidaqmx.system import Device, System
from nidaqmx.system.watchdog import WatchdogTask
from nidaqmx.types import DOExpirationState

from parapod.systems.hardware.ni import daqmx


@pytest.fixture
def channel(server):
    with grpc.insecure_channel(server.target) as channel:
        yield channel


@pytest.fixture
def options(channel):
    """options(name) gives the driver library the server's session of that name."""
    return lambda name="", **rest: nidaqmx.GrpcSessionOptions(channel, name, **rest)


@pytest.fixture
def task(options):
    """task() gives a new task of the driver library."""
    return lambda name="": nidaqmx.Task(name, grpc_options=options(name))


def code(call, *arguments, **settings):
    with pytest.raises(DaqError) as caught:
        call(*arguments, **settings)
    assert str(caught.value.error_code) in str(caught.value)
    return caught.value.error_type


def outputs(task, **settings):
    made = task()
    made.ao_channels.add_ao_voltage_chan("PXI1Slot2/ao0:1", **settings)
    return made


def write(made, volts, auto_start=True):
    writer = AnalogMultiChannelWriter(made.out_stream, auto_start)
    writer.verify_array_shape = False
    writer.write_one_sample(np.array(volts))


def test_errors_are_those_of_the_driver():
    assert set(daqmx._TEXTS) <= {error.value for error in DAQmxErrors}


def test_voltage_outside_the_range_of_the_task_is_refused(task, server):
    made = outputs(task, min_val=0.0, max_val=5.0)
    write(made, [1.0, 2.0])
    assert server.wiring.outputs == (1.0, 2.0, 0.0, 0.0)
    for volts in (5.1, -0.1, float("nan")):
        assert code(write, made, [3.0, volts]) is DAQmxErrors.INVALID_AO_DATA_WRITE
    assert server.wiring.outputs == (1.0, 2.0, 0.0, 0.0)


def encoder(made, counter="PXI1Slot2/ctr1", **settings):
    made.ci_channels.add_ci_lin_encoder_chan(counter, **settings)
    return made


def read(made):
    return CounterReader(made.in_stream).read_one_sample_double()


@pytest.mark.parametrize(
    ("decoding", "distance"), [("X_4", 4e-5), ("X_2", 4e-5), ("X_1", 4e-5), ("X_4", 8e-5)]
)
def test_counters_count_while_their_task_runs(task, harness, decoding, distance):
    harness.set("legs.extension", (0.0, 0.1, 0.0, 0.0))
    made = encoder(
        task(),
        decoding_type=EncoderType[decoding],
        dist_per_pulse=distance,
        initial_pos=2.0,
    )
    assert read(made) == 2.0
    harness.set("legs.extension", (0.0, 0.2, 0.0, 0.0))
    assert read(made) == 2.0
    made.start()
    harness.set("legs.extension", (0.0, 0.19, 0.0, 0.0))
    # A pulse is four edges of 10 um.
    assert read(made) == pytest.approx(2.0 - 0.01 * distance / 4e-5)


def unchecked(kind, made):
    """A reader that does not ask the card for the shape of its arrays."""
    reader = kind(made.in_stream)
    reader.verify_array_shape = False
    return reader


@pytest.fixture
def recorded(server, monkeypatch):
    """Arguments of the last call of each function, a task by its name."""
    arguments_of, call = {}, server.card.call

    def record(function, arguments):
        arguments_of[function] = {
            name: getattr(value, "name", value) for name, value in arguments.items()
        }
        return call(function, arguments)

    monkeypatch.setattr(server.card, "call", record)
    return arguments_of


def test_every_function_gets_what_the_library_sends_and_answers_what_it_expects(
    server, harness, task, options, recorded
):
    """By values of which no two are alike, so that none can come from another's field."""
    harness.set("legs.limits", (0.0, 1.0, 1.0) + (0.0,) * 9)
    behaviour = nidaqmx.SessionInitializationBehavior.INITIALIZE_SERVER_SESSION
    with nidaqmx.Task("new", grpc_options=options("new", initialization_behavior=behaviour)):
        assert recorded["CreateTask"] == {"session_name": "new", "initialization_behavior": 1}
    assert recorded["ClearTask"] == {"task": "new"}
    assert System.remote(options()).driver_version == (25, 0, 0)
    assert recorded["GetSystemInfoAttributeUInt32"] == {"attribute_raw": 0x2F22}
    assert Device("PXI1Slot2", grpc_options=options()).product_type == "PXIe-6363"
    assert recorded["GetDeviceAttributeString"] == {
        "device_name": "PXI1Slot2",
        "attribute_raw": 0x631,
    }

    voltages = task("voltages")
    voltages.ao_channels.add_ao_voltage_chan("PXI1Slot2/ao1:2", min_val=-1.0, max_val=2.0)
    assert recorded["CreateAOVoltageChan"] == {
        "task": "voltages",
        "physical_channel": "PXI1Slot2/ao1:2",
        "min_val": -1.0,
        "max_val": 2.0,
    }
    assert (voltages.name, voltages.number_of_channels) == ("voltages", 2)
    assert voltages.channel_names == ["PXI1Slot2/ao1", "PXI1Slot2/ao2"]
    assert recorded["GetTaskAttributeUInt32"] == {"task": "voltages", "attribute_raw": 0x2181}
    assert recorded["GetTaskAttributeString"] == {"task": "voltages", "attribute_raw": 0x1273}
    write(voltages, [1.5, -0.5])
    assert server.wiring.outputs == (0.0, 1.5, -0.5, 0.0)
    written = recorded["WriteAnalogF64"]
    assert (written["task"], written["auto_start"]) == ("voltages", True)
    assert list(written["write_array"]) == [1.5, -0.5]

    relay = task("relay")
    relay.do_channels.add_do_chan("PXI1Slot2/port0/line12")
    assert recorded["CreateDOChan"] == {"task": "relay", "lines": "PXI1Slot2/port0/line12"}
    DigitalSingleChannelWriter(relay.out_stream, auto_start=True).write_one_sample_one_line(True)
    assert recorded["WriteDigitalLines"] == {
        "task": "relay",
        "auto_start": True,
        "write_array": b"\1",
    }
    assert server.wiring.is_relay_closed

    inputs, bits = task("inputs"), np.zeros(3, dtype=bool)
    inputs.di_channels.add_di_chan("PXI1Slot2/port0/line0:2")
    assert recorded["CreateDIChan"] == {"task": "inputs", "lines": "PXI1Slot2/port0/line0:2"}
    unchecked(DigitalSingleChannelReader, inputs).read_one_sample_multi_line(bits)
    assert bits.tolist() == [False, True, True]
    assert recorded["ReadDigitalLines"] == {"task": "inputs"}

    cells, volts = task("cells"), np.zeros((2, 3))
    cells.ai_channels.add_ai_voltage_chan("PXI1Slot2/ai3:4", min_val=-0.4, max_val=0.3)
    assert recorded["CreateAIVoltageChan"] == {
        "task": "cells",
        "physical_channel": "PXI1Slot2/ai3:4",
        "min_val": -0.4,
        "max_val": 0.3,
    }
    assert unchecked(AnalogMultiChannelReader, cells).read_many_sample(volts, 3) == 3
    assert recorded["ReadAnalogF64"] == {
        "task": "cells",
        "num_samps_per_chan": 3,
        "fill_mode_raw": constants.FillMode.GROUP_BY_CHANNEL.value,
    }
    assert np.all(np.abs(volts) < 7e-5)  # noise of the range of 0.5 V

    counter = encoder(
        task("counter"), decoding_type=EncoderType.X_2, dist_per_pulse=2e-3, initial_pos=3.0
    )
    assert recorded["CreateCILinEncoderChan"] == {
        "task": "counter",
        "counter": "PXI1Slot2/ctr1",
        "decoding_type_raw": EncoderType.X_2.value,
        "units_raw": constants.LengthUnits.METERS.value,
        "dist_per_pulse": 2e-3,
        "initial_pos": 3.0,
    }
    assert read(counter) == 3.0
    assert recorded["ReadCounterScalarF64"] == {"task": "counter"}
    counter.start()
    assert recorded["StartTask"] == {"task": "counter"}
    counter.stop()
    assert recorded["StopTask"] == {"task": "counter"}

    attach = nidaqmx.SessionInitializationBehavior.ATTACH_TO_SERVER_SESSION
    watchdog = WatchdogTask("PXI1Slot2", "watchdog", 4.5, options("watchdog"))
    again = WatchdogTask(
        "PXI1Slot2", "watchdog", 5.5, options("watchdog", initialization_behavior=attach)
    )
    assert recorded["CreateWatchdogTimerTaskEx"] == {
        "device_name": "PXI1Slot2",
        "session_name": "watchdog",
        "timeout": 5.5,
        "initialization_behavior": 2,
    }
    del again
    lines = {"PXI1Slot2/port0/line12": Level.LOW, "PXI1Slot2/port0/line13": Level.HIGH}
    watchdog.cfg_watchdog_do_expir_states(
        [DOExpirationState(line, level) for line, level in lines.items()]
    )
    states = recorded["CfgWatchdogDOExpirStates"]
    assert (states["task"], states["channel_names"]) == ("watchdog", "PXI1Slot2/port0/line12:13")
    assert list(states["expir_state_array"]) == [level.value for level in lines.values()]
    watchdog.control(TaskMode.TASK_RESERVE)
    assert recorded["TaskControl"] == {"task": "watchdog", "action_raw": 4}
    assert watchdog.expired is False
    assert recorded["GetWatchdogAttributeBool"] == {"task": "watchdog", "attribute_raw": 0x21A8}
    watchdog.clear_expiration()
    assert recorded["ControlWatchdogTask"] == {"task": "watchdog", "action_raw": 1}

    assert recorded.keys() == daqmx.FUNCTIONS.keys()


def test_numbers_are_those_of_the_library():
    actions = constants.WDTTaskAction
    assert actions.CLEAR_EXPIRATION.value == daqmx._CLEAR_EXPIRATION
    modes = TaskMode.TASK_RESERVE.value, TaskMode.TASK_UNRESERVE.value
    assert modes == (daqmx._RESERVE, daqmx._UNRESERVE)
    assert {Level.HIGH.value: True, Level.LOW.value: False} == daqmx._LEVELS
    edges = {EncoderType.X_1: 1, EncoderType.X_2: 2, EncoderType.X_4: 4}
    assert {kind.value: count for kind, count in edges.items()} == daqmx._DECODINGS


def raw(channel, function, request=b"", service="nidaqmx_grpc.NiDAQmx"):
    """The bytes that a function answers."""
    return channel.unary_unary(f"/{service}/{function}")(request, timeout=60.0)


def test_what_it_does_not_know_is_unimplemented(channel, server, task):
    for call in (("SelfTestDevice",), ("advance",), ("CreateTask", b"", "another.Service")):
        with pytest.raises(grpc.RpcError) as caught:
            raw(channel, *call)
        assert caught.value.code() is grpc.StatusCode.UNIMPLEMENTED
    assert server.card.tasks == ()
    with pytest.raises(RpcError, match="Upgrade NI gRPC Device Server"):
        task().wait_until_done()


def test_samples_are_read_by_channel(channel, task):
    task("cells").ai_channels.add_ai_voltage_chan("PXI1Slot2/ai0")
    # Fields 1 (a session, whose field 1 is its name), 2 (one sample) and 5 (by scan number).
    request = b"\x0a\x07\x0a\x05cells\x10\x01"
    assert len(raw(channel, "ReadAnalogF64", request)) == 2 + 8 + 2
    with pytest.raises(grpc.RpcError, match="not a supported value") as caught:
        raw(channel, "ReadAnalogF64", request + b"\x28\x01")
    assert "FillMode" in caught.value.details()
    assert dict(caught.value.trailing_metadata())["ni-error"] == "-200077"


def test_calls_that_hang_leave_threads_to_those_after_them(misbehaviour, server):
    with grpc.insecure_channel(server.target) as channel:
        create = channel.unary_unary("/nidaqmx_grpc.NiDAQmx/CreateTask")
        misbehaviour.begin("off", time.monotonic())
        # More than the server has threads.
        hanging = [create.future(b"", timeout=0.2) for _ in range(40)]
        assert {call.code() for call in hanging} == {grpc.StatusCode.DEADLINE_EXCEEDED}
        # The server learns of it a moment later.
        time.sleep(0.05)
        misbehaviour.end()
        assert b"_unnamedTask" in create(b"", timeout=60.0)
    # None of those that were given up was carried out.
    assert len(server.card.tasks) == 1


# Reads the card behind a target until its server is gone.
CLIENT = """
import sys
from parapod.systems.hardware.device import DeviceError
from parapod.systems.hardware.ni.card import NiDaq
from parapod.systems.hardware.ni.settings import NiDaqSettings
card = NiDaq(NiDaqSettings(target=sys.argv[1], timeout_ms=10_000.0, extension_file=""))
card.configure()
print("reads", flush=True)
try:
    while True:
        card.read()
except DeviceError as error:
    print(error.fault.name)
card.close()
"""


def test_end_of_a_server_is_told_by_the_device_alone(server, misbehaviour):
    quiet = {name: value for name, value in os.environ.items() if name != "GRPC_VERBOSITY"}
    pipe = subprocess.PIPE
    run = [sys.executable, "-c", CLIENT, server.target]
    with subprocess.Popen(run, stdout=pipe, stderr=pipe, text=True, env=quiet) as client:
        assert client.stdout.readline() == "reads\n"
        misbehaviour.begin("unplugged", time.monotonic())
        assert client.communicate() == ("UNPLUGGED\n", "")


@pytest.mark.parametrize(("given", "kept"), [({}, "ERROR"), ({"GRPC_VERBOSITY": "INFO"}, "INFO")])
def test_what_grpc_tells_a_terminal_is_somebody_s_own_will(given, kept):
    program = "import os, parapod.systems.hardware.ni; print(os.environ['GRPC_VERBOSITY'])"
    quiet = {name: value for name, value in os.environ.items() if name != "GRPC_VERBOSITY"}
    run = [sys.executable, "-c", program]
    assert subprocess.check_output(run, text=True, env=quiet | given) == f"{kept}\n"
