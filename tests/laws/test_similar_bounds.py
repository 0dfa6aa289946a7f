"""Laws of limits and bounds in lengths: those of a machine of twice the lengths are twice as much.

What a limit is on the paper's machine stands with it in the code.
"""

from dataclasses import fields, replace
from itertools import islice
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.machining_centre.design import CentreDesign
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.walking_chair import real
from parapod.diagrams.walking_chair.controller import make_controller as make_chair_controller
from parapod.diagrams.walking_chair.design import ChairDesign
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.lab.discovery import find_entry
from parapod.sims.terrain_simulator import course, leg
from parapod.systems.core.physics import GRAVITY
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitor, usual_margin
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.switches import is_on_panel
from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.payload import LEVER, Stand, unexplained_forces
from parapod.systems.walking_chair.statics import force_map
from tests.laws.test_designs import similar

S = 2.0
# Fields of parameters that are no lengths, or those of drives, which `similar` leaves.
OF_DRIVES = {"lowering_rate", "raising_rate", "fastest", "gain", "friction", "response"}


def lengths_of(params: Any) -> dict[str, float]:
    """Fields that a machine gives, which have no default."""
    return {
        each.name: getattr(params, each.name)
        for each in fields(params)
        if each.default is each.default_factory and each.name not in OF_DRIVES
    }


@pytest.mark.parametrize("name", ["supervisor", "fault_detector"])
def test_tolerances_of_an_operation_go_with_the_platform(name):
    usual, own = PlatformDesign(), similar(PlatformDesign(), S)
    one, other = (lengths_of(getattr(design, name)) for design in (usual, own))
    assert len(one) >= 5
    for key, value in one.items():
        assert other[key] == pytest.approx(S * value, rel=1e-12), key


def test_the_margin_against_tipping_goes_with_the_feet():
    usual, own = (design.geometry for design in (PlatformDesign(), similar(PlatformDesign(), S)))
    assert usual_margin(usual) == pytest.approx(0.05, rel=1e-12)
    assert usual_margin(own) == pytest.approx(0.1, rel=1e-12)
    monitor = StabilityMonitor(own)
    limits = monitor.CreateDefaultContext().get_numeric_parameter(0).value()
    assert limits[0] == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize(
    ("experiment", "design"),
    [("compare-engines", PlatformDesign()), ("chair-engines", ChairDesign())],
)
def test_bounds_of_differences_of_engines_go_with_the_machine(experiment, design):
    comparison = find_entry(experiment).load()
    names = [quantity.signal for quantity in comparison.quantities]
    still = {name: np.zeros((3, 12)) for name in (*names, comparison.gap)}
    engines = SimpleNamespace(
        run=SimpleNamespace(time=np.zeros(3)),
        signals={"multibody": still, "mujoco": still},
        steps=np.zeros(0),
    )

    def bounds(machine):
        scenario = comparison.schema(machine=machine)
        scenario.plant.time_step = 1e-3
        if experiment == "chair-engines":
            scenario.passenger.mass_kg *= (S**3) ** (machine is not design)
        comparison.counts_from = lambda scenario: 0.0
        found = islice(comparison.measure(scenario, engines), len(names) + 2)
        return {metric.key: metric.bound for metric in found if metric.bound is not None}

    usual, own = bounds(design), bounds(similar(design, S))
    declared = {
        f"{each.key}_difference_{each.unit}": each.bound
        for each in comparison.quantities
        if each.bound is not None
    }
    for key, bound in declared.items():
        assert usual[key] == pytest.approx(bound, rel=1e-12)
    power = {"mm": 1, "um": 1, "deg": 0, "N": 3}
    assert usual.keys() > declared.keys()
    for key, bound in usual.items():
        assert own[key] == pytest.approx(S ** power[key.rpartition("_")[2]] * bound, rel=1e-12)


def test_bounds_between_bench_and_world_go_with_the_bench(monkeypatch):
    names = ("force_difference_percent", "height_error_mm", "foothold_error_mm")
    monkeypatch.setattr(course, "_differences", lambda pair: dict.fromkeys(names, 0.0))
    experiment = course.BenchCourse("bench-course")

    def bounds(machine):
        scenario = course.BenchCourseScenario(machine=machine)
        metrics = islice(experiment.measure(scenario, course.Courses({"level": None})), 3)
        return [metric.bound for metric in metrics]

    assert bounds(BenchDesign()) == [5.0, 2.0, 2.5]
    assert bounds(similar(BenchDesign(), S)) == pytest.approx([5.0, 2.0 * S, 2.5 * S], rel=1e-12)


