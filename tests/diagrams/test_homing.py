"""Searches for references, carried out on axes that are a few lines of arithmetic."""

from types import SimpleNamespace

import numpy as np
import pytest

from parapod.diagrams.homing import APPROACHES, HomingError, find_ends, lead
from parapod.diagrams.levelling_platform import homing as platform
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.walking_chair import homing as chair
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.plane import to_platform
from parapod.systems.walking_chair.geometry import BRANCHES, LegGeometry

PERIOD = 0.01
MACHINE = PlatformDesign()
PLATFORM_LEGS = platform.make_homing(MACHINE)
LEGS = chair.make_homing(LegGeometry())
RETRACTED, EXTENDED = np.tile(LegGeometry().strokes, (LEG_COUNT, 1)).T
NI = SimpleNamespace(extended_mm=459.5)
EPOS = SimpleNamespace(homing_current_a=0.5)
LONGEST = 20_000  # calls, 200 s
G = 9.80665


class Legs:
    """Four actuators with friction, encoders without reference, switches, and a floor."""

    def __init__(self, start=0.45, offset=(0.1, -0.2, 0.0, 0.3), slope=(0.02, -0.03)):
        self.true = np.full(LEG_COUNT, start)
        self.offset, self.slope = np.array(offset), np.array(slope)
        self.shown, self.drives = [0, 1, 2, 3], [0, 1, 2, 3]  # which leg's encoder, which motor
        self.switches = [0, 1, 2, 3]
        self.sign, self.frozen, self.stuck = np.ones(LEG_COUNT), {}, {}
        self.scale = np.ones(LEG_COUNT)
        self.floor = platform.on_floor(MACHINE)
        self.has_contact, self.told = np.ones(LEG_COUNT), []
        self.commands, self.reached = [], self.true.copy()

    def step(self, commands):
        self.commands.append(list(commands))
        for i, volts in enumerate(commands):
            moving = abs(volts) > 0.05
            speed = 0.01 * (volts - np.copysign(0.05, volts)) if moving else 0.0
            motor = self.drives[i]
            here = self.true[motor] + self.sign[motor] * speed * PERIOD
            self.true[motor] = np.clip(here, 0.380, 0.460)
        self.reached = np.maximum(self.reached, self.true)

    def values(self):
        shown = (self.scale * self.true - self.offset)[self.shown]
        for i, value in self.frozen.items():
            shown[i] = value
        extended = (self.true >= 0.4595)[self.switches].astype(float)
        for i, value in self.stuck.items():
            extended[i] = value
        contact = (self.true <= self.floor) * self.has_contact
        limits = np.r_[extended, np.zeros(LEG_COUNT), contact]
        roll, pitch = self.slope
        if (self.true < self.floor).all():
            lifted = forward_kinematics(DRAWN, self.true, self.slope)
            roll, pitch = lifted[:2]
        accel = G * np.array(to_platform((0.0, 0.0, 1.0), roll, pitch))
        return {"legs.extension": shown, "legs.limits": limits, "imu.accel": accel}


class Branches:
    """Twelve screws between their ends, whose motors push with what they may."""

    def __init__(self, way=0.01, jam=None, retracted=None):
        self.low = RETRACTED.copy() if retracted is None else retracted
        self.high = EXTENDED.copy()
        self.true = self.low + way
        if jam is not None:
            index, at = jam
            self.low[index] += at
        self.offset = np.linspace(-0.3, 0.3, len(BRANCHES))
        self.velocity = self.current = np.zeros(len(BRANCHES))
        self.told = []
        self.dead = set()
        self.commands = []

    def step(self, commands):
        self.commands.append(list(commands))
        asked = np.array([0.0 if i in self.dead else v for i, v in enumerate(commands)])
        here = np.clip(self.true + asked * PERIOD, self.low, self.high)
        self.velocity = (here - self.true) / PERIOD
        held = np.abs(self.velocity) < 0.01 * np.abs(asked)
        self.current = np.where(held & (asked != 0.0), np.copysign(0.5, asked), 0.05)
        self.true = here

    def values(self):
        return {
            "legs.position": self.true - self.offset,
            "legs.velocity": self.velocity,
            "legs.current": self.current,
        }


