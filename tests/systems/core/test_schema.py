"""Schemas in Python: whatever YAML may not say is refused when it is assigned."""

import copy
import math
import pickle
import subprocess
import sys
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
import pytest

from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import Schema, Variant, check, choice, quantity


class Word(StrEnum):
    OFF = "off"


@dataclass
class Ground(Schema):
    pitch_deg: float = quantity(5.0, -15.0, 15.0)
    roll_deg: float = quantity(0.0, -15.0, 15.0)

    @property
    def pitch(self):
        return math.radians(self.pitch_deg)

    @property
    def slope(self):
        return self.pitch_deg

    @slope.setter
    def slope(self, slope):
        self.pitch_deg = slope


@dataclass
class Hill(Ground):
    height: float = quantity(1.0, 0.0, 9.0)


@dataclass
class Step(Schema):
    time: float = quantity(0.0, 0.0, 100.0)
    ground: Ground = field(default_factory=Ground)


@dataclass
class Gripper(Variant):
    arm: str = "left"


@dataclass
class Jaw(Gripper):
    width_mm: float = quantity(80.0, 0.0, 200.0)


@dataclass
class _Hidden(Gripper):
    pass


@dataclass
class Scenario(Schema):
    backend: str = choice("kinematic", ("kinematic", "multibody"))
    kind: str = choice("on", ("on", "off"))
    seed: int = quantity(0, 0, 2**31 - 1)
    noise: bool = True
    label: str = "plain"
    gain: float = 1.0
    friction: float | None = quantity(None, 0.0, 2.0)
    offsets: list[float] = quantity([0.0, 0.0, 0.0, 0.0], -0.1, 0.1, length=4)
    counts: list[int] = quantity([1], 0, 9)
    ground: Ground = field(default_factory=Ground)
    script: list[Step] = field(default_factory=lambda: [Step()])
    gripper: Gripper = field(default_factory=Jaw)


# What is refused, and the words.
REFUSALS = [
    ("gain", math.nan, "gain must be a finite number, not nan"),
    ("gain", np.float64(math.inf), "gain must be a finite number, not inf"),
    ("gain", "3", "gain must be a number, not '3'"),
    ("gain", None, "gain must be a number, not null"),
    ("gain", True, "gain must be a number, not True"),
    ("gain", 10**400, "gain must be a finite number, not inf"),
    ("seed", 1.5, "seed must be a whole number, not 1.5"),
    ("seed", -1, "seed = -1 is outside 0..2147483647"),
    ("noise", "true", "noise must be true or false, not 'true'"),
    ("label", 3, "label must be text, not 3"),
    ("kind", False, "kind must be text, one of on, off, not False"),
    (
        "backend",
        "multbody",
        "backend = 'multbody' is not one of kinematic, multibody (did you mean multibody?)",
    ),
    ("friction", 3, "friction = 3 is outside 0..2"),
    ("offsets", 3, "offsets must be a list of 4 numbers, not 3"),
    ("offsets", [0.0], "offsets must be a list of 4 numbers, not [0.0]"),
    ("offsets", [0.0, 0.0, 0.2, 0.0], "offsets.2 = 0.2 is outside -0.1..0.1"),
    ("counts", [1, 1.5], "counts.1 must be a whole number, not 1.5"),
    ("ground", None, "'ground' must be a mapping with keys pitch_deg, roll_deg, not null"),
    ("ground", Jaw(), "ground must not have a tag, not '!Jaw'"),
    ("ground", {"roll_deg": 40}, "ground.roll_deg = 40 is outside -15..15"),
    ("script", [Step(), 3], "'script.1' must be a mapping with keys ground, time, not 3"),
    ("gripper", Gripper(), "gripper must begin with one of the tags !Jaw, not !Gripper"),
    ("gripper", None, "gripper must begin with one of the tags !Jaw, not null"),
    ("label\n", "x", "unknown key 'label\\n'; allowed: backend, counts, friction, gain, "),
    ("grund", 1, "unknown key 'grund'; allowed: backend, counts, friction, gain, gripper, "),
    ("pitch_deg", 1, "unknown key 'pitch_deg'; allowed: backend, counts, friction, gain, "),
]


@pytest.mark.parametrize(("name", "value", "text"), REFUSALS)
def test_what_is_not_admissible_is_refused_when_it_is_assigned(name, value, text):
    scenario = Scenario()
    with pytest.raises(ScenarioError) as caught:
        setattr(scenario, name, value)
    assert str(caught.value).startswith(text)
    assert caught.value.key.split(".")[0] == name
    assert scenario == Scenario()
    check(scenario)


