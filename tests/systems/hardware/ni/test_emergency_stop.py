import math
import time

import pytest

from parapod.systems.hardware.device import DeviceError
from parapod.systems.hardware.emulation.harness import Harness
from parapod.systems.hardware.io import DeviceThread
from parapod.systems.hardware.ni.card import NiDaq
from parapod.systems.hardware.ni.settings import NiDaqSettings
from parapod.systems.hardware.ni.terminals import LegWiring

MOVING = (6.0, -6.0, 3.0, 1.0)
OFF = ((0.0,) * 4, (1.0,))


def device(server, **settings):
    patient = {"watchdog_ms": 10000.0, "timeout_ms": 1000.0}  # nothing here is judged by it
    settings = {"extension_file": ""} | patient | settings
    return NiDaq(NiDaqSettings(target=server.target, **settings))


@pytest.fixture
def card(server):
    """A device that is configured and active."""
    with device(server) as card:
        card.activate()
        yield card


@pytest.fixture
def press(harness):
    """press(is_pressed) moves the button."""
    return lambda is_pressed=True: harness.set("legs.emergency_stop", (float(is_pressed),))


@pytest.fixture
def drives(harness):
    """drives() gives the voltages at the actuators, and whether they have no supply."""
    return lambda: (harness.get("legs.voltage"), harness.get("legs.stop"))


def drive(card, stop=0.0):
    card.write({"voltage": MOVING, "stop": (stop,)})


def shown(card):
    (value,) = card.read()["emergency_stop"]
    return value


def moves(drives):
    voltage, stop = drives()
    return voltage == pytest.approx(MOVING) and stop == (0.0,)


def test_button_is_measured_with_the_limit_switches_in_one_call(card, server, press, harness):
    assert card.measures["emergency_stop"] == 1
    harness.set("legs.limits", (0.0,) * 11 + (1.0,))
    for is_pressed in (False, True):
        press(is_pressed)
        server.calls.clear()
        measured = card.read()
        assert measured["emergency_stop"] == (float(is_pressed),)
        assert measured["limits"] == (0.0,) * 11 + (1.0,)
        assert server.calls["ReadDigitalLines"] == 1


def test_broken_wire_counts_as_pressed(serve, drives):
    server = serve(stop_line="")
    with device(server) as card:
        card.activate()
        drive(card)
        assert shown(card) == 1.0
        assert drives() == OFF
        (remark,) = card.remarks
        assert "PXI1Slot2/port0/line13 is low" in remark
        assert 'stop_input: ""' in remark


def test_without_a_line_there_is_no_such_signal_and_none_is_obeyed(serve, drives):
    server = serve(stop_line="")
    with device(server, stop_input="") as card:
        assert "emergency_stop" not in card.measures
        card.activate()
        assert "emergency_stop" not in card.read()
        drive(card)
        assert moves(drives)
        assert card.remarks == []


def test_reading_opens_the_relay_though_nothing_is_commanded(card, server, press):
    drive(card)
    press()
    card.read()
    assert not server.wiring.is_relay_closed
    assert server.wiring.outputs == (2.5,) * 4


def test_drives_lose_their_supply_with_the_button_and_not_with_the_program(
    card, server, press, drives, until
):
    drive(card)
    assert moves(drives)
    press()
    assert until(lambda: drives() == OFF)  # without a call
    assert server.wiring.is_relay_closed
    press(False)
    assert until(lambda: moves(drives))


def test_pressed_stop_is_obeyed_whatever_is_commanded(card, server, press):
    press()
    card.read()
    server.calls.clear()
    for _ in range(3):
        drive(card)
        card.read()
        assert server.wiring.outputs == (2.5,) * 4
        assert not server.wiring.is_relay_closed
    # It is known to be open, and not opened again.
    assert server.calls["WriteDigitalLines"] == 0


def test_released_stop_moves_nothing_until_a_stop_is_commanded(card, server, press, drives):
    drive(card)
    press()
    card.read()
    press(False)
    for stop in (0.0, 0.0, math.nan, 0.5):
        assert shown(card) == 1.0  # as latched
        drive(card, stop)
        assert not server.wiring.is_relay_closed
        assert drives() == OFF
    drive(card, 1.0)
    assert not server.wiring.is_relay_closed
    assert shown(card) == 0.0
    drive(card)
    assert moves(drives)