def carried_out(procedure, plant, steps=1):
    """Leads a plant that makes some steps from one measurement to the next."""
    commands, now = next(procedure), 1000.0
    for _ in range(LONGEST):
        for _ in range(steps):
            plant.step(commands)
        now += steps * PERIOD
        measured = plant.values()
        stamps = {f"{name.partition('.')[0]}.stamp": (now,) for name in measured}
        try:
            commands = procedure.send(measured | stamps)
        except StopIteration as over:
            return over.value
    raise AssertionError("it takes too long")


def homed(plant, homing, driver):
    """What the encoders show is right by so much [m]: zero for a perfect reference."""
    found = carried_out(find_ends(homing, driver, "legs", PERIOD, plant.told.append), plant)
    shown = plant.values()[f"legs.{homing.measures}"]
    return np.array(homing.positions(driver)) + shown - found.edge - plant.true, found


@pytest.mark.parametrize("start", [0.42, 0.45, 0.4599])
def test_legs_find_their_switches_wherever_they_begin(start):
    legs = Legs(start)
    error, found = homed(legs, PLATFORM_LEGS, NI)
    assert np.abs(error).max() < 5e-5
    assert found.spread.max() < 5e-5
    assert legs.reached.max() < 0.46, "an end stop was reached"


def test_a_slow_computer_accuses_nobody():
    legs = Legs()
    search = find_ends(PLATFORM_LEGS, NI, "legs", PERIOD, legs.told.append)
    found = carried_out(search, legs, 3)
    shown = legs.values()["legs.extension"]
    error = np.array(PLATFORM_LEGS.positions(NI)) + shown - found.edge - legs.true
    assert np.abs(error).max() < 1.5e-4


def test_the_same_measurement_again_is_no_time_in_which_an_axis_stands():
    legs = Legs()
    procedure = find_ends(PLATFORM_LEGS, NI, "legs", PERIOD, legs.told.append)
    next(procedure)
    values = legs.values() | {"legs.stamp": (5.0,), "imu.stamp": (5.0,)}
    for _ in range(1000):
        assert any(procedure.send(values)) or legs.told


def test_one_leg_moves_at_a_time_and_none_with_more_than_little_force():
    legs = Legs()
    homed(legs, PLATFORM_LEGS, NI)
    asked = np.array(legs.commands)
    assert (np.count_nonzero(asked, axis=1) <= 1).all()
    assert legs.told == [f"legs {leg}: to the end" for leg in (1, 2, 3, 4)]
    assert np.abs(asked).max() == PLATFORM_LEGS.fast
    slow = np.isclose(asked, PLATFORM_LEGS.slow)
    assert (np.count_nonzero(np.diff(slow.astype(int), axis=0) > 0, axis=0) == APPROACHES).all()


def raised(legs):
    carried_out(PLATFORM_LEGS.begin(PLATFORM_LEGS, NI, PERIOD, legs.told.append), legs)
    return legs


def test_legs_that_stand_come_up_together_until_no_foot_touches():
    legs = Legs()
    legs.true = legs.floor - 0.01
    stood = legs.true.copy()
    legs.step = lambda commands, step=legs.step: step(np.array(commands) * (1.0, 0.7, 1.3, 1.0))
    raised(legs)
    way = legs.true - stood
    assert np.ptp(way) < 5e-4
    assert way.min() == pytest.approx(0.012, abs=1e-4)
    assert np.max(legs.commands) <= 1.3 * PLATFORM_LEGS.slow
    assert np.min(legs.commands) >= 0.0
    assert legs.told == ["feet touch the ground: all legs come up together"]


def test_a_leg_that_a_broken_off_search_left_at_its_end_stays_there():
    legs = Legs()
    legs.true = legs.floor - 0.01
    legs.true[0] = 0.46
    raised(legs)
    assert not np.array(legs.commands)[:, 0].any()
    assert legs.true[1:] == pytest.approx(legs.floor[1:] + 0.002, abs=1e-4)


def test_legs_that_are_up_do_not_move_before_the_search():
    legs = raised(Legs())
    assert legs.commands == [[0.0] * LEG_COUNT]
    assert legs.told == []


