"""Force cells at a card: what they show, and which voltages are no force."""

import math
import tempfile
import time

import grpc
import nidaqmx
import pytest
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError

from parapod.diagrams.drivers.driver import PartPorts
from parapod.diagrams.drivers.ni_daq import NiDaqForceCells
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour

STEP = 20.0 / 2**16  # of the converter in the range of 10 V [V]
# Seven times the noise, whose standard deviation is a step, and half a step.
NEAR = 7.5 * 200.0 * STEP
FORCE = (100.0, -250.0, 1234.5)


class Bench:
    """Cells on their emulated card."""

    def __init__(self, **settings):
        self.misbehaviour, self.harness = Misbehaviour(), Harness({"cells.force": 3})
        self.driver = NiDaqForceCells(timeout_ms=5000.0, **settings)
        self.server = self.driver.emulate(self.harness, self.misbehaviour)
        self.device = self.driver.make(PartPorts({"force": 3}, {}))

    def set(self, *force):
        self.harness.set("cells.force", force)

    def volts(self, monkeypatch, *volts):
        """Puts voltages to the inputs past the cells."""
        shown = dict(zip(("ai0", "ai1", "ai2"), volts, strict=True))
        monkeypatch.setattr(self.server.wiring, "inputs", lambda: shown)

    def read(self):
        return self.device.read()["force"]

    def fails(self):
        with pytest.raises(DeviceError) as caught:
            self.device.read()
        return caught.value


@pytest.fixture
def make(monkeypatch):
    """make(**settings): a bench whose device is configured."""
    benches = []
    with tempfile.TemporaryDirectory(prefix="ni") as folder:
        monkeypatch.setenv("PARAPOD_EMULATOR", folder)

        def made(**settings):
            bench = Bench(**settings)
            benches.append(bench)
            bench.server.__enter__()
            bench.device.configure()
            return bench

        yield made
        for bench in benches:
            bench.device.close()
            bench.server.__exit__(None, None, None)


@pytest.fixture
def bench(make):
    return make()


def test_force_is_the_sensitivity_times_the_voltage_above_that_without_a_force(make, monkeypatch):
    bench = make(newton_per_volt=[200.0, 50.0, -400.0], zero_V=[0.0, 1.0, -0.5])
    bench.volts(monkeypatch, 1.0, 3.0, 2.0)
    near = [pytest.approx(f, abs=s * NEAR) for f, s in ((200, 1), (100, 0.25), (-1000, 2))]
    assert bench.read() == near


@pytest.mark.parametrize(("range_V", "taken"), [(10.0, 10.0), (7.0, 10.0), (2.0, 2.0)])
def test_force_of_the_machine_arrives_with_the_noise_of_one_step(make, range_V, taken):
    bench = make(range_V=range_V)
    forces = [0.1 * taken * force for force in FORCE]
    bench.set(*forces)
    shown = [bench.read() for _ in range(60)]
    assert all(each == pytest.approx(forces, abs=0.1 * taken * NEAR) for each in shown)
    for cell in range(3):
        steps = [each[cell] / 200.0 / (0.1 * taken * STEP) for each in shown]
        assert steps == pytest.approx([round(x) for x in steps], abs=1e-6)
        assert len(set(steps)) > 2


def test_mean_of_many_samples_is_quieter(make):
    bench = make(samples=100)
    bench.set(*FORCE)
    before = bench.server.calls["ReadAnalogF64"]
    assert all(bench.read() == pytest.approx(FORCE, abs=0.8 * 200.0 * STEP) for _ in range(10))
    assert bench.server.calls["ReadAnalogF64"] - before == 10


