import time

import pytest
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError

from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ni import daqmx
from parapod.systems.hardware.ni.card import NiDaq
from parapod.systems.hardware.ni.session import WatchdogExpired
from parapod.systems.hardware.ni.settings import NiDaqSettings
from parapod.systems.hardware.ni.tasks import NiTasks

MOVING = (6.0, -6.0, 3.0, 1.0)
# Long enough for a busy computer that resets it, and short enough to wait for [s].
TIMEOUT = 0.5
WORDS = "without this program the card opens the relay within 0.5 s"


def device(server, **settings):
    defaults = {"extension_file": "", "watchdog_ms": 1e3 * TIMEOUT, "timeout_ms": 1000.0}
    settings = defaults | settings
    return NiDaq(NiDaqSettings(target=server.target, **settings))


@pytest.fixture
def card(server):
    """A device that is configured and active."""
    with device(server) as card:
        card.activate()
        yield card


def drive(card, stop=0.0):
    card.write({"voltage": MOVING, "stop": (stop,)})


@pytest.fixture
def left_alone(server, card, until):
    """left_alone() returns once nothing has reset the watchdog of a moving machine for long."""

    def leave():
        drive(card)
        assert server.wiring.is_relay_closed
        assert until(lambda: not server.wiring.is_relay_closed)

    return leave


