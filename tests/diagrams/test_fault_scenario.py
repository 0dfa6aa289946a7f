"""Faults in a scenario: what they become, and what is said about those that cannot be."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from parapod.diagrams import faults as faults_module
from parapod.diagrams.faults import KINDS, make_fault_injector
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import PlatformFault
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import dump_scenario, load_scenario
from parapod.systems.core.schema import check
from parapod.systems.safety.faults import Fault, FaultKind

TARGETS = PLATFORM.targets


def check_faults(*arguments, **options):
    return faults_module.check_faults(TARGETS, *arguments, **options)


@dataclass
class Scenario:
    faults: list[PlatformFault] = field(default_factory=list)


@pytest.fixture
def load(tmp_path):
    """Loads the faults of a scenario's text."""

    def load_text(text, overrides=()):
        file, empty = tmp_path / "mine.yaml", tmp_path / "default.yaml"
        file.write_text(text)
        empty.write_text("")
        return load_scenario(Scenario, empty, file, overrides).faults

    return load_text


@pytest.fixture
def refusal(load):
    """Key and message of what is said about a fault written in YAML, on loading or checking."""

    def refuse(fault):
        with pytest.raises(ScenarioError) as caught:
            check_faults(load(f"faults: [{{}}, {{{fault}}}]\n"))
        message = str(caught.value)
        assert "\n" not in message
        return caught.value.key, message.partition("mine.yaml: ")[2] or message

    return refuse


def made(**settings):
    """The only fault that a scenario with these settings becomes."""
    ((fault,),) = check_faults([PlatformFault(**settings)]).values()
    return fault


# YAML


def test_a_fault_is_read_from_yaml(load):
    (scenario,) = load("faults: [{at: 12.0, target: legs.extension, index: 2, kind: stuck}]\n")
    assert scenario == PlatformFault(at=12.0, target="legs.extension", index=2, kind="stuck")
    assert check_faults([scenario]) == {
        "legs.extension": (made(at=12.0, target="legs.extension", index=2, kind="stuck"),)
    }
    fault = made(at=12.0, target="legs.extension", index=2, kind="stuck")
    assert (fault.kind, fault.index, fault.begin) == (FaultKind.STUCK, 2, 12.0)
    assert fault.duration == math.inf


def test_an_override_reaches_a_fault(load):
    (scenario,) = load("faults: [{kind: 'off'}]\n", ["faults.0.kind=slow", "faults.0.value=0.2"])
    assert (scenario.kind, scenario.value) == ("slow", 0.2)


def test_a_dumped_scenario_loads_as_an_equal_one(load):
    faults = [
        PlatformFault(),
        PlatformFault(3.0, "imu.gyro", 1, "wrong", 2.5, 0.1, -1.0),
        PlatformFault(kind=FaultKind.DELAYED, value=0.3),
    ]
    text = dump_scenario(Scenario(faults))
    assert "kind: delayed\n" in text
    assert load(text) == faults
    assert check_faults(load(text), 5) == check_faults(faults, 5)


def test_off_in_quotes_is_a_word(load):
    assert load("faults: [{kind: 'off'}, {kind: \"off\"}]\n") == [PlatformFault(kind="off")] * 2


def test_no_faults_are_no_faults(load):
    assert load("faults: []\n") == []
    assert check_faults([]) == {}


# Targets


def test_targets_are_ports_of_the_station_with_their_sizes():
    sizes = {spec.name: spec.size for spec in (*PLATFORM.inputs, *PLATFORM.outputs)}
    for name, target in TARGETS.items():
        if name == "supply":
            assert (target.point, target.port.size) == ("legs.voltage", sizes["legs.voltage"])
        elif name == "posture_command":
            assert (target.point, target.port.size) == ("posture_command", 3)
        else:
            assert (target.point, target.port.size) == (name, sizes[name])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", TARGETS)