@pytest.mark.parametrize(
    ("scale", "contact", "words"),
    [
        (0.0, False, "leg 3 does not come up: encoder, drive or supply"),
        (-1.0, False, r"leg 3 does not come up with leg 1: -1.\d mm and 0.\d mm by now"),
        (1.0, True, "foot 1 touches although its leg has come up by 40 mm: is its contact"),
    ],
)
def test_legs_that_do_not_come_up_together_are_named(scale, contact, words):
    legs = Legs()
    legs.true = legs.floor - 0.01
    legs.scale[2] = scale
    if contact:
        legs.floor = np.full(LEG_COUNT, np.inf)
    with pytest.raises(HomingError, match=words):
        raised(legs)


def test_legs_that_lose_their_supply_on_their_way_up_are_named():
    legs = Legs()
    legs.true = legs.floor - 0.01
    legs.step = lambda commands, step=legs.step: len(legs.commands) < 150 and step(commands)
    with pytest.raises(HomingError, match=r"leg \d does not come up: encoder, drive or supply"):
        raised(legs)


class TippingLegs(Legs):
    """Legs of a platform that rolls as leg 3 goes."""

    def __init__(self, steepness):
        super().__init__()
        self.steepness = steepness  # [rad/m]

    def values(self):
        roll = self.steepness * (self.true[2] - 0.45)
        return super().values() | {"imu.accel": G * np.array(to_platform((0, 0, 1), roll, 0.0))}


def test_a_platform_that_tilts_while_a_leg_looks_for_its_end_ends_the_search():
    homed(TippingLegs(1.5), PLATFORM_LEGS, NI)  # by 0.9 deg
    legs = TippingLegs(6.0)
    with pytest.raises(HomingError, match=r"the platform has tilted by 1\.5 deg while a leg"):
        homed(legs, PLATFORM_LEGS, NI)
    assert legs.true[2] < 0.459


def _break(legs, what):
    legs.sign[1] = -1.0 if what == "reversed" else 1.0
    if what == "stuck encoder":
        legs.frozen[1] = 0.4
    legs.scale[1] = 0.2 if what == "wrong counts" else 1.0
    if what == "dead switch":
        legs.stuck[1] = 0.0
    if what == "closed switch":
        legs.stuck[1] = 1.0
    if what == "swapped motors":
        legs.drives = [0, 2, 1, 3]
    if what == "swapped switches":
        legs.switches = [0, 2, 1, 3]


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("reversed", "legs 2 moves against its command"),
        ("stuck encoder", "legs 2 stands, but its end has not shown"),
        ("dead switch", "legs 2 stands, but its end has not shown"),
        ("wrong counts", "legs 2 has moved .* and should have moved"),
        ("closed switch", "legs 2: the sign of its end stays"),
        ("swapped motors", "legs 3 has moved by .* while legs 2 was commanded"),
        ("swapped switches", "the switch of legs 3 has answered while legs 2"),
    ],
)
@pytest.mark.parametrize("steps", [1, 3])  # of 10 ms from one measurement to the next
def test_what_is_broken_or_swapped_is_refused_and_named(what, words, steps):
    legs = Legs()
    _break(legs, what)
    search = find_ends(PLATFORM_LEGS, NI, "legs", PERIOD, legs.told.append)
    with pytest.raises(HomingError, match=words):
        carried_out(search, legs, steps)


def test_ends_that_are_found_at_several_places_are_none():
    legs = Legs()
    values = legs.values

    def slipping():  # two tenths of a millimetre at each turn
        asked = np.array(legs.commands)[:, 0]
        turns = np.count_nonzero((asked[1:] < 0.0) & (asked[:-1] >= 0.0))
        shown = values()
        shown["legs.extension"][0] += 2e-4 * turns
        return shown

    legs.values = slipping
    with pytest.raises(HomingError, match=r"legs 1: its end was found at places .* mm apart"):
        homed(legs, PLATFORM_LEGS, NI)


def test_switches_close_where_the_driver_says_or_else_the_machine():
    assert PLATFORM_LEGS.positions(SimpleNamespace()) == [0.4595] * 4
    assert PLATFORM_LEGS.positions(SimpleNamespace(extended_mm=451.0)) == [0.451] * 4


