import importlib
import math
import random
import tempfile
import time
from contextlib import nullcontext

import pytest

from parapod.systems.core.errors import MissingExtra
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.ni.card import NiDaq, NiDaqParams
from parapod.systems.hardware.ni.emulator import NiServer

COUNT = 1e-5
TIMEOUT = 0.2
# What a busy computer may add to a timeout [s].
MARGIN = 0.3


@pytest.fixture
def harness():
    return Harness({"legs.voltage": 4, "legs.stop": 1, "legs.extension": 4, "legs.limits": 12})


@pytest.fixture
def misbehaviour():
    return Misbehaviour()


@pytest.fixture
def serve(harness, misbehaviour):
    """serve(**arguments) gives a server that listens until the test is over."""
    servers = []
    # The path of a Unix socket is short.
    with tempfile.TemporaryDirectory(prefix="ni") as folder:

        def start(**arguments):
            server = NiServer(f"{folder}/socket", harness, misbehaviour, **arguments)
            servers.append(server)
            return server.__enter__()

        yield start
        for server in servers:
            server.__exit__(None, None, None)


@pytest.fixture
def server(serve):
    return serve()


def device(server, **settings):
    return NiDaq(NiDaqParams(target=server.target, timeout=TIMEOUT, **settings))


@pytest.fixture
def card(server):
    """A device that is configured and active."""
    with device(server) as card:
        card.activate()
        yield card


def drive(card, voltage=(0.0,) * 4, stop=0.0):
    card.write({"voltage": voltage, "stop": (stop,)})


def fails(call, *arguments):
    """The error that a call raises, and how long that takes [s]."""
    begin = time.monotonic()
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value, time.monotonic() - begin


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


def test_voltages_that_are_not_finite_are_neutral(card, server):
    drive(card, (12.0,) * 4)
    drive(card, (math.nan, math.inf, -math.inf, 6.0))
    assert server.wiring.outputs == pytest.approx((2.5, 2.5, 2.5, 3.75))


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
    with device(server, extension_at_start=start) as card:
        for step in range(0, 40, 4):
            moved = [value + direction * COUNT * step for value in start]
            harness.set("legs.extension", moved)
            measured = card.read()
            assert measured["extension"] == pytest.approx(moved, abs=1e-9)
            assert all(abs(value) < 1.0 for value in measured["velocity"])


def test_a_reference_tells_what_the_counts_mean(card, harness):
    harness.set("legs.extension", (0.2, 0.2, 0.2, 0.2))
    card.set_reference((0.01, 0.02, 0.03, 0.04))
    assert card.is_referenced
    assert card.read()["extension"] == pytest.approx((0.01, 0.02, 0.03, 0.04))
    harness.set("legs.extension", (0.25, 0.2, 0.2, 0.1))
    assert card.read()["extension"] == pytest.approx((0.06, 0.02, 0.03, -0.06))


@pytest.mark.parametrize("values", [(0.0,) * 3, (0.0, 0.0, 0.0, math.nan)])
def test_references_that_are_none_are_refused(card, values):
    with pytest.raises(ValueError, match="4 finite extensions"):
        card.set_reference(values)
    assert not card.is_referenced


def test_reference_is_lost_with_the_connection(server, harness):
    card = device(server)
    with card:
        card.set_reference((0.3,) * 4)
    harness.set("legs.extension", (0.1,) * 4)
    with card:
        assert not card.is_referenced
        assert card.read()["extension"] == (0.0,) * 4


def test_signals_are_those_announced(card):
    measured = card.read()
    assert {name: len(values) for name, values in measured.items()} == card.measures
    assert card.commands == {"voltage": 4, "stop": 1}


