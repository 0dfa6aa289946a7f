"""Twelve screws on EPOS2 controllers: absolute positions, signs, currents, limits, failures."""

import dataclasses
import math
import random
import threading
import time
from collections import Counter

import numpy as np
import pytest

from parapod.systems.hardware.canopen import HEARTBEAT_BASE, SYNC_ID, Entry, mapping_of
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.emulated_drive import EmulatedMotor
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.hardware.cia402.set_up import process_data, reports, set_up_of
from parapod.systems.hardware.cia402.settings import ScrewSettings
from parapod.systems.hardware.cia402.states import DriveState
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.soft_limits import SoftLimits

AXES = 12
IDS = tuple(range(1, AXES + 1))
SIGNS = (1, -1, 1, 1, -1, -1) * 2
GEAR = 2.0 * math.pi * 5.0 / 5e-3  # five turns of the motor for 5 mm
COUNT = 5e-3 / (5.0 * 2000.0)
RPM = 5e-3 / 5.0 / 60.0  # velocity of a screw at 1 rpm of its motor
LOWER, UPPER, START = (0.574,) * AXES, (0.874,) * AXES, (0.7,) * AXES
LIMITS = SoftLimits(LOWER, UPPER, lead=0.15, deceleration=2.0)
SCREWS = {
    "node_ids": [*IDS],
    "lead_mm": 5.0,
    "reduction": 5.0,
    "signs": [*SIGNS],
    "max_velocity_rpm": 4800.0,
    "acceleration": 2.0,
    "quick_stop_deceleration": 4.0,
    "position_at_start": START,
    "position_file": "",
    "limits": None,
}
MOTOR = EmulatedMotor(gear=GEAR)


def legs(velocity, brake=0.0):
    return {"velocity_command": np.broadcast_to(velocity, AXES).tolist(), "brake": (brake,)}


@pytest.fixture
def make_screws(make_rig):
    """make_screws(**params): a rig of twelve screws, of which all stand at 0.7 m."""

    def make(emulated_signs=SIGNS, position=START[0], **params):
        return make_rig(
            SCREWS | params,
            ScrewSettings,
            part="legs",
            axes=AXES,
            position=position,
            node_ids=params.get("node_ids", IDS),
            motor=MOTOR,
            signs=emulated_signs,
            measures_current=True,
        )

    return make


@pytest.fixture
def screws(make_screws):
    with make_screws() as rig:
        yield rig


class Moving(threading.Thread):
    """The screws: they follow the drives with a lag of 40 ms, and remember how far they came."""

    def __init__(self, harness, position):
        super().__init__(daemon=True)
        self._harness, self._stopping = harness, threading.Event()
        self.position = np.full(AXES, position)
        self.velocity, self.late = np.zeros(AXES), 0.0
        self.lowest, self.highest = self.position.copy(), self.position.copy()

    def run(self):
        then = time.monotonic()
        while not self._stopping.wait(1e-3):
            now = time.monotonic()
            self.late = max(self.late, now - then)
            goal = np.array(self._harness.get("legs.velocity_command"))
            if self._harness.get("legs.brake")[0] > 0.5:
                goal = np.zeros(AXES)
            share = -math.expm1((then - now) / 0.04)
            self.velocity += share * (goal - self.velocity)
            self.position = self.position + self.velocity * (now - then)
            self.lowest = np.minimum(self.lowest, self.position)
            self.highest = np.maximum(self.highest, self.position)
            self._harness.set("legs.position", self.position.tolist())
            self._harness.set("legs.velocity", self.velocity.tolist())
            then = now

    def judge(self, is_within, longest):
        """Proves that the screws stay within, or skips where the machine was late.

        That is if it let more time pass than the limits' lead is meant for [s].
        """
        longest = max(longest, self.late)
        if longest > 0.05 and not is_within:
            pytest.skip(f"the machine let {longest:.3f} s pass without a command or a step")
        assert is_within, (self.lowest, self.highest)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._stopping.set()
        self.join()


def fault_of(call, *arguments):
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


def driven(rig, seconds, command, period=0.01):
    """Reads and writes as a controller does; the command is of the time.

    Returns the longest time between two commands [s].
    """
    begin = last = time.monotonic()
    longest = 0.0
    while (now := time.monotonic() - begin) < seconds:
        rig.drives.read()
        rig.drives.write(command(now))
        longest, last = max(longest, time.monotonic() - last), time.monotonic()
        time.sleep(max(0.0, begin + now + period - time.monotonic()))
    return longest