def test_every_kind_fits_every_target_and_can_be_seen(target, kind):
    at = 0.05
    found = check_faults([PlatformFault(at=at, target=target, kind=kind)])
    ((port, faults),) = found.items()
    injector = make_fault_injector(TARGETS[port], 0.01)
    context = injector.CreateDefaultContext()
    injector.set_faults(context, faults)
    random = np.random.default_rng(0)
    for k in range(25):
        context.SetTime(k * 0.01)
        # Values in the middle, so that what is on or off is not so by chance.
        share = random.uniform(0.4, 0.6, injector.size)
        low, high = np.array(TARGETS[target].span.low), np.array(TARGETS[target].span.high)
        signal = random.integers(0, 2, injector.size) if injector.is_binary else None
        injector.get_input_port().FixValue(
            context, low + share * (high - low) if signal is None else signal.astype(float)
        )
        updated = injector.EvalUniquePeriodicDiscreteUpdate(context)
        context.get_mutable_discrete_state().SetFrom(updated)
        assert injector.GetOutputPort("changed").Eval(context)[0] == 0.0 or k >= 5
    assert injector.GetOutputPort("changed").Eval(context)[0] == 1.0


def test_the_supply_is_all_drives_at_once_and_counts_last():
    found = check_faults(
        [
            PlatformFault(target="supply", kind="off"),
            PlatformFault(target="imu.accel"),
            PlatformFault(target="legs.voltage", kind="stuck", index=0),
        ]
    )
    assert set(found) == {"legs.voltage", "imu.accel"}
    assert [(f.kind, f.index) for f in found["legs.voltage"]] == [
        (FaultKind.STUCK, 0),
        (FaultKind.OFF, None),
    ]


def test_a_command_that_is_off_is_no_number():
    injector = make_fault_injector(
        TARGETS["posture_command"], 0.01, [made(target="posture_command")]
    )
    context = injector.CreateDefaultContext()
    injector.get_input_port().FixValue(context, [0.0, 0.0, 0.477])
    assert np.isnan(injector.GetOutputPort("faulted").Eval(context)).all()


@pytest.mark.parametrize("target", TARGETS)
def test_garbage_is_plausible(target):
    (port,) = check_faults([PlatformFault(target=target, kind="garbage")])
    injector = make_fault_injector(TARGETS[port], 0.01, [Fault(FaultKind.GARBAGE)])
    context = injector.CreateDefaultContext()
    injector.get_input_port().FixValue(context, np.zeros(injector.size))
    for k in range(50):
        context.SetTime(0.01 * k)
        shown = injector.GetOutputPort("faulted").Eval(context)
        assert (shown >= TARGETS[target].span.low).all()
        assert (shown <= TARGETS[target].span.high).all()


# What a fault becomes


def test_minus_one_is_every_element():
    assert made(index=-1).index is None
    assert made(index=0).index == 0


def test_a_fault_without_duration_does_not_end():
    assert made().duration == math.inf
    assert made(duration=2.0).duration == 2.0


def test_value_is_what_the_kind_needs():
    assert made(kind="slow", value=0.25).sample_period == 0.25
    assert made(kind="delayed", value=0.25).delay == 0.25
    turns = made(kind="intermittent", value=0.25)
    assert (turns.missing_time, turns.good_time) == (0.25, 0.25)
    assert made(kind="slow").sample_period == Fault(FaultKind.SLOW).sample_period


@pytest.mark.parametrize(
    ("settings", "factor", "offset"),
    [
        ({}, 1.0, 5e-3),
        ({"value": 2e-3}, 1.0, 2e-3),
        ({"scale": 1.1}, 1.1, 0.0),
        ({"scale": 1.1, "value": 2e-3}, 1.1, 2e-3),
        ({"target": "legs.voltage"}, -1.0, 0.0),
        ({"target": "legs.voltage", "value": 2.0}, 1.0, 2.0),
        ({"target": "supply"}, 0.5, 0.0),
    ],
)
def test_a_wrong_value_is_off_by_what_is_said_or_by_the_targets_default(settings, factor, offset):
    fault = made(kind="wrong", **settings)
    assert (fault.factor, fault.offset) == (factor, offset)


