import math
import random
import socket
import time

import pytest
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError

from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ni import card as ni_card
from parapod.systems.hardware.ni.card import NiDaq
from parapod.systems.hardware.ni.settings import NiDaqSettings
from parapod.systems.hardware.ni.tasks import NiTasks

COUNT = 1e-5
# Longest time for a call: where a test waits for it, and where a busy computer may need it [s].
TIMEOUT, PATIENCE = 0.2, 5.0
# What a busy computer may add to a timeout [s].
MARGIN = 0.3
# The watchdog has tests of its own: see test_watchdog.py.
PATIENT = {"watchdog_ms": 10000.0}


def device(server, **settings):
    settings = {"extension_file": "", "timeout_ms": 1e3 * PATIENCE} | PATIENT | settings
    return NiDaq(NiDaqSettings(target=server.target, **settings))


impatient = pytest.mark.parametrize("timeout", [TIMEOUT])


@pytest.fixture
def timeout():
    return PATIENCE


@pytest.fixture
def card(server, timeout):
    """A device that is configured and active."""
    with device(server, timeout_ms=1e3 * timeout) as card:
        card.activate()
        yield card


def drive(card, voltage=(0.0,) * 4, stop=0.0):
    card.write({"voltage": voltage, "stop": (stop,)})


def fails(call, *arguments):
    """The error that a call raises."""
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


def test_voltages_arrive_at_the_actuators_within_the_supply_voltage(card, harness):
    generator = random.Random(0)
    for _ in range(40):
        asked = [generator.uniform(-15.0, 15.0) for _ in range(4)]
        drive(card, asked)
        expected = [min(max(value, -12.0), 12.0) for value in asked]
        assert harness.get("legs.voltage") == pytest.approx(expected, abs=1e-12)


def test_supply_voltage_spans_the_range_of_the_motor_drivers_input(card, server):
    # 2.5 V plus and minus 2.5 V for plus and minus 12 V.
    drive(card, (12.0, -12.0, 6.0, -3.0))
    assert server.wiring.outputs == pytest.approx((5.0, 0.0, 3.75, 1.875), abs=1e-12)


def test_commands_of_the_wrong_size_are_refused(card):
    with pytest.raises(ValueError, match="voltage has 4 elements, not 3"):
        drive(card, (0.0,) * 3)


def test_extension_is_the_way_since_the_start(card, harness):
    harness.set("legs.extension", (0.01, -0.02, 0.0300004, 0.0))
    measured = card.read()["extension"]
    assert measured == pytest.approx((0.01, -0.02, 0.03, 0.0), abs=1e-12)
    assert not card.is_referenced


def test_velocity_is_the_mean_since_the_last_read(card, harness):
    harness.set("legs.extension", (0.1, 0.1, 0.1, 0.1))
    stamps = [time.monotonic()]
    assert card.read()["velocity"] == (0.0,) * 4
    stamps.append(time.monotonic())
    harness.set("legs.extension", (0.11, 0.1, 0.09, 0.05))
    time.sleep(0.02)
    stamps.append(time.monotonic())
    velocity = card.read()["velocity"]
    stamps.append(time.monotonic())
    shortest, longest = stamps[2] - stamps[1], stamps[3] - stamps[0]
    for value, way in zip(velocity, (0.01, 0.0, -0.01, -0.05), strict=True):
        low, high = sorted((way / shortest, way / longest))
        assert low <= value <= high
    assert card.read()["velocity"] == (0.0,) * 4


def test_inputs_keep_the_order_of_the_lines(card, harness):
    for line in range(12):
        expected = tuple(float(other == line) for other in range(12))
        harness.set("legs.limits", expected)
        assert card.read()["limits"] == expected


def test_inputs_come_in_the_order_of_the_channel_string(server, harness):
    harness.set("legs.limits", (1.0,) + (0.0,) * 11)
    inputs = "PXI1Slot2/port0/line3:2,PXI1Slot2/port0/line0"
    with device(server, inputs=inputs) as card:
        assert card.measures["limits"] == 3
        assert card.read()["limits"] == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("direction", [1, -1])