# --- signals


def test_current_is_measured_only_if_it_is_asked_for(make_screws):
    with make_screws(measures_current=False) as rig:
        rig.drives.configure()
        assert set(rig.drives.read()) == set(rig.drives.measures) == {"position", "velocity"}


@pytest.mark.parametrize("is_synchronous", [True, False])
def test_position_velocity_and_current_of_every_axis_arrive_with_their_sign(
    make_screws, is_synchronous
):
    with make_screws(is_synchronous=is_synchronous) as rig:
        rig.drives.configure()
        position = np.linspace(0.6, 0.85, AXES)
        velocity, current = np.linspace(-0.05, 0.06, AXES), np.linspace(3.0, -2.9, AXES)
        rig.harness.set("legs.position", position.tolist())
        rig.harness.set("legs.velocity", velocity.tolist())
        rig.harness.set("legs.current", current.tolist())
        shown = pytest.approx(position, abs=0.51 * COUNT)
        rig.wait(lambda: rig.drives.read()["position"] == shown)
        measured = rig.drives.read()
        assert measured["velocity"] == pytest.approx(velocity, abs=0.51 * RPM)
        assert measured["current"] == pytest.approx(current, abs=0.51e-3)


def test_a_sign_turns_command_position_velocity_and_current_round(make_screws):
    # The motors are all wired alike, and what is said of the axes with -1 is wrong.
    with make_screws(emulated_signs=()) as rig:
        rig.activate()
        rig.drives.write(legs(0.02))
        expected = pytest.approx(0.02 * np.array(SIGNS), abs=0.51 * RPM)
        rig.wait(lambda: rig.command == expected)
        rig.harness.set("legs.velocity", [0.02] * AXES)
        rig.harness.set("legs.current", [1.0] * AXES)
        rig.harness.set("legs.position", [0.71] * AXES)
        shown = pytest.approx(0.7 + 0.01 * np.array(SIGNS), abs=0.51 * COUNT)
        rig.wait(lambda: rig.drives.read()["position"] == shown)
        assert rig.drives.read()["current"] == pytest.approx(SIGNS, abs=1e-3)
        assert rig.drives.read()["velocity"] == pytest.approx(0.02 * np.array(SIGNS), abs=RPM)


def test_a_current_takes_two_bytes_of_the_frame_of_the_velocity():
    settings = ScrewSettings(node_ids=[*IDS], signs=[*SIGNS])
    values = dict([*set_up_of(settings), *mapping_of(process_data(settings, 3), 3)])
    assert values[Entry(0x1A01, 0, "<B")] == 2
    assert values[Entry(0x1A01, 1, "<I")] == 0x606C0020
    assert values[Entry(0x1A01, 2, "<I")] == 0x20270010
    assert [pdo.size for pdo in reports(settings, 3)] == [6, 6]


def test_axes_are_in_the_order_of_the_node_ids(make_screws):
    ids = [*IDS[::-1]]
    with make_screws(node_ids=ids) as rig:
        rig.activate()
        wanted = np.linspace(0.01, 0.04, AXES)
        rig.drives.write(legs(wanted))
        expected = pytest.approx(wanted, abs=0.51 * RPM)
        rig.wait(lambda: rig.command == expected)
        rig.nodes.disconnect(12)
        assert "node 12 does not answer" in str(fault_of(rig.drives.read))


# --- the reference


def test_positions_are_absolute_wherever_the_drives_were_switched_on(make_screws):
    # They count from zero there.
    with make_screws(position=0.123, position_at_start=START) as rig:
        rig.drives.configure()
        assert rig.drives.is_referenced
        assert rig.drives.read()["position"] == pytest.approx(START, abs=COUNT)
        rig.harness.set("legs.position", [0.133] * AXES)
        shown = pytest.approx([0.71] * AXES, abs=COUNT)
        rig.wait(lambda: rig.drives.read()["position"] == shown)


def test_a_reference_can_be_given_later_and_is_that_of_the_moment(make_screws):
    with make_screws(position_at_start=None) as rig:
        rig.drives.configure()
        assert not rig.drives.is_referenced
        assert rig.drives.read()["position"] == pytest.approx([0.0] * AXES, abs=COUNT)
        rig.harness.set("legs.position", [0.75] * AXES)
        counted = pytest.approx([0.05] * AXES, abs=COUNT)
        rig.wait(lambda: rig.drives.read()["position"] == counted)
        values = np.linspace(0.6, 0.8, AXES)
        rig.drives.set_reference(values)
        assert rig.drives.is_referenced
        assert rig.drives.read()["position"] == pytest.approx(values, abs=COUNT)