def test_each_fault_has_its_own_seed_that_follows_from_the_scenarios():
    faults = [PlatformFault(kind="garbage"), PlatformFault(kind="garbage")]

    def seeds(scenario_faults, seed):
        return [fault.seed for fault in check_faults(scenario_faults, seed)["legs.extension"]]

    assert seeds(faults, 1) == seeds(faults, 1)
    assert len({*seeds(faults, 0), *seeds(faults, 1)}) == 4
    assert seeds(faults[:1], 1) == seeds(faults, 1)[:1]


# Refusals


@pytest.mark.parametrize(
    ("fault", "key", "message"),
    [
        (
            "tagret: imu.gyro",
            "tagret",
            "unknown key 'faults.1.tagret'; allowed under 'faults.1': at, duration, index, kind, "
            "scale, target, value (did you mean target?)",
        ),
        (
            "target: imu.giro",
            "target",
            "faults.1.target = 'imu.giro' is not one of legs.extension, imu.gyro, imu.accel, "
            "legs.limits, legs.emergency_stop, legs.voltage, supply, posture_command "
            "(did you mean imu.gyro?)",
        ),
        ("at: -1", "at", "faults.1.at = -1 is outside 0..3600"),
        ("duration: 0", "duration", "faults.1.duration = 0 is outside 0.001..3600"),
        ("index: 1.5", "index", "faults.1.index must be a whole number, not 1.5"),
        ("index: 12", "index", "faults.1.index = 12 is outside -1..11"),
        (
            "index: 3, target: imu.gyro",
            "index",
            "faults.1.index = 3 is outside -1..2; imu.gyro has elements 0..2, -1 is all of them",
        ),
        (
            "index: 0, target: supply",
            "index",
            "faults.1.index = 0 is not -1; supply is all 4 drives at once",
        ),
        (
            "kind: stuck, value: 3",
            "value",
            "faults.1.value = 3 is not for kind stuck; kinds that have one: wrong (offset in the "
            "port's unit), slow (period in s), delayed (delay in s), intermittent (turn in s)",
        ),
        (
            "kind: slow, scale: 3",
            "scale",
            "faults.1.scale = 3 is not for kind slow; kinds that have one: wrong (factor)",
        ),
        (
            "kind: delayed, value: 1.5",
            "value",
            "faults.1.value = 1.5 is outside 0.001..1, the range of kind delayed (delay in s)",
        ),
        (
            "kind: intermittent, value: 0.01",
            "value",
            "faults.1.value = 0.01 is outside 0.05..60, the range of kind intermittent (turn in "
            "s)",
        ),
        (
            "kind: wrong, target: legs.limits, value: 1",
            "value",
            "faults.1.value = 1 is not for legs.limits: kind wrong inverts its 0 and 1; leave it "
            "out",
        ),
        ("kind: slow, value: .nan", "value", "faults.1.value must be a finite number in -1000"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_with_what_can(refusal, fault, key, message):
    found_key, found = refusal(fault)
    assert found_key == f"faults.1.{key}"
    assert found.startswith(message)


@pytest.mark.parametrize(
    "settings",
    [
        {"kind": "stuk"},
        {"target": "legs.limit"},
        {"at": math.nan},
        {"index": -2},
        {"duration": math.inf},
    ],
)
def test_a_wrong_fault_made_in_python_is_refused(settings):
    with pytest.raises(ScenarioError) as caught:
        PlatformFault(**settings)
    assert [caught.value.key] == list(settings)


def test_the_key_says_where_the_faults_are():
    with pytest.raises(ScenarioError) as caught:
        check_faults([PlatformFault(index=9)], key="cells.3.faults")
    assert caught.value.key == "cells.3.faults.0.index"


def test_a_kind_of_the_enum_passes_the_check():
    check(Scenario([PlatformFault(kind=FaultKind.GARBAGE)]))