def test_stop_that_is_commanded_while_it_is_pressed_releases_nothing(card, press, drives):
    press()
    card.read()
    drive(card, 1.0)
    press(False)
    card.read()
    drive(card)
    assert drives() == OFF


def test_short_press_between_two_commands_is_latched(card, press, drives):
    drive(card)
    press()
    card.read()
    press(False)
    card.read()
    drive(card)
    assert drives() == OFF
    assert shown(card) == 1.0


def test_another_activation_ends_the_latch(card, press, drives):
    press()
    card.read()
    press(False)
    card.deactivate()
    assert shown(card) == 0.0
    card.activate()
    drive(card)
    assert moves(drives)


def test_activation_while_it_is_pressed_closes_no_relay_then_or_later(server, press, drives):
    press()
    with device(server) as card:
        card.activate()
        assert not server.wiring.is_relay_closed
        assert "the emergency stop is pressed" in card.remarks[-1]
        press(False)
        card.read()
        drive(card)
        assert drives() == OFF
        drive(card, 1.0)
        drive(card)
        assert moves(drives)


def test_program_that_hangs_does_not_drive_on_after_the_release(server, press, drives, until):
    with device(server) as card:
        thread = DeviceThread(card)
        thread.start()
        try:
            thread.post({"voltage": MOVING, "stop": (0.0,)}, time.monotonic())
            assert until(lambda: moves(drives))
            press()
            assert until(lambda: not server.wiring.is_relay_closed)
            press(False)
            # It wakes up again and commands what it did before.
            end = time.monotonic() + 0.2
            while time.monotonic() < end:
                thread.post({"voltage": MOVING, "stop": (0.0,)}, time.monotonic())
                time.sleep(5e-3)
                assert drives() == OFF
            assert thread.sample.values["emergency_stop"] == (1.0,)
        finally:
            thread.stop()


def test_relay_that_could_not_be_opened_is_opened_at_the_next_reading(
    card, server, press, monkeypatch
):
    drive(card)
    press()
    write = card._tasks.write_relay
    with monkeypatch.context() as broken:
        broken.setattr(card._tasks, "write_relay", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            card.read()
    assert card._tasks.write_relay == write
    assert server.wiring.is_relay_closed
    card.read()
    assert not server.wiring.is_relay_closed


@pytest.mark.parametrize("kind", ["stuck", "slow", "delayed"])
def test_card_that_shows_old_inputs_shows_an_old_button(card, press, misbehaviour, kind):
    card.read()
    time.sleep(0.15)
    card.read()
    misbehaviour.begin(kind, time.monotonic())
    card.read()
    press()
    assert shown(card) == 0.0
    misbehaviour.end()
    assert shown(card) == 1.0


def test_garbage_on_the_line_is_a_stop(card, server, misbehaviour):
    drive(card)
    misbehaviour.begin("garbage", time.monotonic())
    for _ in range(20):
        card.read()
    assert not server.wiring.is_relay_closed
    misbehaviour.end()
    assert shown(card) == 1.0


def test_swapped_wires_of_encoders_are_none_of_the_button(card, press, misbehaviour):
    misbehaviour.begin("wrong", time.monotonic())
    assert shown(card) == 0.0
    press()
    assert shown(card) == 1.0


def test_machine_without_a_button_is_never_stopped(misbehaviour):
    sizes = {"voltage": 4, "stop": 1, "extension": 4, "limits": 12}
    wiring = LegWiring(Harness({f"legs.{name}": n for name, n in sizes.items()}), misbehaviour)
    assert wiring.measure()[1]["port0/line13"]


def test_reading_that_fails_is_no_stop(card, server, misbehaviour, drives):
    drive(card)
    misbehaviour.begin("unplugged", time.monotonic())
    with pytest.raises(DeviceError):
        card.read()
    assert moves(drives)