@pytest.mark.parametrize(
    ("name", "value", "text"), [r for r in REFUSALS if hasattr(Scenario, r[0])]
)
def test_constructors_and_copies_with_changes_refuse_the_same(name, value, text):
    with pytest.raises(ScenarioError) as caught:
        Scenario(**{name: value})
    assert str(caught.value) == text
    with pytest.raises(ScenarioError) as caught:
        replace(Scenario(), **{name: value})
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("name", "nearest"), [("grund", "ground"), ("pitch_deg", "ground.pitch_deg")]
)
def test_an_unknown_attribute_is_refused_with_the_one_that_was_meant(name, nearest):
    with pytest.raises(ParapodError, match=rf"\(did you mean {nearest}\?\)$"):
        setattr(Scenario(), name, 1.0)


def test_values_take_the_schema_s_types():
    scenario = Scenario(
        kind=Word.OFF, seed=np.int64(3), gain=np.float32(2.0), offsets=(0, 0, 0, np.float64(0.1))
    )
    values = (scenario.kind, scenario.seed, scenario.gain, *scenario.offsets)
    assert values == ("off", 3, 2.0, 0.0, 0.0, 0.0, 0.1)
    assert [type(value) for value in values] == [str, int, float, float, float, float, float]
    assert type(Scenario(seed=4.0).seed) is int


def test_dataclasses_that_fit_stay_themselves_and_mappings_become_them():
    ground, jaw, steps = Hill(height=2.0), Jaw(width_mm=3.0), [Step()]
    scenario = Scenario(ground=ground, gripper=jaw, script=steps)
    assert scenario.ground is ground
    assert scenario.gripper is jaw
    assert scenario.script[0] is steps[0]
    assert scenario.script is not steps
    assert Scenario(ground={"roll_deg": 2}).ground == Ground(roll_deg=2.0)


def test_properties_stay_what_they_are():
    ground = Ground()
    ground.slope = 3
    assert (ground.pitch_deg, ground.pitch) == (3.0, math.radians(3.0))
    with pytest.raises(AttributeError, match="no setter"):
        ground.pitch = 1.0
    with pytest.raises(ScenarioError, match=r"^pitch_deg = 90 is outside -15\.\.15$"):
        ground.slope = 90.0


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_copies_are_equal_and_checked_too(copied):
    scenario = copied(Scenario(seed=3, script=[Step(1.0)], gripper=Jaw("right")))
    assert scenario == Scenario(seed=3, script=[Step(1.0)], gripper=Jaw("right"))
    with pytest.raises(ScenarioError):
        scenario.seed = -1


def test_a_list_that_is_changed_in_place_is_refused_by_check_with_the_whole_key():
    scenario = Scenario(script=[Step(), Step()])
    scenario.offsets[2] = 0.2
    with pytest.raises(ScenarioError, match=r"^offsets\.2 = 0\.2 is outside -0\.1\.\.0\.1$"):
        check(scenario)
    scenario = Scenario()
    scenario.script.append("x")
    with pytest.raises(ScenarioError, match=r"^'script\.1' must be a mapping"):
        check(scenario)


def test_a_dataclass_that_is_no_schema_is_checked_only_on_request():
    @dataclass
    class Loose:
        height: float = quantity(1.0, 0.0, 2.0)

    loose = Loose(height=3.0)
    with pytest.raises(ScenarioError, match=r"^height = 3 is outside 0\.\.2$"):
        check(loose)
    loose.height, loose.heigth = 1.0, 2.0
    with pytest.raises(ScenarioError, match=r"unknown key 'heigth'.*did you mean height"):
        check(loose)


def test_a_schema_whose_own_default_is_not_admissible_says_so():
    @dataclass
    class Wrong(Schema):
        height: float = quantity(3.0, 0.0, 2.0)

    with pytest.raises(ScenarioError, match=r"^schema Wrong: height = 3 is outside 0\.\.2$"):
        load_scenario(Wrong)


def test_what_yaml_cannot_say_is_admitted_in_python_alone():
    scenario = Scenario(gripper=_Hidden())
    with pytest.raises(ScenarioError, match="gripper must begin with one of the tags !Jaw, not"):
        check(scenario)

    @dataclass
    class Wrong(Schema):
        table: dict[str, float] = field(default_factory=dict)

    wrong = Wrong(table={"a": 1.0})
    assert wrong.table == {"a": 1.0}
    with pytest.raises(TypeError, match="do not support the type"):
        check(wrong)


def test_schemas_and_their_files_need_no_drake():
    code = (
        "import sys, parapod.systems.core.schema, parapod.systems.core.scenario_file; "
        "sys.exit(bool({'pydrake', 'numpy', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
