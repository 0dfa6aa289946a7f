import os
import subprocess
import sys
import time

import grpc
import nidaqmx
import numpy as np
import pytest
from nidaqmx._stubs import nidaqmx_pb2, nidaqmx_pb2_grpc
from nidaqmx.constants import EncoderType
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError
from nidaqmx.stream_readers import CounterReader
from nidaqmx.stream_writers import AnalogMultiChannelWriter

from parapod.systems.hardware.ni import daqmx


@pytest.fixture
def task(server):
    """task() gives a new task of the driver library."""
    channel = grpc.insecure_channel(server.target)

    def create(name=""):
        return nidaqmx.Task(name, grpc_options=nidaqmx.GrpcSessionOptions(channel, name))

    yield create
    channel.close()


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


def test_calls_that_hang_leave_threads_to_those_after_them(misbehaviour, server):
    with grpc.insecure_channel(server.target) as channel:
        create = nidaqmx_pb2_grpc.NiDAQmxStub(channel).CreateTask
        request = nidaqmx_pb2.CreateTaskRequest()
        misbehaviour.begin("off", time.monotonic())
        # More than the server has threads.
        hanging = [create.future(request, timeout=0.2) for _ in range(40)]
        assert {call.code() for call in hanging} == {grpc.StatusCode.DEADLINE_EXCEEDED}
        # The server learns of it a moment later.
        time.sleep(0.05)
        misbehaviour.end()
        assert create(request, timeout=60.0).task.name
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
