"""Messages of a part and what an inbox makes of them: order, doubles, senders, clocks, names."""

import math

import pytest

from parapod.systems.hardware.buses.bus import Inbox
from parapod.systems.hardware.buses.message import Layout, Message, Signal, WrongMessage, is_active
from parapod.systems.hardware.device import DeviceFault

LAYOUT = Layout({"position": Signal(2), "brake": Signal(1)})
PERIOD = 0.01


def message(stamp, position=(1.0, 2.0), names=LAYOUT.names):
    return Message(names, [*position, 0.0], stamp)


def inbox(rate=1.0 / PERIOD):
    return Inbox("LEGS_STATUS", LAYOUT, rate, timeout=0.1)


def test_signals_are_what_was_packed():
    signals = {"position": (0.5, -1.5), "brake": (1.0,)}
    assert LAYOUT.names == ("position[0]", "position[1]", "brake")
    assert LAYOUT.unpack(Message(LAYOUT.names, LAYOUT.pack(signals), 1.0)) == signals


def test_names_may_come_in_another_order_and_with_others():
    names = ("brake", "colour", "position[1]", "position[0]")
    assert LAYOUT.unpack(Message(names, (1.0, 7.0, 2.0, 3.0), 1.0)) == {
        "position": (3.0, 2.0),
        "brake": (1.0,),
    }


@pytest.mark.parametrize(
    ("names", "values", "words"),
    [
        (
            ("position[0]", "brake"),
            (1.0, 0.0),
            r"lacks position\[1\]; it has position\[0\], brake",
        ),
        ((), (), r"lacks position\[0\], position\[1\], brake; it has nothing"),
        (LAYOUT.names, (1.0, 2.0), "has 3 names for 2 values"),
        (LAYOUT.names, (1.0, math.nan, 0.0), r"has nan for position\[1\]"),
        (LAYOUT.names, (1.0, 2.0, math.inf), "has inf for brake"),
    ],
)
def test_messages_that_do_not_fit_are_named(names, values, words):
    with pytest.raises(WrongMessage, match=words):
        LAYOUT.unpack(Message(names, values, 1.0))


def test_a_sender_is_active_unless_it_says_otherwise():
    assert is_active(message(1.0))
    assert is_active(Message(("active",), (1.0,), 1.0))
    assert not is_active(Message(("active",), (0.0,), 1.0))


def test_messages_that_come_twice_or_late_are_ignored_and_counted():
    box = inbox()
    for stamp in (1.0, 1.01, 1.01, 1.0, 1.02):
        box.take(message(stamp, (stamp, 0.0)), 100.0 + stamp)
    assert box.ignored == [1, 1]
    assert box.newest.message.stamp == 1.02
    assert box.problem(101.05) is None


def test_a_channel_is_silent_before_the_first_message_and_after_the_last():
    box = inbox()
    assert box.problem(0.0) == (DeviceFault.SILENT, "no message on LEGS_STATUS yet")
    box.take(message(1.0), 5.0)
    assert box.problem(5.09) is None
    assert box.problem(5.2) == (DeviceFault.SILENT, "no message on LEGS_STATUS for 0.2 s")


def test_a_wrong_message_is_a_fault_for_as_long_as_one_may_be_late():
    box = inbox()
    box.take(message(1.0), 5.0)
    box.take(Message(("position[0]",), (0.0,), 1.01), 5.01)
    fault, words = box.problem(5.05)
    assert fault is DeviceFault.CORRUPT
    assert words.startswith("LEGS_STATUS: lacks position[1], brake")
    # The one before still is the newest that fits.
    assert box.newest.message.stamp == 1.0
    box.take(message(1.1), 5.12)
    assert box.problem(5.12) is None


@pytest.mark.parametrize("by", [-3.0, 20.0])
def test_a_clock_that_jumps_is_a_fault_and_then_the_new_time(by):
    box = inbox()
    for k in range(5):
        box.take(message(10.0 + PERIOD * k), PERIOD * k)
    box.take(message(10.0 + by), 0.05)
    assert f"the sender's clock has jumped by {by - 0.04:+.3g} s" in box.problem(0.05).words
    for k in range(1, 15):
        box.take(message(10.0 + by + PERIOD * k), 0.05 + PERIOD * k)
    assert box.problem(0.19) is None


@pytest.mark.parametrize("kind", ["one time", "two clocks", "often"])
def test_two_senders_on_a_channel_are_told(kind):
    box = inbox(1.0 / PERIOD if kind == "often" else math.inf)
    for k in range(50):
        now = PERIOD * k
        if kind == "one time":  # both answer the same measurement, by other commands
            box.take(message(1.0 + now, (0.0, 1.0)), now)
            box.take(message(1.0 + now, (0.0, 2.0)), now)
        elif kind == "two clocks":
            box.take(message(1.0 + now), now)
            box.take(message(1.0 + now - 0.035), now)
        else:
            box.take(message(1.0 + now), now)
            box.take(message(1.0 + now + 0.5 * PERIOD), now + 0.5 * PERIOD)
    assert "as of two senders" in box.problem(now).words


def test_one_sender_as_fast_as_it_may_be_is_well():
    box = inbox()
    for k in range(500):
        box.take(message(1.0 + PERIOD * k), PERIOD * k + 0.002 * (k % 3))
        assert box.problem(PERIOD * k + 0.005) is None


def test_a_sender_without_a_clock_is_taken_as_it_comes():
    box = inbox()
    for k in range(5):
        box.take(message(0.0, (float(k), 0.0)), PERIOD * k)
    assert box.newest.signals["position"] == (4.0, 0.0)
    assert box.problem(0.04) is None


def test_the_interval_is_the_mean_of_the_last_half_second_and_each_newer_message_is_told():
    box, told = inbox(), []
    box.on_taken = lambda: told.append(box.newest.message.stamp)
    assert math.isinf(box.interval)
    for k in range(100):
        box.take(message(1.0 + k * PERIOD), 50.0 + k * PERIOD)
    assert box.interval == pytest.approx(PERIOD)
    for k in range(60):
        box.take(message(2.0 + 0.5 * k * PERIOD), 51.0 + k * 2 * PERIOD)
    assert box.interval == pytest.approx(2 * PERIOD)
    assert len(told) == 160
    box.take(message(1.5), 53.0)
    assert len(told) == 160