def test_counters_are_followed_through_their_wrap(serve, harness, direction):
    start = (0.1, 0.2, 0.3, 0.4)
    # Five counts before the largest, or the smallest, that a counter shows.
    zero = [value - direction * COUNT * (2**31 - 5) for value in start]
    harness.set("legs.extension", start)
    server = serve(zero_extension=zero)
    with device(server, extension_at_start_mm=[1e3 * x for x in start]) as card:
        for step in range(0, 40, 4):
            moved = [value + direction * COUNT * step for value in start]
            harness.set("legs.extension", moved)
            measured = card.read()
            assert measured["extension"] == pytest.approx(moved, abs=1e-9)
            assert all(abs(value) < 1.0 for value in measured["velocity"])


@pytest.mark.parametrize(
    ("third", "closed", "words"),
    [
        (420.0, (), None),
        (459.9, (2,), None),
        (459.0, (2,), None),  # within the tolerance
        (460.4, (), None),
        (458.0, (2,), "the switch 'extended' of legs 3, which closes at 459.5 mm, is closed"),
        (461.0, (), "'extended' of legs 3, which closes at 459.5 mm, is open"),
        (420.0, (6,), "'retracted' of legs 3, .* is closed, but its extension should be 420.0 mm"),
        (379.0, (), "'retracted' of legs 3, which closes at 380.5 mm, is open"),
        (420.0, (10,), None),  # the ground says nothing about it
    ],
)
def test_a_reference_that_an_end_switch_contradicts_is_refused(
    server, harness, third, closed, words
):
    start = [410.0, 410.0, third, 410.0]
    harness.set("legs.extension", [1e-3 * x for x in start])
    harness.set("legs.limits", [float(i in closed) for i in range(12)])
    ends = {"extended_mm": 459.5, "retracted_mm": 380.5}
    card = device(server, extension_at_start_mm=start, **ends)
    if words is None:
        with card:
            assert card.is_referenced
        return
    with pytest.raises(DeviceError, match=words) as caught, card:
        pass
    assert "parapod home" in str(caught.value)
    with device(server, extension_at_start_mm=start):
        pass  # not compared where nothing says where they close


def test_a_reference_tells_what_the_counts_mean(card, harness):
    harness.set("legs.extension", (0.2, 0.2, 0.2, 0.2))
    card.set_reference((0.01, 0.02, 0.03, 0.04))
    assert card.is_referenced
    assert card.read()["extension"] == pytest.approx((0.01, 0.02, 0.03, 0.04))
    harness.set("legs.extension", (0.25, 0.2, 0.2, 0.1))
    assert card.read()["extension"] == pytest.approx((0.06, 0.02, 0.03, -0.06))


def test_reference_is_lost_with_the_connection(server, harness):
    card = device(server)
    with card:
        card.set_reference((0.3,) * 4)
    harness.set("legs.extension", (0.1,) * 4)
    with card:
        assert not card.is_referenced
        assert card.read()["extension"] == (0.0,) * 4


def channels(name):
    """Settings with all channels on a card of that name."""
    return {
        "outputs": f"{name}/ao0:3",
        "counters": f"{name}/ctr0:3",
        "inputs": f"{name}/port0/line0:11",
        "relay": f"{name}/port0/line12",
        "stop_input": f"{name}/port0/line13",
    }


CARD = "PXI1Slot2"


@pytest.mark.parametrize(
    ("settings", "texts"),
    [
        (channels("PXI1Slot9"), ("PXI1Slot9", "-200220", "Suggested Device: PXI1Slot2")),
        ({"product": "PXIe-6345"}, ("PXI1Slot2 is a PXIe-6363, not a PXIe-6345",)),
        ({"outputs": f"{CARD}/ao1:4"}, ("ao4", "-200170")),
        ({"outputs": f"{CARD}/ai0:3"}, ("ai0", "-200430")),
        (
            {"counters": f"{CARD}/ctr1:4"},
            ("ctr4", "-200170"),
        ),
        ({"counters": ",".join([f"{CARD}/ctr0"] * 4)}, ("reserved", "-50103")),
        ({"inputs": f"{CARD}/port0/line30:33"}, ("port0/line32", "-200170")),
        ({"inputs": f"{CARD}/port3/line0"}, ("port3/line0", "-200170")),
        ({"relay": f"{CARD}/port0/line0"}, ("reserved", "-200587")),
        ({"stop_input": f"{CARD}/port0/line12"}, ("reserved", "-200587")),
        ({"stop_input": f"{CARD}/port0/line11"}, ("-200489",)),
    ],
)
def test_wrong_settings_are_refused_and_energise_nothing(server, harness, settings, texts):
    card = device(server, **settings)
    error = fails(card.configure)
    for text in texts:
        assert text in str(error)
    assert server.wiring.outputs == (0.0,) * 4
    assert not server.wiring.is_relay_closed
    assert harness.get("legs.voltage") == (0.0,) * 4
    assert server.card.tasks == ()
    assert not server.calls["WriteAnalogF64"] + server.calls["WriteDigitalLines"]
    assert fails(card.read).fault is DeviceFault.UNPLUGGED