# --- limits


def test_with_limits_and_without_a_reference_nothing_gets_power(make_screws):
    with make_screws(limits=LIMITS, position_at_start=None) as rig:
        rig.drives.configure()
        assert "the positions are not known, and there are limits" in str(
            fault_of(rig.drives.activate)
        )
        assert set(rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}


def test_a_mad_controller_does_not_drive_any_screw_out_of_its_limits(make_screws, judge):
    chance = random.Random(1)
    start = 0.58

    def mad(now):
        # Mostly towards the near limit, as fast as can be said.
        choices = [-1e9, -0.08, -0.05, math.nan, 0.005, -math.inf]
        return legs([chance.choice(choices) for _ in IDS])

    with (
        make_screws(limits=LIMITS, position_at_start=(start,) * AXES, position=start) as rig,
        Moving(rig.harness, start) as moving,
    ):
        rig.activate()
        with judge() as judged:
            longest = driven(rig, 1.0, mad)
        is_within = moving.lowest.min() > LOWER[0] - 2.0 * COUNT
        moving.judge(is_within, max(longest, judged.late))
        # They came close, so that the limits were needed.
        assert moving.lowest.max() < LOWER[0] + 2e-3


def test_a_controller_that_hangs_does_not_drive_any_screw_out_of_its_limits(make_screws, judge):
    start = 0.868
    with (
        make_screws(limits=LIMITS, position_at_start=(start,) * AXES, position=start) as rig,
        Moving(rig.harness, start) as moving,
    ):
        rig.activate()
        rig.drives.write(legs(0.08))  # for ever
        with judge() as judged:
            rig.wait(lambda: moving.position.min() > UPPER[0] - 1e-4)
            rig.wait(lambda: max(map(abs, rig.command)) < 1e-3)
        moving.judge(moving.highest.max() < UPPER[0] + 2.0 * COUNT, judged.late)


def test_a_program_that_is_killed_leaves_every_screw_within_its_limits(make_screws, judge):
    # Who wants that gives the limits a lead of more than the timeout and the drives' lag.
    start, limits = 0.868, dataclasses.replace(LIMITS, lead=0.3)
    with (
        make_screws(
            limits=limits,
            position_at_start=(start,) * AXES,
            position=start,
            heartbeat_timeout=0.1,
        ) as rig,
        Moving(rig.harness, start) as moving,
    ):
        rig.activate()
        rig.drives.write(legs(0.08))
        rig.drives.read()
        with judge() as judged:
            rig.wait_alone(lambda: rig.is_braked)  # no call any more
            time.sleep(0.3)
        assert moving.highest.max() > start + 1e-3
        moving.judge(moving.highest.max() < UPPER[0], judged.late)


def test_from_outside_its_limits_a_screw_can_only_come_back(make_screws):
    start = 0.9
    with make_screws(limits=LIMITS, position_at_start=(start,) * AXES, position=start) as rig:
        rig.activate()
        driven(rig, 0.1, lambda _: legs(0.05))
        assert rig.command == (0.0,) * AXES
        driven(rig, 0.1, lambda _: legs(-0.05))
        assert rig.command == pytest.approx((-0.05,) * AXES, abs=RPM)


def test_limits_are_kept_before_the_first_reading_after_a_reference(make_screws):
    start = 0.874
    with make_screws(limits=LIMITS, position_at_start=(start,) * AXES, position=start) as rig:
        rig.drives.configure()
        rig.drives._measured = math.inf  # as if no time had passed
        rig.drives.activate()
        rig.drives.write(legs(0.05))
        assert rig.drives._targets() == [0] * AXES
        rig.drives.write(legs(-0.05))
        assert rig.drives._targets() == [-3000 * sign for sign in SIGNS]


def test_limits_leave_commands_in_the_middle_of_the_stroke_alone(make_screws, judge):
    with make_screws(limits=LIMITS) as rig:
        rig.activate()
        for velocity in (0.08, -0.08):
            with judge() as judged:
                longest = driven(rig, 0.15, lambda _, v=velocity: legs(v))
                commanded = rig.command
            expected = pytest.approx((velocity,) * AXES, abs=RPM)
            # Heartbeats came too late, or the limits counted with a way that was not gone.
            if commanded != expected and max(judged.late, longest) > 0.05:
                pytest.skip(f"late by {judged.late:.3f} s, no command for {longest:.3f} s")
            assert commanded == expected