def expired(card):
    """Reads and commands until the device has noticed; what it says."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        card.read()
        try:
            drive(card)
        except WatchdogExpired as error:
            return error
    raise AssertionError("nothing is said")


# What the card does


def test_relay_opens_when_nothing_reaches_the_card(card, server, harness, until, judge):
    with judge() as judged:
        drive(card)
        assert until(lambda: not server.wiring.is_relay_closed)
    # The emulated card looks every 2 ms.
    assert judged.took > TIMEOUT - 0.1
    assert harness.get("legs.voltage") == (0.0,) * 4
    assert harness.get("legs.stop") == (1.0,)
    # X Series cards have it for digital lines only.
    assert server.wiring.outputs != (2.5,) * 4
    judged.check(2.0 * TIMEOUT)


@pytest.mark.parametrize("calls", [("read",), ("write",), ("read", "write")])
def test_reads_and_writes_keep_it_from_expiring(card, server, calls, judge):
    with judge() as judged:
        drive(card)
        end, is_closed = time.monotonic() + 3.0 * TIMEOUT, True
        while time.monotonic() < end and is_closed:
            for call in calls:
                card.read() if call == "read" else drive(card)
            time.sleep(0.01)
            is_closed = server.wiring.is_relay_closed
    if not is_closed and judged.late > 0.5 * TIMEOUT:
        pytest.skip(f"the machine was late by {judged.late:.3f} s")
    assert is_closed


def test_loop_resets_it_at_most_once_a_cycle_and_asks_nothing_else(card, server):
    drive(card)
    server.calls.clear()
    for _ in range(60):
        card.read()
        drive(card)
        time.sleep(0.01)
    seen = server.calls.copy()
    # One in 45 ms of at least 0.6 s.
    assert 5 <= seen.pop("ControlWatchdogTask") <= 60
    assert seen.total() == 6 * 60


def test_locked_line_refuses_writes_until_it_is_cleared(card, server, left_alone):
    left_alone()
    card._tasks.begin(1.0)
    with pytest.raises(WatchdogExpired, match="-200678"):
        card._tasks.write_relay(True)
    assert not server.wiring.is_relay_closed


def test_watchdog_is_armed_while_the_device_is_active(server):
    assert not server.calls["CreateWatchdogTimerTaskEx"]
    with device(server) as card:
        assert card.watchdog == WORDS
        time.sleep(1.5 * TIMEOUT)
        card.activate()
        assert server.wiring.is_relay_closed
        card.deactivate()
        time.sleep(1.5 * TIMEOUT)
        card.activate()  # not expired meanwhile
        drive(card)
        assert server.wiring.is_relay_closed


# What the device does


def test_expiration_is_said_and_nothing_moves_until_a_stop_is_commanded(card, server, left_alone):
    left_alone()
    error = expired(card)
    assert error.fault is DeviceFault.FAILED
    assert "its watchdog has opened the relay" in str(error)
    assert "0.5 s" in str(error)
    for _ in range(3):
        card.read()  # what it measures is true
        with pytest.raises(WatchdogExpired):
            drive(card)
        assert server.wiring.outputs == (2.5,) * 4
        assert not server.wiring.is_relay_closed
    drive(card, 1.0)
    assert not server.wiring.is_relay_closed
    drive(card)
    assert server.wiring.is_relay_closed
    assert server.wiring.outputs != (2.5,) * 4


def test_reading_that_notices_makes_the_outputs_neutral(card, server, left_alone, until):
    left_alone()
    assert until(lambda: card.read() and server.wiring.outputs == (2.5,) * 4)


def test_watchdog_guards_again_after_a_stop(card, server, left_alone):
    left_alone()
    expired(card)
    drive(card, 1.0)
    left_alone()


def test_stop_that_comes_before_it_is_noticed_is_a_stop(card, server, left_alone):
    left_alone()
    drive(card, 1.0)
    assert not server.wiring.is_relay_closed
    assert server.wiring.outputs == (2.5,) * 4


@pytest.mark.parametrize("is_noticed", [False, True])
def test_another_activation_ends_the_expiration(card, server, left_alone, is_noticed):
    left_alone()
    if is_noticed:
        expired(card)
    card.deactivate()
    assert not server.wiring.is_relay_closed
    card.activate()
    drive(card)
    assert server.wiring.is_relay_closed


def test_relay_that_was_closed_stays_open_after_the_end(card, server, left_alone):
    left_alone()
    card.close()
    assert not server.wiring.is_relay_closed
    assert server.wiring.outputs == (2.5,) * 4


def test_device_that_cannot_stop_the_machine_leaves_it_to_the_card(
    server, card, misbehaviour, until
):
    drive(card)
    misbehaviour.begin("off", time.monotonic())
    with pytest.raises(DeviceError):
        card.deactivate()
    # It says what will happen, also when it is closed.
    assert card.watchdog == WORDS
    card.close()
    assert card.watchdog == WORDS
    misbehaviour.end()
    assert until(lambda: not server.wiring.is_relay_closed)


def test_watchdog_is_left_armed_if_only_the_relay_was_not_reached(
    server, card, monkeypatch, until
):
    drive(card)

    def refuse(_):
        raise DeviceError("card", "refuses")

    monkeypatch.setattr(card._tasks, "write_relay", refuse)
    card.close()
    assert server.wiring.is_relay_closed
    assert until(lambda: not server.wiring.is_relay_closed)


# The next program


def dead(server):
    """A device whose program was killed while the machine moved."""
    card = device(server)
    card.configure()
    card.activate()
    drive(card)
    return card


@pytest.mark.parametrize("watchdog_ms", [1e3 * TIMEOUT, 0.0])
def test_next_program_clears_what_has_expired_with_a_word(server, until, watchdog_ms):
    dead(server)
    assert until(lambda: not server.wiring.is_relay_closed)
    with device(server, watchdog_ms=watchdog_ms) as card:
        assert "the watchdog of an earlier program had opened the relay" in card.remarks[0]
        card.activate()
        drive(card)
        assert server.wiring.is_relay_closed
    with device(server) as card:
        assert card.remarks == []  # said once


def test_expiration_is_cleared_whose_task_is_gone(server, until):
    # As of a program without a server, whose tasks end with it.
    dead(server)
    assert until(lambda: not server.wiring.is_relay_closed)
    for name in server.card.tasks:
        del server.card._tasks[name]
    with device(server) as card:
        assert "it is cleared" in card.remarks[0]
        card.activate()
        assert server.wiring.is_relay_closed


def test_next_program_is_not_stopped_by_the_watchdog_of_the_one_before(server):
    dead(server)
    with device(server, watchdog_ms=0.0) as card:
        card.activate()
        drive(card)
        time.sleep(1.5 * TIMEOUT)
        assert server.wiring.is_relay_closed


# Cards that have none


@pytest.mark.parametrize("drives_motors", [True, False])
def test_card_without_a_watchdog_is_used_with_a_word(serve, drives_motors):
    server = serve(product="PXIe-6259")
    settings = NiDaqSettings(
        target=server.target, product="PXIe-6259", extension_file="", timeout_ms=5000.0
    )
    with NiDaq(settings, drives_motors) as card:
        assert card.watchdog == ""
        (remark,) = card.remarks
        assert remark.startswith("no watchdog of its own: ")
        assert "-200662" in remark
        card.activate()
        commands = {"voltage": MOVING, "stop": (0.0,)}
        card.write({name: commands[name] for name in card.commands})
        card.read()
        time.sleep(0.2)
        assert server.wiring.is_relay_closed


def test_line_that_the_card_refuses_at_the_start_of_the_timer_is_said(server, monkeypatch):
    start = server.card.StartTask

    def refuse(task):
        if task.name.endswith("watchdog"):
            raise daqmx.NiRefusal(-200077, Property="Watchdog")
        start(task)

    monkeypatch.setattr(server.card, "StartTask", refuse)
    with device(server) as card:
        assert card.watchdog == WORDS
        card.activate()
        assert card.watchdog == ""
        assert "no watchdog of its own: " in card.remarks[-1]
        drive(card)
        assert server.wiring.is_relay_closed


def test_server_that_knows_no_watchdogs_is_used_with_a_word(server):
    for name in list(server._handlers):
        if "Watchdog" in name:
            del server._handlers[name]
    with device(server) as card:
        card.activate()
        drive(card)
        assert server.wiring.is_relay_closed
        assert "no watchdog of its own: " in card.remarks[0]
        assert "Upgrade" in card.remarks[0]


def test_none_is_armed_if_none_is_asked_for(server):
    with device(server, watchdog_ms=0.0) as card:
        card.activate()
        drive(card)
        assert server.calls["CfgWatchdogDOExpirStates"] == 0
        assert card.watchdog == ""
        assert card.remarks == ["no watchdog of its own: watchdog_ms is 0"]


@pytest.mark.parametrize("watchdog_ms", [20.0, 34000.0])
def test_every_timeout_that_may_be_asked_for_is_in_the_cards_range(server, watchdog_ms):
    # (2^32 - 1) times 8 ns: X Series User Manual, "Watchdog Timer".
    assert pytest.approx(34.36, abs=0.01) == daqmx._LONGEST_WATCHDOG
    with device(server, watchdog_ms=watchdog_ms) as card:
        assert card.remarks == []
        assert card.watchdog.endswith(f"within {1e-3 * watchdog_ms:g} s")


@pytest.mark.parametrize(
    "code",
    [
        DAQmxErrors.CANT_RESET_EXPIRED_WATCHDOG,
        DAQmxErrors.WRITE_FAILED_BECAUSE_WATCHDOG_EXPIRED,
    ],
    ids=lambda code: code.name,
)
def test_library_says_by_these_numbers_that_it_has_expired(code):
    tasks = NiTasks(NiDaqSettings(target=""), "card")
    with pytest.raises(WatchdogExpired), tasks.told():
        raise DaqError("words", code.value)


def test_words_of_the_emulated_driver_have_the_numbers_of_the_library():
    names = {
        -200635: "ACTION_NOT_SUPPORTED_TASK_NOT_WATCHDOG",
        -200644: "CANT_RESET_EXPIRED_WATCHDOG",
        -200662: "WATCHDOG_TIMER_NOT_SUPPORTED",
        -200668: "WATCHDOG_TIMEOUT_OUT_OF_RANGE_AND_NOT_SPECIAL_VAL",
        -200678: "WRITE_FAILED_BECAUSE_WATCHDOG_EXPIRED",
        -200983: "CANNOT_GET_PROPERTY_WHEN_TASK_NOT_RESERVED_COMMITTED_OR_RUNNING",
    }
    assert {code: DAQmxErrors(code).name for code in names} == names
    assert names.keys() <= daqmx._TEXTS.keys()