def test_bounds_of_a_leg_under_test_go_with_the_leg_and_its_jump(monkeypatch):
    monkeypatch.setattr(leg, "reach_margin", lambda *_: 0.05)
    usual, own = leg.BenchLegScenario(), leg.BenchLegScenario(hip_mm=488.0, jump_mm=150.0)
    reaches = [next(leg._reach(each, None, None)).at_least for each in (usual, own)]
    assert reaches == pytest.approx([10.0, 8.0], rel=1e-12)
    run = {
        "truth.foot_force": np.array([[0.0, 300.0], [0.0, 0.0], [0.0, 300.0]]),
        "hip.velocity": np.zeros((3, 1)),
        "hip.position": np.zeros((3, 1)),
    }
    jumps = []
    for scenario in (usual, own):
        later = scenario.task.instants[1] + np.array((0.1, 0.2, 2.0))
        metrics = leg._jump_metrics(scenario, Signals(later, run))
        jumps += [metric.bound for metric in metrics if metric.key == "jump_error_mm"]
    assert jumps == pytest.approx([50.0, 25.0], rel=1e-12)


class Signals(dict):
    """Signals of a run."""

    def __init__(self, time, signals):
        super().__init__(signals)
        self.time = time


def test_what_no_ground_explains_is_similar_for_a_similar_chair():
    unexplained = []
    for s in (1.0, S):
        design = similar(ChairDesign(), s)
        geometry, masses = design.geometry, design.masses
        lengths = np.tile(leg_inverse(geometry.leg, s * np.array((0.03, 0.05, -0.75))), (4, 1))
        corners = foot_corners(geometry, np.zeros(3), np.eye(3), lengths).reshape(12, 3)
        place = (0.01 * s, 0.02 * s)
        stand = Stand(
            force_map(geometry, lengths), corners, np.ones(12, bool), masses.total, place
        )
        forces = s**3 * np.array((100.0, *(30.0,) * 10, -50.0))
        own, lever = masses.foot_end * GRAVITY, LEVER * geometry.leg.size
        unexplained.append(unexplained_forces(stand, 57.0 * s**3, forces, own, lever=lever))
    usual, own = unexplained
    assert np.abs(usual).max() > 10.0
    np.testing.assert_allclose(own, S**3 * usual, rtol=1e-6, atol=1e-6 * np.abs(own).max())


def test_the_guard_weighs_moments_by_the_size_of_the_chair_that_it_watches(monkeypatch):
    levers = []

    def remember(stand, mass, forces, own, lever):
        levers.append(lever)
        return np.zeros(12)

    monkeypatch.setattr(real, "unexplained_forces", remember)
    for s in (1.0, S):
        scenario = ChairScenario(machine=similar(ChairDesign(), s))
        leg = scenario.machine.geometry.leg
        lengths = np.tile(leg_inverse(leg, s * np.array((0.03, 0.05, -0.75))), 4)
        values = {
            "legs.position": lengths,
            "legs.current": np.ones(12),
            "support": np.ones(4),
            "payload_estimated": np.array((57.0, 0.0, 0.0)),
        }
        assert real.ChairGuard(scenario).check(1.0, values) is None
    assert levers == pytest.approx([0.2, 0.2 * S], rel=1e-12)


def test_a_clamp_reaches_as_far_as_its_foot_is_large():
    for s in (1.0, S):
        geometry = similar(CentreDesign(), s).geometry
        panel = Panel(3.0 * s, geometry.foot_height)
        for off, is_on in ((1.49e-3, True), (1.51e-3, False)):
            foot = panel.frame(0.1, 0.05, height=panel.foot_height + s * off)
            assert is_on_panel(panel, foot) is is_on


@pytest.mark.parametrize(("size", "tool"), [(1.0, 480.0), (S, 480.0), (1.0, 520.0)])
def test_a_walk_begins_where_the_drill_is_off_the_panel(size, tool):
    scenario = CentreScenario()
    scenario.machine = similar(replace(CentreDesign(), tool_length_mm=tool), size)
    scenario.machine.legs.max_force_N *= size**3
    scenario.walk.advance_mm, scenario.walk.steps = 20.0, 1
    height = scenario.plan.beginning.pose[2]
    assert height == pytest.approx(size * max(0.52, 1e-3 * tool + 0.04), rel=1e-12)


def test_steps_of_the_voltage_go_with_what_lifts_the_platform():
    scenario = find_entry("identify-actuators").load().schema()
    usual = scenario.plan.voltages
    assert usual == (0.75, -1.0, 1.25, -1.5, 1.75, -2.0, 2.25, -2.5, 2.75, -3.0)
    scenario.machine.actuators.motor_constant_N_V /= 3.0
    assert scenario.plan.voltages == pytest.approx([3.0 * volts for volts in usual], abs=0.006)


def test_how_far_off_its_beginning_a_chair_may_stand_goes_with_its_strokes():
    usual, own = ChairDesign(), similar(ChairDesign(), S)
    one, other = (
        make_chair_controller(ChairScenario(machine=design)).GetSubsystemByName("eased_start")
        for design in (usual, own)
    )
    assert one.farthest == 0.02
    assert other.farthest == pytest.approx(S * one.farthest, rel=1e-12)