def channels(name):
    """Settings with all channels on a card of that name."""
    return {
        "outputs": f"{name}/ao0:3",
        "counters": tuple(f"{name}/ctr{index}" for index in range(4)),
        "inputs": f"{name}/port0/line0:11",
        "relay": f"{name}/port0/line12",
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
            {"counters": tuple(f"{CARD}/ctr{index}" for index in range(1, 5))},
            ("ctr4", "-200170"),
        ),
        ({"counters": (f"{CARD}/ctr0",) * 4}, ("reserved", "-50103")),
        ({"inputs": f"{CARD}/port0/line30:33"}, ("port0/line32", "-200170")),
        ({"inputs": f"{CARD}/port3/line0"}, ("port3/line0", "-200170")),
        ({"relay": f"{CARD}/port0/line0"}, ("reserved", "-200587")),
        ({"output_max": 12.0}, ("12.0", "-200077")),
    ],
)
def test_wrong_settings_are_refused_and_energise_nothing(server, harness, settings, texts):
    card = device(server, **settings)
    error, _ = fails(card.configure)
    for text in texts:
        assert text in str(error)
    assert server.wiring.outputs == (0.0,) * 4
    assert not server.wiring.is_relay_closed
    assert harness.get("legs.voltage") == (0.0,) * 4
    assert server.card.tasks == ()
    assert not server.calls["WriteAnalogF64"] + server.calls["WriteDigitalLines"]
    assert fails(card.read)[0].fault is DeviceFault.UNPLUGGED


def test_card_is_identified_before_anything_is_made(serve):
    server = serve(product="PXIe-6345")
    error, _ = fails(device(server).configure)
    assert error.fault is DeviceFault.CORRUPT
    assert not server.calls["CreateTask"]


def test_server_that_is_not_there_is_named():
    card = NiDaq(NiDaqParams(target="unix:/nowhere/socket"))
    error, duration = fails(card.configure)
    assert error.fault is DeviceFault.UNPLUGGED
    assert "no NI gRPC Device Server can be reached at unix:/nowhere/socket" in str(error)
    assert duration < 2.0


def test_local_driver_that_is_not_there_is_an_error_of_the_device():
    # Without NI-DAQmx because of that, with it because of the name.
    error, _ = fails(NiDaq(NiDaqParams(**channels("NoSuchCard"))).configure)
    assert "NoSuchCard" in error.device


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"outputs": "ao0:3"}, "does not name channels"),
        ({"inputs": ""}, "does not name channels"),
        ({"outputs": "Other/ao0:3"}, "of 2 cards"),
        ({"outputs": f"{CARD}/ao0:2"}, "3 outputs needs one counter"),
        ({"extension_at_start": (0.1,)}, "extension_at_start"),
        ({"extension_at_start": (0.1, 0.1, 0.1, math.nan)}, "extension_at_start"),
        ({"metres_per_count": 0.0}, "metres_per_count"),
        ({"supply_voltage": math.nan}, "supply_voltage"),
        ({"timeout": -1.0}, "timeout"),
        ({"neutral": 6.0}, "neutral"),
    ],
)
def test_senseless_settings_are_refused(settings, text):
    with pytest.raises(ValueError, match=text):
        NiDaqParams(**settings)


@pytest.mark.parametrize("module", ["nidaqmx", "grpc"])
def test_library_that_is_not_installed_is_named(monkeypatch, module):
    real = importlib.import_module

    def without(name, *arguments):
        if name.partition(".")[0] == module:
            raise ImportError(f"No module named {module!r}")
        return real(name, *arguments)

    monkeypatch.setattr(importlib, "import_module", without)
    with pytest.raises(MissingExtra, match=r"parapod\[ni\]"):
        NiDaq(NiDaqParams(target="unix:/nowhere")).configure()


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


@pytest.mark.parametrize("is_error", [False, True])
def test_outputs_are_neutral_after_every_exit(server, harness, is_error):
    card = device(server)

    def work():
        with card:
            card.activate()
            drive(card, (12.0,) * 4)
            assert harness.get("legs.voltage") == (12.0,) * 4
            if is_error:
                raise KeyError("a bug")

    with pytest.raises(KeyError) if is_error else nullcontext():
        work()
    assert server.wiring.outputs == (2.5,) * 4
    assert not server.wiring.is_relay_closed
    assert server.card.tasks == ()
    card.close()
    assert fails(drive, card)[0].fault is DeviceFault.UNPLUGGED


