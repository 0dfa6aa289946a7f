"""A part on a bus: neutral without commands, obeying, latched after silence, given up."""

from parapod.systems.hardware.buses.address import LCM, Address
from parapod.systems.hardware.buses.message import Message, Signal
from parapod.systems.hardware.buses.served_part import ServedPart

NAMES = ("voltage[0]", "voltage[1]", "brake", "active")
NEUTRAL = {"voltage": (0.0, 0.0), "brake": (1.0,)}


class Wire:
    """A bus whose other end is the test."""

    address, stop = Address(LCM), ""

    def __init__(self):
        self.published, self.inboxes = [], []

    def advertise(self, channel, layout):
        pass

    def publish(self, channel, message):
        self.published.append((channel, message))

    def subscribe(self, inbox):
        self.inboxes.append(inbox)


def served():
    wire = Wire()
    commands = {"voltage": Signal(2), "brake": Signal(1, idle=1.0)}
    part = ServedPart("legs", wire, {"extension": Signal(2)}, commands)
    return part, wire.inboxes[0], wire


def order(inbox, at, active=1.0, names=NAMES):
    inbox.take(Message(names, (3.0, 4.0, 0.0, active)[: len(names)], at), at)


def test_a_status_has_what_is_measured_and_what_is_commanded():
    part, _, wire = served()
    part.publish({"extension": (0.4, 0.5), "voltage": (1.0, 2.0), "brake": (0.0,)}, 7.0)
    ((channel, message),) = wire.published
    assert channel == "LEGS_STATUS"
    names = ("extension[0]", "extension[1]", "voltage[0]", "voltage[1]", "brake")
    assert tuple(message.names) == names
    assert message.values == [0.4, 0.5, 1.0, 2.0, 0.0]
    assert message.stamp == 7.0


def test_a_part_is_neutral_until_it_is_commanded():
    part, inbox, _ = served()
    assert part.commands(1.0) == NEUTRAL
    assert part.is_neutral
    order(inbox, 2.0)
    assert part.commands(2.0) == {"voltage": (3.0, 4.0), "brake": (0.0,)}
    assert not part.is_neutral


def test_silence_makes_it_neutral_in_time_and_late_commands_do_not_count():
    part, inbox, _ = served()
    order(inbox, 2.0)
    part.commands(2.0)
    assert part.commands(2.09) != NEUTRAL
    assert part.commands(2.11) == NEUTRAL
    assert "no message on LEGS_COMMAND for 0.11 s" in part.latched.words
    # The same controller goes on as if nothing had been.
    for k in range(20):
        order(inbox, 2.2 + 0.01 * k)
        assert part.commands(2.2 + 0.01 * k) == NEUTRAL


def test_a_controller_that_gives_the_part_up_may_take_it_again():
    part, inbox, _ = served()
    order(inbox, 2.0)
    part.commands(2.0)
    part.commands(2.2)
    order(inbox, 2.3)
    assert part.commands(2.3) == NEUTRAL
    order(inbox, 2.31, active=0.0)
    assert part.commands(2.31) == NEUTRAL
    order(inbox, 2.32)
    assert part.commands(2.32) != NEUTRAL


def test_a_controller_that_begins_anew_after_a_second_may_take_it():
    part, inbox, _ = served()
    order(inbox, 2.0)
    part.commands(2.0)
    part.commands(2.2)
    assert part.commands(3.1) == NEUTRAL
    assert part.latched is None
    order(inbox, 3.2)
    assert part.commands(3.2) != NEUTRAL


def test_a_wrong_command_latches_it():
    part, inbox, _ = served()
    order(inbox, 2.0)
    part.commands(2.0)
    order(inbox, 2.01, names=NAMES[:2])
    assert part.commands(2.01) == NEUTRAL
    assert "LEGS_COMMAND: lacks brake" in part.latched.words


def test_parts_that_others_stop_are_neutral_until_they_let_go_and_the_controller_gives_up():
    part, inbox, wire = served()
    order(inbox, 2.0)
    part.commands(2.0)
    wire.stop = "/station/stop is true"
    order(inbox, 2.01)
    assert part.commands(2.01) == NEUTRAL
    assert part.latched.words == "/station/stop is true"
    wire.stop = ""
    order(inbox, 2.02)
    assert part.commands(2.02) == NEUTRAL
    order(inbox, 2.03, active=0.0)
    part.commands(2.03)
    order(inbox, 2.04)
    assert part.commands(2.04) != NEUTRAL