def _on_floor(legs):
    checks = carried_out(PLATFORM_LEGS.checks(PLATFORM_LEGS, NI, PERIOD), legs)
    return {check.key: check for check in checks}


def test_a_good_reference_holds_on_an_inclined_floor_and_the_legs_are_up_again():
    legs = Legs(offset=np.zeros(LEG_COUNT))
    checks = _on_floor(legs)
    assert {key: check.is_held for key, check in checks.items()} == dict.fromkeys(checks, True)
    assert checks["touch_error_mm"].value < 0.1
    assert checks["inclination_error_deg"].value < 0.05
    assert legs.true == pytest.approx([0.45] * LEG_COUNT, abs=5e-4)


@pytest.mark.parametrize(
    ("offset", "broken"),
    [
        ((0.004, 0.0, 0.0, 0.0), {"touch_error_mm", "plane_error_mm", "inclination_error_deg"}),
        ((0.003, 0.003, 0.003, 0.003), {"touch_error_mm"}),  # all alike: still a plane
        ((0.0018, -0.0018, 0.0018, -0.0018), {"plane_error_mm"}),
        ((0.0019, 0.0019, -0.0019, -0.0019), {"inclination_error_deg"}),
    ],
)
def test_a_wrong_reference_shows_on_the_floor(offset, broken):
    checks = _on_floor(Legs(offset=offset))
    assert {key for key, check in checks.items() if not check.is_held} == broken


def test_a_foot_without_ground_and_a_leg_that_stays_up_end_the_check():
    legs = Legs(offset=np.zeros(LEG_COUNT))
    legs.has_contact[2] = 0.0
    with pytest.raises(HomingError, match="foot 3 has found no ground"):
        _on_floor(legs)
    legs = Legs(offset=np.zeros(LEG_COUNT))
    legs.frozen[2] = 0.45
    legs.has_contact[2] = 0.0
    with pytest.raises(HomingError, match="leg 3 does not come down"):
        _on_floor(legs)


def test_an_axis_that_comes_no_nearer_is_named():
    legs = Legs(offset=np.zeros(LEG_COUNT))
    legs.frozen[3] = 0.44
    with pytest.raises(HomingError, match=r"legs 4 does not come nearer .* 10\.0 mm away"):
        carried_out(lead(PLATFORM_LEGS, "legs.extension", [0.45] * 4), legs)


def test_branches_find_their_ends_all_at_once_and_stand_off_them_in_the_end():
    branches = Branches()
    error, found = homed(branches, LEGS, EPOS)
    assert np.abs(error).max() < 1e-6
    assert found.spread.max() < 1e-6
    branches.offset = -error  # the reference is set
    (check,) = carried_out(LEGS.checks(LEGS, EPOS, PERIOD), branches)
    assert check.is_held
    assert abs(check.value) < 1e-3
    off = RETRACTED + chair._OFF
    assert branches.true == pytest.approx(off, abs=5e-4)


def test_a_branch_that_was_jammed_has_too_short_a_stroke():
    branches = Branches(way=0.02, jam=(4, 0.008))
    error, _ = homed(branches, LEGS, EPOS)
    assert error[4] == pytest.approx(-0.008, abs=1e-5)
    branches.offset = -error
    (check,) = carried_out(LEGS.checks(LEGS, EPOS, PERIOD), branches)
    assert not check.is_held
    assert check.value == pytest.approx(-8.0, abs=0.1)
    assert BRANCHES[4] in check.meaning


def test_a_branch_that_stands_without_pushing_has_found_no_end():
    branches = Branches()
    step = branches.step

    def powerless(commands):
        step(commands)
        branches.current = np.zeros(len(BRANCHES))

    branches.step = powerless
    with pytest.raises(HomingError, match="legs 1 stands, but its end has not shown"):
        homed(branches, LEGS, EPOS)


def test_a_branch_without_power_is_not_taken_for_one_at_its_end():
    branches = Branches()
    branches.dead = {7}
    with pytest.raises(HomingError, match="legs 8 stands, but its end has not shown"):
        homed(branches, LEGS, EPOS)