@pytest.mark.parametrize(("range_V", "shown", "end"), [(10.0, 9.9, 9.9995), (2.0, 1.99, 1.9995)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_voltage_at_an_end_of_the_range_is_told_with_cell_and_channel(
    make, monkeypatch, range_V, shown, end, sign
):
    bench = make(range_V=range_V, channels="PXI1Slot2/ai2,PXI1Slot2/ai0:1")
    bench.volts(monkeypatch, 0.0, sign * shown, 0.0)
    assert bench.read()[2] == pytest.approx(sign * shown * 200.0, abs=NEAR)
    bench.volts(monkeypatch, 0.0, sign * end, 0.0)
    error = bench.fails()
    assert error.fault is DeviceFault.FAILED
    assert "cell 3 at PXI1Slot2/ai1 is at the end of its range" in str(error)
    assert "overload, or a broken wire" in str(error)
    bench.volts(monkeypatch, 0.0, 0.0, 0.0)
    assert bench.read() == pytest.approx([0.0] * 3, abs=NEAR)


def test_one_sample_at_the_end_is_enough(make, monkeypatch):
    bench = make(samples=50)
    scans = iter([*[{}] * 20, {"ai1": 10.0}])
    monkeypatch.setattr(bench.server.wiring, "inputs", lambda: next(scans, {}))
    assert "cell 2 at PXI1Slot2/ai1" in str(bench.fails())


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_voltage_that_is_not_a_number_is_told_with_cell_and_channel(bench, monkeypatch, bad):
    monkeypatch.setattr(bench.server.card, "_converted", lambda task: [0.0, bad, 0.0])
    error = bench.fails()
    assert error.fault is DeviceFault.CORRUPT
    assert f"cell 2 at PXI1Slot2/ai1 reads {bad} V" in str(error)


def test_samples_that_do_not_come_are_none_of_the_last_reading(bench, monkeypatch):
    bench.read()
    monkeypatch.setattr(bench.server.card, "ReadAnalogF64", lambda **_: ([0.0], 0))
    assert bench.fails().fault is DeviceFault.CORRUPT


def test_wrong_card_is_refused(make, monkeypatch):
    bench = make()
    bench.device.close()
    monkeypatch.setattr(bench.server.card, "_product", "PXIe-6341")
    with pytest.raises(DeviceError, match="PXI1Slot2 is a PXIe-6341, not a PXIe-6363"):
        bench.device.configure()
    with pytest.raises(DeviceError, match="not configured"):
        bench.device.read()


def test_channel_that_is_refused_leaves_no_task(make):
    bench = make()
    bench.device.close()
    settings = {**vars(bench.driver), "channels": "PXI1Slot2/ai30:32"}
    other = NiDaqForceCells(**settings).make(PartPorts({"force": 3}, {}))
    with pytest.raises(DeviceError, match="ai32"):
        other.configure()
    assert bench.server.card.tasks == ()


def test_cells_of_a_program_that_was_killed_are_taken_over(bench):
    bench.device._session = None  # nothing is given back
    assert bench.server.card.tasks == ("parapod_PXI1Slot2_force_cells",)
    bench.device.configure()
    bench.set(*FORCE)
    assert bench.read() == pytest.approx(FORCE, abs=NEAR)
    bench.device.close()
    assert bench.server.card.tasks == ()


def test_emulated_cells_that_are_wrong_change_their_sign(bench):
    bench.set(*FORCE)
    bench.misbehaviour.begin("wrong", time.monotonic())
    assert bench.read() == pytest.approx([-force for force in FORCE], abs=NEAR)


def test_force_of_a_machine_that_has_none_is_zero(bench):
    bench.set(math.nan, 100.0, math.inf)
    assert bench.read() == pytest.approx([0.0, 100.0, 0.0], abs=NEAR)


# --- the emulated driver


@pytest.fixture
def task(bench):
    channel = grpc.insecure_channel(bench.server.target)
    yield nidaqmx.Task("", grpc_options=nidaqmx.GrpcSessionOptions(channel, ""))
    channel.close()


def refused(call, *arguments, **options):
    with pytest.raises(DaqError) as caught:
        call(*arguments, **options)
    return caught.value.error_type


def test_inputs_that_a_card_does_not_have_are_refused(task):
    add = task.ai_channels.add_ai_voltage_chan
    assert refused(add, "PXI1Slot2/ai32") is DAQmxErrors.PHYSICAL_CHAN_DOES_NOT_EXIST
    assert refused(add, "PXI1Slot2/ao0").value == -200430
    wide = {"min_val": -11.0, "max_val": 11.0}
    assert refused(add, "PXI1Slot2/ai3", **wide) is DAQmxErrors.INVALID_ATTRIBUTE_VALUE
    assert refused(add, "PXI1Slot2/ai3", min_val=1.0, max_val=1.0).value == -200082


@pytest.mark.parametrize("channel", ["ai2", "ai3"])
def test_one_task_has_the_converter_while_it_runs(task, channel):
    task.ai_channels.add_ai_voltage_chan(f"PXI1Slot2/{channel}")
    assert refused(task.start) is DAQmxErrors.PAL_RESOURCE_RESERVED