def test_card_is_identified_before_anything_is_made(serve):
    server = serve(product="PXIe-6345")
    error = fails(device(server).configure)
    assert error.fault is DeviceFault.CORRUPT
    assert not server.calls["CreateTask"]


def test_local_driver_that_is_not_there_is_an_error_of_the_device():
    # Without NI-DAQmx because of that, with it because of the name.
    settings = NiDaqSettings(target="", extension_file="", **channels("NoSuchCard"))
    error = fails(NiDaq(settings).configure)
    assert "NoSuchCard" in error.device


def test_relay_is_closed_while_active_and_not_stopped(server, harness):
    card = device(server)
    states = []

    def note():
        states.append((server.wiring.is_relay_closed, server.wiring.outputs == (2.5,) * 4))

    with card:
        note()
        drive(card, (6.0,) * 4)
        note()
        card.activate()
        note()
        drive(card, (6.0,) * 4)
        note()
        for stop in (1.0, math.nan):
            drive(card, (6.0,) * 4, stop)
            note()
            assert harness.get("legs.stop") == (1.0,)
        drive(card, (6.0,) * 4)
        note()
        card.neutral()
        note()
        drive(card, (6.0,) * 4)
        card.deactivate()
        note()
    # Relay closed, outputs neutral.
    off, still, moving = (False, True), (True, True), (True, False)
    assert states == [off, off, still, moving, off, off, moving, still, off]


def test_relay_is_written_only_when_it_changes(card, server):
    server.calls.clear()
    for stop in (0.0, 0.0, 1.0, 1.0, 0.0):
        drive(card, stop=stop)
    assert server.calls["WriteDigitalLines"] == 2


def test_cycle_needs_few_calls_and_asks_nothing_twice(card, server):
    drive(card)
    server.calls.clear()
    for _ in range(10):
        card.read()
        drive(card, (1.0,) * 4)
    # Four counters, the inputs, the outputs.
    assert server.calls.total() == 60


@impatient
def test_stalled_server_is_told_in_time_by_every_call(card, misbehaviour, judge):
    misbehaviour.begin("off", time.monotonic())
    for call in (lambda: drive(card, (3.0,) * 4), card.neutral):
        with judge() as judged:
            error = fails(call)
        assert error.fault is DeviceFault.SILENT
        assert f"did not answer within {TIMEOUT:g} s" in str(error)
        judged.check(TIMEOUT + MARGIN)
    misbehaviour.end()
    card.read()
    drive(card)


@impatient
def test_command_that_was_given_up_is_not_carried_out_later(card, misbehaviour, server):
    misbehaviour.begin("off", time.monotonic())
    fails(drive, card, (12.0,) * 4)
    time.sleep(0.02)
    misbehaviour.end()
    time.sleep(0.02)
    assert server.wiring.outputs == (2.5,) * 4


@impatient
def test_relay_is_written_again_after_a_write_that_failed(card, misbehaviour, server):
    misbehaviour.begin("off", time.monotonic())
    fails(drive, card, (0.0,) * 4, 1.0)
    misbehaviour.end()
    assert server.wiring.is_relay_closed
    drive(card, stop=1.0)
    assert not server.wiring.is_relay_closed


def test_stalled_server_delays_configure_and_close_no_longer_than_their_time(
    server, misbehaviour, monkeypatch, judge
):
    card = device(server, timeout_ms=1e3 * TIMEOUT)
    misbehaviour.begin("off", time.monotonic())
    with monkeypatch.context() as patience:
        patience.setattr(ni_card, "CONFIGURE_TIMEOUT", 0.3)
        with judge() as judged:
            assert fails(card.configure).fault is DeviceFault.SILENT
    judged.check(0.3 + TIMEOUT + MARGIN)
    misbehaviour.end()
    card.configure()
    card.activate()
    misbehaviour.begin("off", time.monotonic())
    with judge() as judged:
        card.close()
    judged.check(TIMEOUT + MARGIN)


