"""Axes whose forces are commanded: what pushes them, and above all what no longer does."""

import json
import math
import random
import time

import pytest

from parapod.systems.hardware.canopen import Entry, mapping_of
from parapod.systems.hardware.cia402 import emulated_drive, objects
from parapod.systems.hardware.cia402.emulated_drive import EmulatedMotor
from parapod.systems.hardware.cia402.forces import ForceLimits
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.hardware.cia402.set_up import process_data, set_up_of
from parapod.systems.hardware.cia402.settings import Control, ForceSlideSettings, TorqueSettings
from parapod.systems.hardware.cia402.states import Controlword, DriveState
from parapod.systems.hardware.device import DeviceError, DeviceFault

SIGNS = (1, -1)
PER_CURRENT, LARGEST = 100.0, 400.0  # [N/A], [N]
FASTEST = 8000.0 / 60.0 * 5e-3  # of a slide with a lead of 5 mm [m/s]
MIDDLE, LOW, HIGH = 0.5, 0.4, 0.6  # [m]
RUNNING, STOPPED = {DriveState.OPERATION_ENABLED}, {DriveState.SWITCHED_ON}
SLIDES = {
    "node_ids": [1, 2],
    "signs": [*SIGNS],
    "position_min_mm": [1e3 * LOW] * 2,
    "position_max_mm": [1e3 * HIGH] * 2,
    "position_at_start_mm": [1e3 * MIDDLE] * 2,
    "position_file": "",
    "heartbeat_timeout": 20.0,
}