# --- failures


def test_a_node_that_falls_silent_is_named_and_all_screws_stop(make_screws, judge):
    with make_screws(limits=LIMITS, heartbeat_timeout=0.3) as rig:
        rig.activate()
        driven(rig, 0.1, lambda _: legs(0.02))
        rig.drives._timing = rig.drives._timing._replace(timeout=0.02)
        rig.nodes.disconnect(7)

        def go_on():
            assert fault_of(rig.drives.read).fault is DeviceFault.SILENT
            rig.drives.write(legs(0.02))

        with judge() as judged:
            assert "node 7 does not answer SYNC" in str(fault_of(rig.drives.read))
            # Its position is not known any more, so nothing may move; it stops by itself.
            rig.wait(lambda: not any(v for i, v in enumerate(rig.command) if i != 6), go_on)
        judged.check(LIMITS.lead + 0.1)
        rig.wait(lambda: not any(rig.command), go_on)
        assert rig.nodes.states[6] is not DriveState.OPERATION_ENABLED
        assert DriveState.OPERATION_ENABLED in rig.nodes.states


def test_eleven_screws_stop_by_the_reading_that_tells_that_one_drive_drops(make_screws, judge):
    names = tuple(f"branch {leg}{branch}" for leg in range(1, 5) for branch in range(1, 4))
    with make_screws(limits=LIMITS, axis_names=names) as rig:
        rig.activate()
        driven(rig, 0.2, lambda _: legs(0.02))
        rig.nodes.trip(7, 0x2310)
        with judge() as judged:
            error = fault_of(rig.drives.read)
            rig.wait_alone(
                lambda: all(
                    state is DriveState.QUICK_STOP_ACTIVE
                    for i, state in enumerate(rig.nodes.states)
                    if i != 6
                )
            )
        assert str(error).endswith("node 7 (branch 31) is in fault: EMCY 0x2310 (overcurrent)")
        judged.check(0.05)  # 2 to 4 ms where the machine is not late
        rig.drives.write(legs(0.02))
        rig.wait_alone(lambda: not any(rig.command))


def test_a_cycle_sends_one_request_for_all_nodes_and_one_command_to_each(screws):
    screws.activate()
    send, sent = screws.drives._bus.send, Counter()

    def counted(can_id, data, remote=False):
        sent[can_id] += 1
        send(can_id, data, remote)

    screws.drives._bus.send = counted
    for _ in range(10):
        screws.drives.read()
        screws.drives.write(legs(0.0))
    own = {can_id: count for can_id, count in sent.items() if can_id < HEARTBEAT_BASE}
    assert own == dict.fromkeys(
        (SYNC_ID, *(objects.PROFILE_VELOCITY.target.base + node for node in IDS)), 10
    )


# The reference


def limit_of(rig, node=1):
    return rig.nodes.nodes[node - 1]._slave.get(EPOS2.current_limit)


def test_screws_that_look_for_their_ends_have_no_limits_and_little_force(make_screws, tmp_path):
    params = {"limits": LIMITS, "position_file": str(tmp_path / "p.json"), "homing_current_a": 0.4}
    with make_screws(**params) as rig:
        rig.drives.seek_reference()
        with rig.drives:
            assert limit_of(rig) == 400
            rig.drives.activate()  # although nobody knows the positions
            for _ in range(3):
                rig.drives.read()
                rig.drives.write(legs(-0.01))
                time.sleep(0.02)
            asked = rig.harness.get("legs.velocity_command")[0]
            assert asked == pytest.approx(-0.01, abs=1e-3)


def test_every_start_sets_the_largest_current_again(make_screws):
    with make_screws(current_limit_a=2.5) as rig, rig.drives:
        assert [limit_of(rig, node) for node in IDS] == [2500] * AXES


def test_a_motor_that_is_held_up_pushes_with_its_largest_current(make_screws):
    with make_screws(current_limit_a=2.5) as rig, rig.drives:
        rig.drives.activate()

        def pushes():
            rig.drives.write(legs(-0.01))  # nothing moves: the wires stay as they are
            return rig.drives.read()["current"]

        rig.wait(lambda: min(map(abs, pushes())) > 2.0)
        assert pushes() == pytest.approx([-2.5] * AXES)