def test_cycle_needs_few_calls_and_asks_nothing_twice(card, server):
    drive(card)
    server.calls.clear()
    for _ in range(10):
        card.read()
        drive(card, (1.0,) * 4)
    # Four counters, the inputs, the outputs.
    assert server.calls.total() == 60


def test_stalled_server_is_told_in_time_and_recovers(card, misbehaviour):
    misbehaviour.begin("off", time.monotonic())
    for call in (card.read, lambda: drive(card, (3.0,) * 4), card.neutral):
        error, duration = fails(call)
        assert error.fault is DeviceFault.SILENT
        assert "did not answer within 0.2 s" in str(error)
        assert duration < TIMEOUT + MARGIN
    misbehaviour.end()
    card.read()
    drive(card)


def test_command_that_was_given_up_is_not_carried_out_later(card, misbehaviour, server):
    misbehaviour.begin("off", time.monotonic())
    fails(drive, card, (12.0,) * 4)
    time.sleep(0.02)
    misbehaviour.end()
    time.sleep(0.02)
    assert server.wiring.outputs == (2.5,) * 4


def test_relay_is_written_again_after_a_write_that_failed(card, misbehaviour, server):
    misbehaviour.begin("off", time.monotonic())
    fails(drive, card, (0.0,) * 4, 1.0)
    misbehaviour.end()
    assert server.wiring.is_relay_closed
    drive(card, stop=1.0)
    assert not server.wiring.is_relay_closed


def test_stalled_server_delays_configure_and_close_no_longer_than_their_time(server, misbehaviour):
    card = device(server, configure_timeout=0.3)
    misbehaviour.begin("off", time.monotonic())
    error, duration = fails(card.configure)
    assert error.fault is DeviceFault.SILENT
    assert duration < 0.3 + TIMEOUT + MARGIN
    misbehaviour.end()
    card.configure()
    card.activate()
    misbehaviour.begin("off", time.monotonic())
    begin = time.monotonic()
    card.close()
    assert time.monotonic() - begin < TIMEOUT + MARGIN


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
    assert "-200088" in str(fails(dead.read)[0])
    dead.close()


def test_unplugged_server_is_told_and_the_outputs_hold(card, misbehaviour, server, harness):
    drive(card, (6.0,) * 4)
    misbehaviour.begin("unplugged", time.monotonic())
    for _ in range(3):
        error, duration = fails(card.read)
        assert error.fault is DeviceFault.UNPLUGGED
        assert duration < TIMEOUT + MARGIN
        time.sleep(0.01)
    assert harness.get("legs.voltage") == pytest.approx((6.0,) * 4)
    misbehaviour.end()
    deadline = time.monotonic() + 3.0
    while time.monotonic() < deadline:
        try:
            card.read()
            break
        except DeviceError:
            time.sleep(0.02)
    drive(card)
    assert server.wiring.outputs == (2.5,) * 4


def test_close_without_a_server_is_quiet(server, misbehaviour):
    card = device(server)
    card.configure()
    misbehaviour.begin("unplugged", time.monotonic())
    time.sleep(0.02)
    card.close()
    card.close()


def test_position_that_is_no_number_is_an_error(card, server, monkeypatch):
    monkeypatch.setattr(server.card, "ReadCounterScalarF64", lambda _: {"value": math.nan})
    error, _ = fails(card.read)
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
    misbehaviour.begin("stuck", time.monotonic())
    card.read()
    harness.set("legs.extension", (0.3,) * 4)
    assert card.read()["extension"] == pytest.approx((0.1, 0.2, 0.0, 0.0))
    misbehaviour.begin("garbage", time.monotonic())
    shown = {card.read()["extension"] for _ in range(3)}
    assert len(shown) == 3
    misbehaviour.end()
    assert card.read()["extension"] == pytest.approx((0.3,) * 4)


def test_intermittent_server_delays_but_does_not_fail(card, misbehaviour):
    misbehaviour.begin("intermittent", time.monotonic())
    begin = time.monotonic()
    card.read()
    assert time.monotonic() - begin > 0.05
