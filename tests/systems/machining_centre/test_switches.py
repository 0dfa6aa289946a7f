"""Switches of locks and clamps, and those of rigid bodies that obey between two steps."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.multibody import add_plant
from parapod.diagrams.wiring import add
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import standing
from parapod.systems.machining_centre.locking import Locking
from parapod.systems.machining_centre.model import CentreModel, transform_of
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.machining_centre.switches import LEAN, REACH, Switches, is_on_panel

TRIPOD, PANEL, PERIOD = CentreGeometry(3), Panel(3.0), 0.01
FEET = standing(TRIPOD, PANEL, 0.52).feet
HOME = standing(TRIPOD, PANEL, 0.52).pose
OPEN, CLAMPED = np.zeros(12), np.ones(3)


def one(count, *indices, value=1.0):
    array = np.full(count, 1.0 - value)
    array[list(indices)] = value
    return array


LOCKED, UNCLAMPED = one(12, 5), one(3, 1, value=0.0)


@pytest.fixture
def switches(stand):
    def make(delay=0.0, panel=PANEL, period=PERIOD):
        system = Switches(TRIPOD, panel, period, delay)
        inputs = {"locks_command": OPEN, "clamps_command": CLAMPED, "feet": FEET.ravel()}
        return stand(system, **inputs)

    return make


def test_all_locks_are_open_and_all_feet_clamped_at_the_beginning(switches):
    machine = switches()
    assert np.array_equal(machine["locks_closed"], OPEN)
    assert np.array_equal(machine["clamps_closed"], CLAMPED)
    machine.tick(5)
    assert np.array_equal(machine["clamps_closed"], CLAMPED)


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.03, 0.055])
def test_a_command_is_obeyed_after_its_delay_and_not_before(switches, delay):
    # It is seen at an instant, and obeyed at another one.
    machine, due = switches(delay).tick(3), max(1, int(np.ceil(delay / PERIOD - 1e-9))) + 1
    machine.set(locks_command=LOCKED, clamps_command=UNCLAMPED)
    for k in range(1, due + 3):
        machine.tick()
        obeyed = k >= due
        assert np.array_equal(machine["locks_closed"], LOCKED if obeyed else OPEN), k
        assert np.array_equal(machine["clamps_closed"], UNCLAMPED if obeyed else CLAMPED)
    machine.set(locks_command=OPEN, clamps_command=CLAMPED).tick(due)
    assert np.array_equal(machine["locks_closed"], OPEN)
    assert np.array_equal(machine["clamps_closed"], CLAMPED)


def test_a_command_that_is_taken_back_begins_its_delay_anew(switches):
    machine = switches(0.03).tick()
    for _ in range(3):
        machine.tick(2, locks_command=LOCKED)
        assert np.array_equal(machine["locks_closed"], OPEN)
        machine.tick(1, locks_command=OPEN)
    machine.tick(5, locks_command=LOCKED)
    assert np.array_equal(machine["locks_closed"], LOCKED)


def test_each_lock_and_clamp_has_a_delay_of_its_own(switches):
    machine = switches(0.03).tick(2, locks_command=LOCKED)
    machine.tick(2, clamps_command=UNCLAMPED)
    assert np.array_equal(machine["locks_closed"], LOCKED)
    assert np.array_equal(machine["clamps_closed"], CLAMPED)
    machine.tick(2)
    assert np.array_equal(machine["clamps_closed"], UNCLAMPED)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, 1e300])
def test_what_is_commanded_neither_open_nor_closed_closes(switches, bad):
    machine = switches().tick(2, locks_command=np.zeros(12), clamps_command=UNCLAMPED)
    assert not machine["locks_closed"].any()
    machine.tick(5, locks_command=np.full(12, bad), clamps_command=np.full(3, bad))
    assert machine["locks_closed"].all()
    assert np.array_equal(machine["clamps_closed"], CLAMPED)


@pytest.mark.parametrize(
    ("share", "closes"), [(0.9, True), (1.1, False), (-0.9, True), (-1.1, False)]
)
def test_a_clamp_closes_only_on_the_panel(switches, share, closes):
    lifted = FEET.copy()
    along, across, _ = PANEL.place(FEET[1, :3])
    lifted[1] = PANEL.frame(
        along, across, PANEL.heading(FEET[1]), height=PANEL.foot_height * (1.0 + share * REACH)
    )
    machine = switches().tick(2, clamps_command=UNCLAMPED)
    machine.tick(5, feet=lifted.ravel(), clamps_command=CLAMPED)
    assert machine["clamps_closed"][1] == float(closes)
    # It still wants to, and does so where it can.
    machine.tick(3, feet=FEET.ravel())
    assert np.array_equal(machine["clamps_closed"], CLAMPED)


def test_a_foot_that_leans_is_not_on_the_panel():
    for share, is_on in ((0.9, True), (1.1, False)):
        foot = FEET[0] + np.array((0.0, 0.0, 0.0, share * LEAN, 0.0, 0.0))
        assert is_on_panel(PANEL, foot) is is_on


def test_what_does_not_obey_by_itself_tells_what_is_due(switches):
    machine = switches(0.02, panel=None).tick()
    system, context = machine.system, machine.context
    machine.tick(2, locks_command=LOCKED, clamps_command=UNCLAMPED)
    assert system.due(context) is not None
    machine.tick(20)
    assert np.array_equal(machine["locks_closed"], OPEN)
    locks, clamps = system.due(context)
    assert np.array_equal(locks.ravel(), LOCKED > 0.5)
    assert np.array_equal(clamps, UNCLAMPED > 0.5)
    system.set_closed(context, locks, system.closed(context)[1])
    assert np.array_equal(machine["locks_closed"], LOCKED)
    locks, clamps = system.due(context)
    assert np.array_equal(locks.ravel(), LOCKED > 0.5)
    system.set_closed(context, locks, clamps)
    machine.tick()
    assert system.due(context) is None


# Rigid bodies


class Bodies:
    """A centre of rigid bodies whose switches are obeyed between two steps, or not."""

    def __init__(self):
        builder = DiagramBuilder()
        plant, _ = add_plant(builder, 1e-3, "lagged")
        self.model = add_centre(plant, TRIPOD, footholds=FEET)
        self.switches = add(builder, Switches(TRIPOD, None, PERIOD))
        for name in ("locks_command", "clamps_command", "feet"):
            builder.ExportInput(self.switches.GetInputPort(name), name)
        self.diagram = builder.Build()
        self.locking = Locking(self.model, self.switches, PANEL)
        self.fresh()

    def fresh(self):
        self.simulator = Simulator(self.diagram)
        self.root = self.simulator.get_mutable_context()
        self.context = self.model.plant.GetMyMutableContextFromRoot(self.root)
        self.model.stand(self.context, HOME, FEET)
        lengths = leg_lengths(TRIPOD, HOME, FEET).reshape(-1, 2)
        for limb, pair in zip(self.model.limbs, lengths, strict=True):
            port = self.model.plant.get_desired_state_input_port(limb)
            port.FixValue(self.context, np.concatenate((pair, np.zeros(2))))
        self.command()
        self.diagram.GetInputPort("feet").FixValue(self.root, FEET.ravel())
        return self

    def command(self, locks=OPEN, clamps=CLAMPED):
        self.diagram.GetInputPort("locks_command").FixValue(self.root, locks)
        self.diagram.GetInputPort("clamps_command").FixValue(self.root, clamps)

    def closed(self):
        return self.switches.closed(self.switches.GetMyContextFromRoot(self.root))

    def ask(self, **commands):
        """Has the switches know for a while what is asked, with the bodies where they are."""
        self.command(**commands)
        switches = self.switches.GetMyMutableContextFromRoot(self.root)
        for _ in range(2):
            state = self.switches.EvalUniquePeriodicDiscreteUpdate(switches)
            switches.SetDiscreteState(state)
        self.locking.obey(self.root)


@pytest.fixture(scope="module")
def built():
    return Bodies()


@pytest.fixture
def bodies(built):
    return built.fresh()


def test_a_lock_waits_until_its_joint_stands(bodies):
    limb, joint = bodies.model.limbs[1], bodies.model.lock_joint(2, 2)
    assert limb == joint.model_instance()
    joint.set_angular_rate(bodies.context, 0.01)
    bodies.ask(locks=LOCKED)
    assert not bodies.closed()[0].any()
    assert not joint.is_locked(bodies.context)
    joint.set_angular_rate(bodies.context, 1e-3)
    bodies.ask(locks=LOCKED)
    assert np.array_equal(bodies.closed()[0].ravel(), LOCKED > 0.5)
    assert joint.is_locked(bodies.context)
    locked = [
        (i, j)
        for i in (1, 2, 3)
        for j in (1, 2, 3, 6)
        if bodies.model.lock_joint(i, j).is_locked(bodies.context)
    ]
    assert locked == [(2, 2)]
    bodies.ask(locks=OPEN)
    assert not joint.is_locked(bodies.context)


def test_a_clamp_holds_its_foot_only_on_the_panel_and_at_rest(bodies):
    model, context = bodies.model, bodies.context
    bodies.ask(clamps=UNCLAMPED)
    assert bodies.closed()[1].tolist() == [True, False, True]
    assert not is_active(model, context, 2)
    foot = transform_of(FEET[1]).translation()
    joint = model.plant.GetJointByName("platform")
    # A platform that sinks takes its feet along, as joints and lengths are.
    joint.set_translational_velocity(context, (0.0, 0.0, -0.01))
    bodies.ask(clamps=CLAMPED)
    assert not is_active(model, context, 2)
    joint.set_translational_velocity(context, (0.0, 0.0, 0.0))
    joint.SetTranslation(context, np.add(HOME[:3], (0.0, 0.0, 2.0 * REACH * PANEL.foot_height)))
    bodies.ask(clamps=CLAMPED)
    assert not is_active(model, context, 2)
    joint.SetTranslation(context, np.add(HOME[:3], (0.001, 0.0, 0.0)))
    bodies.ask(clamps=CLAMPED)
    assert is_active(model, context, 2)
    assert bodies.closed()[1].all()
    # Where it is by then, and not where it was let go.
    held = model.plant.GetFrameByName("clamp_2").CalcPoseInWorld(context).translation()
    assert np.allclose(held - foot, (0.001, 0.0, 0.0), atol=1e-9)


def is_active(model: CentreModel, context, limb):
    return model.plant.GetConstraintActiveStatus(context, model.clamps[limb - 1])


def test_without_being_looked_at_between_steps_switches_never_read_closed(bodies):
    bodies.command(locks=LOCKED)
    bodies.simulator.Initialize()
    bodies.simulator.AdvanceTo(0.1)
    assert not bodies.closed()[0].any()
    assert not bodies.model.lock_joint(2, 2).is_locked(bodies.context)
    bodies.locking.obey(bodies.root)
    assert np.array_equal(bodies.closed()[0].ravel(), LOCKED > 0.5)
    assert bodies.model.lock_joint(2, 2).is_locked(bodies.context)
