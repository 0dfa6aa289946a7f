"""Legs of two limbs in position mode, with locks and clamps, and a clock that a test sets."""

import math

import pytest

from parapod.systems.hardware.cia402.emulated_drive import EmulatedMotor
from parapod.systems.hardware.cia402.makers import EPOS2, MAKERS
from parapod.systems.hardware.cia402.settings import Control, PositionScrewSettings
from parapod.systems.hardware.cia402.switches import switches_of_limbs
from parapod.systems.hardware.emulation.harness import Harness

LIMBS = 2
AXES = 2 * LIMBS
SIGNS = (1, -1, -1, 1)
GEAR = 2.0 * math.pi * 5.0 / 5e-3  # five turns of the motor for 5 mm
PERIOD = 0.01


class Clock:
    """Time that passes when a test says so [s]."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


class FollowingHarness(Harness):
    """Axes that are at once where they are commanded, and all that they have been commanded."""

    def __init__(self, sizes):
        super().__init__(sizes)
        self.is_following, self.past = True, []

    def set(self, name, values):
        if name == "legs.position_command" and tuple(values) != self.get(name):
            self.past.append(tuple(values))
            if self.is_following:
                super().set("legs.position", values)
        super().set(name, values)


class Legs:
    """A rig of position-controlled legs, and what is done with it again and again."""

    def __init__(self, rig, clock):
        self.rig, self.clock = rig, clock
        self.harness, self.nodes, self.drives = rig.harness, rig.nodes, rig.drives
        self.frames = []

    @property
    def node_ids(self):
        return self.rig.settings.node_ids

    def activate(self):
        self.drives.configure()
        send = self.drives._bus.send

        def recorded(can_id, data, remote=False):
            self.frames.append((can_id, bytes(data)))
            send(can_id, data, remote)

        self.drives._bus.send = recorded
        self.drives.activate()

    def tick(self, elapsed=PERIOD):
        self.clock.now += elapsed

    def write(self, position, brake=0.0, **switches):
        """Writes; positions of all legs or of each, `locks` and `clamps` as their commands."""
        positions = [position] * AXES if isinstance(position, float) else list(position)
        commands = {"position_command": positions, "brake": (brake,)}
        self.drives.write(commands | {f"{name}.command": v for name, v in switches.items()})

    def cycle(self, position, brake=0.0, elapsed=PERIOD, **switches):
        """A period of a controller: reads, and writes."""
        self.tick(elapsed)
        self.drives.read()
        self.write(position, brake, **switches)

    def cycle_until(self, condition, *command, **switches):
        """Cycles until something is so."""
        self.rig.wait(condition, lambda: self.cycle(*command, **switches))

    def settings(self, axis):
        """Set values that have been sent to an axis, in its direction [counts]."""
        pdo = EPOS2.modes[Control.POSITION][0].target
        can_id = pdo.base + self.node_ids[axis]
        return [SIGNS[axis] * pdo.unpack(data)[0] for i, data in self.frames if i == can_id]

    def wire(self, name):
        return self.harness.get(name)

    @property
    def states(self):
        return set(self.nodes.states)


@pytest.fixture
def make_legs(make_rig):
    """make_legs(**changes): see `Legs`; all legs are 0.7 m long, what is given are settings."""
    opened = []

    def make(position=0.7, hold_up=60.0, **changes):
        clock = Clock()
        switches = switches_of_limbs(LIMBS)
        settings = {
            "node_ids": [*range(1, AXES + 1)],
            "lead_mm": 5.0,
            "reduction": 5.0,
            "signs": [*SIGNS],
            "max_velocity_rpm": 4800.0,
            "position_min_mm": [600.0] * AXES,
            "position_max_mm": [800.0] * AXES,
            "position_at_start_mm": [1e3 * position] * AXES,
            "position_file": "",
            "following_error_mm": 1000.0,
            "heartbeat_timeout": 20.0,
        }
        rig = make_rig(
            settings | switches | changes,
            PositionScrewSettings,
            part="legs",
            axes=AXES,
            position=position,
            make_harness=FollowingHarness,
            clock=clock,
            node_ids=settings["node_ids"],
            motor=EmulatedMotor(gear=GEAR),
            signs=SIGNS,
            stop_contact=(switches["stop_node"], switches["stop_input"]),
            hold_up=hold_up,
        )
        rig.__enter__()
        opened.append(rig)
        return Legs(rig, clock)

    yield make
    for rig in opened:
        rig.harness.set("legs.velocity", [0.0] * AXES)  # an end waits for that, and no time passes
        rig.__exit__()


@pytest.fixture
def legs(make_legs):
    """Legs at work, at rest at 0.7 m."""
    legs = make_legs()
    legs.activate()
    return legs


@pytest.fixture(params=MAKERS)
def drive(request):
    """Each maker's drives."""
    return request.param