def test_successor_takes_the_card_over_and_stops_the_machine(server, harness):
    dead, successor = device(server), device(server)
    dead.configure()
    dead.activate()
    drive(dead, (12.0,) * 4)
    # Nothing ends the motion when a client is gone.
    assert harness.get("legs.voltage") == (12.0,) * 4
    with successor:
        assert server.wiring.outputs == (2.5,) * 4
        assert not server.wiring.is_relay_closed
        successor.read()
    assert "-200088" in str(fails(dead.read))
    dead.close()


def test_outputs_hold_while_the_server_cannot_be_reached(card, misbehaviour, harness):
    drive(card, (6.0,) * 4)
    misbehaviour.begin("unplugged", time.monotonic())
    assert fails(card.read).fault is DeviceFault.UNPLUGGED
    assert harness.get("legs.voltage") == pytest.approx((6.0,) * 4)


def test_position_that_is_no_number_is_an_error(card, server, monkeypatch):
    monkeypatch.setattr(server.card, "ReadCounterScalarF64", lambda **_: math.nan)
    error = fails(card.read)
    assert error.fault is DeviceFault.CORRUPT
    assert "PXI1Slot2/ctr0 reads nan" in str(error)


def test_what_the_card_shows_is_passed_on(card, harness, misbehaviour):
    harness.set("legs.extension", (0.1, 0.2, 0.0, 0.0))
    harness.set("legs.limits", (1.0,) + (0.0,) * 11)
    card.read()
    misbehaviour.begin("wrong", time.monotonic())
    measured = card.read()
    assert measured["extension"] == pytest.approx((-0.1, -0.2, 0.0, 0.0))
    assert measured["limits"] == (0.0,) + (1.0,) * 11
    misbehaviour.begin("garbage", time.monotonic())
    shown = {card.read()["extension"] for _ in range(3)}
    assert len(shown) == 3
    misbehaviour.end()
    assert card.read()["extension"] == pytest.approx((0.1, 0.2, 0.0, 0.0))


def test_intermittent_server_delays_but_does_not_fail(server, misbehaviour):
    # Off and on for 0.1 s each: whoever has more time than that gets an answer.
    with device(server, timeout_ms=5000.0) as card:
        begin = time.monotonic()
        misbehaviour.begin("intermittent", begin)
        card.read()
        assert time.monotonic() - begin > 0.05


def test_no_proxy_of_the_environment_comes_between_program_and_card(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        for name in ("http_proxy", "https_proxy", "grpc_proxy"):
            monkeypatch.setenv(name, f"http://127.0.0.1:{proxy.getsockname()[1]}")
        for name in ("no_proxy", "NO_PROXY", "no_grpc_proxy"):
            monkeypatch.delenv(name, raising=False)
        settings = NiDaqSettings(target="127.0.0.1:1", extension_file="", timeout_ms=100.0)
        with monkeypatch.context() as patience:
            patience.setattr(ni_card, "CONFIGURE_TIMEOUT", 0.5)
            assert fails(NiDaq(settings).configure).fault is DeviceFault.UNPLUGGED
        proxy.setblocking(False)
        with pytest.raises(BlockingIOError):
            proxy.accept()


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        (DAQmxErrors.PAL_TRANSFER_ABORTED, DeviceFault.UNPLUGGED),
        (DAQmxErrors.DEV_ABSENT_OR_UNAVAILABLE, DeviceFault.UNPLUGGED),
        (DAQmxErrors.DEV_CANNOT_BE_ACCESSED, DeviceFault.UNPLUGGED),
        (DAQmxErrors.OPERATION_TIMED_OUT, DeviceFault.SILENT),
        (DAQmxErrors.INVALID_ATTRIBUTE_VALUE, DeviceFault.FAILED),
    ],
    ids=lambda value: value.name,
)
def test_an_error_of_the_library_is_the_fault_that_its_name_says(monkeypatch, code, fault):
    tasks = NiTasks(NiDaqSettings(), "card")

    def identify():
        raise DaqError(f"the library says {code.name}", code.value)

    monkeypatch.setattr(tasks, "_identify", identify)
    with (
        pytest.raises(DeviceError, match=f"card.*{code.name}") as caught,
        tasks.opening(PATIENCE),
    ):
        pass
    assert caught.value.fault is fault