class Clock:
    """Time that passes when a test says so [s]."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


class Axes:
    """A rig of two axes, whose velocities and positions a test sets."""

    def __init__(self, rig, clock):
        self.rig, self.clock, self.drives = rig, clock, rig.drives
        self.signal = rig.settings.command_signal

    def set(self, signal, *values):
        """Sets what the axes measure, and waits until the nodes show it."""
        self.rig.harness.set(f"{self.rig.part}.{signal}", values)
        near = [pytest.approx(value, abs=2e-3) for value in values]
        shown = lambda: [getattr(node.measured, signal) for node in self.rig.nodes.nodes]  # noqa: E731
        self.rig.wait_alone(lambda: shown() == near)

    def write(self, *forces, brake=0.0):
        self.drives.write({self.signal: forces, "brake": (brake,)})

    def cycle(self, *forces, brake=0.0):
        """A period of a controller: reads, and writes."""
        self.clock.now += 0.01
        self.drives.read()
        self.write(*forces, brake=brake)

    def arrives(self, *forces, within=0.051):
        """Waits until forces are on the wires: in whole milliamperes, or thousandths of 4 A."""
        within = max(within, 0.0 if self.rig.settings.drive == "epos2" else 0.21)
        near = [pytest.approx(force, abs=within) for force in forces]
        self.rig.wait_alone(lambda: list(self.rig.command) == near)

    @property
    def settings(self):
        """Set values in the nodes [mA]."""
        torques = self.rig.nodes.nodes[0]._maker.rated_current is not None
        nodes = self.rig.nodes.nodes
        return [node._milliamperes(node._setting(Control.FORCE), torques) for node in nodes]


@pytest.fixture
def make(make_rig):
    """make(**changes): slides, or what else `kind` says, that are active."""
    opened = []

    def made(kind=ForceSlideSettings, is_active=True, **changes):
        clock = Clock()
        settings, gear = SLIDES, 2.0 * math.pi / 5e-3
        if kind is TorqueSettings:
            settings = {key: SLIDES[key] for key in ("node_ids", "signs", "heartbeat_timeout")}
            settings["gear"] = gear = 50.0
        rig = make_rig(
            settings | changes,
            kind,
            part="hip",
            axes=2,
            position=MIDDLE,
            clock=clock,
            node_ids=[1, 2],
            signs=SIGNS,
            motor=EmulatedMotor(gear=gear, force_per_current=PER_CURRENT),
            stop_contact=(2, 4),
            hold_up=60.0,
        )
        rig.__enter__()
        opened.append(rig)
        if is_active:
            rig.activate()
        return Axes(rig, clock)

    yield made
    for rig in opened:
        rig.harness.set("hip.velocity", (0.0, 0.0))  # lest an end waits for that: no time passes
        rig.__exit__()


@pytest.fixture
def axes(make, drive):
    return make(stop_node=2, drive=drive)


def fault_of(call, *arguments):
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


# --- forces that are allowed

LIMITS = ForceLimits((0.0,), (1.0,), lead=0.1, max_velocity=2.0, max_force=10.0)


@pytest.mark.parametrize(
    ("force", "position", "velocity", "allowed"),
    [
        (3.0, 0.5, 0.0, 3.0),
        (30.0, 0.5, 0.0, 10.0),
        (-30.0, 0.5, 0.0, -10.0),
        # At an end and beyond it: inwards only.
        (3.0, 1.0, 0.0, 0.0),
        (3.0, 1.2, -1.0, 0.0),
        (-3.0, 1.2, 0.0, -3.0),
        (-3.0, 0.0, 0.0, 0.0),
        (3.0, -0.2, 0.0, 3.0),
        # There within the lead, or not.
        (3.0, 0.9, 1.1, 0.0),
        (3.0, 0.9, 0.9, 3.0),
        (-3.0, 0.9, 1.1, -3.0),
        (-3.0, 0.1, -1.1, 0.0),
        (-3.0, 0.1, -0.9, -3.0),
        # Close to the largest velocity, at it, and beyond it: less and less in its direction.
        (4.0, 0.5, 1.8, 4.0),
        (4.0, 0.5, 1.9, 2.0),
        (4.0, 0.5, 2.0, 0.0),
        (4.0, 0.5, 3.0, 0.0),
        (-4.0, 0.5, 3.0, -4.0),
        (-4.0, 0.5, -1.9, -2.0),
        (-4.0, 0.5, -3.0, 0.0),
        (4.0, 0.5, -3.0, 4.0),
        # The largest force first: what is left of it near the largest velocity.
        (1e9, 0.5, 1.9, 5.0),
        *((bad, 0.5, 0.0, 0.0) for bad in (math.nan, math.inf, -math.inf)),
        (3.0, math.nan, 0.0, 0.0),
        (-3.0, 0.5, math.nan, 0.0),
    ],
)
def test_force_that_is_allowed(force, position, velocity, allowed):
    wide = ForceLimits((-9.0,), (9.0,), 0.1, 2.0, 10.0)  # a velocity of 3 m/s leads to no end
    limits = wide if position == 0.5 else LIMITS
    assert limits.allowed([force], [position], [velocity]) == pytest.approx([allowed])


# --- what is set up


def test_the_mode_its_set_value_and_the_largest_velocity_are_set_up():
    values = dict(
        [
            *set_up_of(ForceSlideSettings(max_velocity_rpm=4000, current_limit_a=4.5)),
            *mapping_of(
                process_data(ForceSlideSettings(max_velocity_rpm=4000, current_limit_a=4.5), 3), 3
            ),
        ]
    )
    assert values[objects.MODE] == -3
    assert values[Entry(0x2030, 0, "<h")] == 0
    assert values[Entry(0x6410, 4, "<I")] == 4000
    assert values[EPOS2.current_limit] == 4500
    assert values[Entry(0x1600, 0, "<B")] == 2
    assert values[Entry(0x1600, 1, "<I")] == 0x60400010
    assert values[Entry(0x1600, 2, "<I")] == 0x20300010
    assert values[Entry(0x1601, 1, "<I")] == 0x20300010
    assert not {objects.PROFILE_TYPE, objects.TARGET_VELOCITY, objects.ACCELERATION} & set(values)


def test_command_frame_is_controlword_and_milliamperes():
    assert EPOS2.modes[Control.FORCE][0].command.pack(0x0F, -1500) == bytes.fromhex("0F0024FA")


def test_force_that_the_current_does_not_make_is_refused(make):
    with pytest.raises(ValueError, match=r"is 400, but current_limit_a = 3\.5 allows 350"):
        make(current_limit_a=3.5)


def test_slides_have_no_ramp_of_a_quick_stop():
    assert not [name for name in vars(ForceSlideSettings()) if "quick" in name or "accel" in name]


# --- what arrives


def test_forces_arrive_with_their_signs_and_their_currents_are_measured(axes):
    axes.cycle(123.0, -50.0)
    axes.arrives(123.0, -50.0)
    assert axes.settings == pytest.approx([1230, 500], abs=2)
    assert axes.drives.read()["current"] == pytest.approx([1.23, -0.5], abs=2.1e-3)
    assert not axes.rig.is_braked


def test_torques_arrive_at_axes_that_turn(make):
    axes = make(TorqueSettings, torque_per_current_Nm_A=PER_CURRENT)
    assert axes.drives.commands == {"torque_command": 2, "brake": 1}
    axes.cycle(12.0, -7.5)
    axes.arrives(12.0, -7.5)
    axes.cycle(1e9, -1e9)
    axes.arrives(20.0, -20.0)


def test_no_command_exceeds_the_largest_force(axes):
    for wild in (1e9, 1e308, LARGEST + 1.0):
        axes.cycle(wild, -wild)
        axes.arrives(LARGEST, -LARGEST)
    for bad in (math.nan, math.inf, -math.inf):
        axes.cycle(bad, 20.0)
        axes.arrives(0.0, 20.0)


def test_neutral_takes_the_power_so_that_a_brake_closes(axes):
    """A controller that hangs must not drop what hangs on a slide."""
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.drives.neutral()
    axes.arrives(0.0, 0.0)
    axes.rig.wait_alone(lambda: set(axes.rig.nodes.states) == STOPPED)
    assert axes.rig.is_braked
    axes.drives.read()  # no fault: that is as it should be
    axes.cycle(20.0, 20.0)
    axes.arrives(20.0, 20.0)
    assert set(axes.rig.nodes.states) == RUNNING


def test_activation_gives_no_power_before_a_command_with_its_force(axes):
    assert set(axes.rig.nodes.states) == STOPPED
    assert axes.rig.is_braked
    for _ in range(10):
        axes.cycle(0.0, 0.0, brake=1.0)
    axes.drives.neutral()
    assert axes.rig.is_braked
    assert set(axes.rig.nodes.states) == STOPPED
    axes.cycle(100.0, 50.0)
    axes.arrives(100.0, 50.0)
    assert set(axes.rig.nodes.states) == RUNNING


def test_a_drive_that_gives_no_power_when_it_is_told_to_is_an_error(axes, monkeypatch):
    monkeypatch.setattr(emulated_drive, "obeyed", lambda state, *_: state)
    axes.cycle(100.0, 50.0)
    axes.cycle(100.0, 50.0)  # it may take a moment
    axes.clock.now += 0.06
    assert "has lost its power, it is in switched on" in str(fault_of(axes.drives.read))


# --- ends and largest velocity, also without a command


def test_an_axis_that_runs_away_is_not_pushed_any_further_by_a_controller_that_hangs(axes):
    axes.cycle(100.0, -100.0)
    axes.arrives(100.0, -100.0)
    for velocity, force in ((1.01 * FASTEST, 0.0), (0.95 * FASTEST, 50.0), (0.0, 100.0)):
        axes.set("position", MIDDLE, MIDDLE)
        axes.set("velocity", velocity, -velocity)
        axes.drives.read()
        axes.arrives(force, -force, within=0.3)
    axes.set("velocity", -1.5 * FASTEST, 1.5 * FASTEST)
    axes.drives.read()
    axes.arrives(100.0, -100.0)


def test_an_axis_that_runs_away_is_not_pushed_by_commands_either(axes):
    axes.set("velocity", 1.01 * FASTEST, -1.01 * FASTEST)
    axes.drives.read()
    for force in (50.0, 400.0, 1e9):
        axes.write(force, -force)
    axes.write(0.0, 30.0)
    axes.arrives(0.0, 30.0)
    axes.write(60.0, 30.0)
    axes.write(60.0, 40.0)  # a frame that tells that those before it have come
    axes.arrives(0.0, 40.0)


def test_an_axis_beyond_an_end_is_pushed_inwards_only(axes):
    axes.cycle(100.0, -100.0)
    axes.arrives(100.0, -100.0)
    axes.set("position", HIGH + 0.01, LOW - 0.01)
    axes.drives.read()  # a controller that hangs
    axes.arrives(0.0, 0.0)
    axes.write(-30.0, 30.0)
    axes.arrives(-30.0, 30.0)
    axes.write(30.0, -30.0)
    axes.arrives(0.0, 0.0)


def test_an_axis_on_its_way_out_is_not_pushed_on(make):
    axes = make(limit_lead_ms=100.0)
    axes.set("position", HIGH - 0.02, HIGH - 0.02)
    axes.set("velocity", 0.19, 0.21)
    axes.cycle(50.0, 50.0)
    axes.arrives(50.0, 0.0)


def test_whatever_is_commanded_nothing_pushes_outwards_nor_faster(axes):
    chance = random.Random(1)
    limits = axes.drives._limits
    for _ in range(2000):
        force = chance.choice([1e308, -1e308, math.nan, 50.0, -50.0])
        position, velocity = chance.uniform(0.35, 0.65), chance.uniform(-1.0, 1.0)
        f = limits.allowed([force] * 2, [position] * 2, [velocity] * 2)[0]
        assert abs(f) <= LARGEST
        assert f <= 0.0 or position < HIGH
        assert f >= 0.0 or position > LOW
        assert f * velocity <= 0.0 or abs(velocity) < FASTEST


def test_with_ends_and_without_a_reference_nothing_gets_power(make):
    axes = make(position_at_start_mm=None, is_active=False)
    axes.drives.configure()
    assert "the positions are not known, and there are limits" in str(
        fault_of(axes.drives.activate)
    )


def test_ends_of_axes_that_turn_are_angles(make):
    ends = {"position_min_deg": [-30.0, -30.0], "position_max_deg": [40.0, 40.0]}
    start = math.degrees(MIDDLE)
    axes = make(TorqueSettings, **ends, position_at_start_deg=[start] * 2)
    assert axes.drives.read()["position"] == pytest.approx([MIDDLE] * 2, abs=1e-3)
    limits = axes.drives._limits
    assert limits.lower == pytest.approx([math.radians(-30.0)] * 2)
    assert limits.upper == pytest.approx([math.radians(40.0)] * 2)


def test_one_end_alone_is_refused():
    with pytest.raises(ValueError, match="must be given both, or neither"):
        TorqueSettings(position_min_deg=[0.0]).strokes  # noqa: B018


def test_axes_that_look_for_their_ends_have_none_and_little_force(make, tmp_path):
    file = str(tmp_path / "p.json")
    unknown = {"position_at_start_mm": None, "position_file": file}
    axes = make(homing_current_a=0.3, is_active=False, **unknown)
    axes.drives.seek_reference()
    axes.rig.activate()  # although nobody knows the positions
    axes.set("position", HIGH + 0.1, MIDDLE)
    axes.cycle(100.0, -100.0)
    axes.arrives(30.0, -30.0)
    assert axes.settings == [300, 300]


# --- stops: no force, and nothing that holds


def test_brake_takes_the_force_away_and_its_release_gives_it_back(axes):
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.cycle(100.0, 100.0, brake=1.0)
    axes.rig.wait_alone(lambda: set(axes.rig.nodes.states) == STOPPED)
    assert axes.rig.command == (0.0, 0.0)
    assert axes.settings == [0, 0]
    assert axes.rig.is_braked
    axes.drives.read()  # which steers nothing
    axes.drives.neutral()
    assert set(axes.rig.nodes.states) == STOPPED
    assert axes.settings == [0, 0]
    axes.cycle(20.0, 20.0)
    axes.arrives(20.0, 20.0)


def test_nothing_is_pushed_by_itself_after_an_emergency_stop(axes):
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.rig.harness.set("hip.emergency_stop", (1.0,))
    axes.rig.wait(lambda: axes.drives.read()["emergency_stop"] == [1.0])
    axes.arrives(0.0, 0.0)
    axes.rig.harness.set("hip.emergency_stop", (0.0,))
    axes.rig.wait(lambda: axes.drives.read()["emergency_stop"] == [0.0])
    for _ in range(5):
        axes.cycle(100.0, 100.0)
    axes.rig.wait_alone(lambda: set(axes.rig.nodes.states) == STOPPED)
    assert axes.settings == [0, 0]
    axes.cycle(100.0, 100.0, brake=1.0)
    axes.cycle(20.0, 20.0)
    axes.arrives(20.0, 20.0)


def test_without_heartbeats_the_force_goes(make):
    axes = make(heartbeat_timeout=0.2)
    assert axes.drives.watchdog == (
        "without this computer's heartbeats the drives take their currents away within 0.7 s, "
        "and only mechanical brakes hold the axes"
    )
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.rig.wait_for(DriveState.FAULT)  # no call any more
    assert axes.rig.command == (0.0, 0.0)
    assert axes.rig.is_braked


def test_measurements_that_are_old_push_nothing(axes):
    axes.cycle(100.0, 100.0)
    axes.clock.now += 0.06
    axes.write(100.0, 100.0)
    axes.arrives(0.0, 0.0)
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)


def test_while_a_node_is_silent_no_axis_is_pushed(make):
    axes = make()
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.rig.nodes.disconnect(2)
    axes.drives._timing = axes.drives._timing._replace(timeout=0.02)  # of readings from here on
    for _ in range(7):
        axes.clock.now += 0.01
        assert fault_of(axes.drives.read).fault is DeviceFault.SILENT
    axes.rig.wait_alone(lambda: axes.rig.command[0] == 0.0)


def test_axes_that_share_a_load_are_freed_when_one_fails(axes):
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.rig.nodes.trip(1, 0x2310)
    assert "node 1 is in fault: EMCY 0x2310" in str(fault_of(axes.drives.read))
    axes.arrives(0.0, 0.0)
    assert axes.rig.nodes.states[1] is DriveState.SWITCHED_ON


def test_power_is_taken_from_axes_that_move_without_waiting_for_them(axes, monkeypatch):
    axes.cycle(100.0, 100.0)
    axes.set("velocity", 0.3, 0.3)
    waits = lambda: pytest.fail("waits for axes that nothing slows down")  # noqa: E731
    monkeypatch.setattr(axes.drives, "_come_to_rest", waits)
    axes.drives.deactivate()
    assert axes.drives._word is Controlword.DISABLE_VOLTAGE
    assert set(axes.rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}
    assert axes.rig.command == (0.0, 0.0)


def test_slide_that_nothing_holds_is_told_and_not_remembered(make, tmp_path):
    file = tmp_path / "p.json"
    axes = make(position_file=str(file))
    axes.set("velocity", 0.0, -0.1)  # it falls
    words = "node 2 moves without power, so its position is not remembered"
    assert words in str(fault_of(axes.drives.deactivate))
    assert set(axes.rig.nodes.states) == {DriveState.SWITCH_ON_DISABLED}
    assert json.loads(file.read_text())["position_m"] is None
    axes.set("velocity", 0.0, 0.0)
    axes.drives.deactivate()
    assert json.loads(file.read_text())["position_m"] == pytest.approx([MIDDLE] * 2, abs=1e-5)


def test_drives_begin_without_a_force(axes):
    axes.cycle(100.0, 100.0)
    axes.arrives(100.0, 100.0)
    axes.drives.deactivate()
    began = time.monotonic()
    axes.drives.activate()
    while time.monotonic() < began + 0.05:
        axes.drives.read()
        assert axes.rig.command == (0.0, 0.0)
