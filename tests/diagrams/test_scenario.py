"""Typed scenarios: the layers, and what is said about everything that is wrong with one."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.scenario import check, choice, dump_scenario, load_scenario, quantity
from parapod.systems.core.errors import ParapodError, ScenarioError


@dataclass
class Ground:
    pitch_deg: float = quantity(5.0, -15.0, 15.0)
    roll_deg: float = quantity(0.0, -15.0, 15.0)


@dataclass
class Step:
    time: float = quantity(0.0, 0.0, 100.0)
    ground: Ground = field(default_factory=Ground)


@dataclass
class Scenario:
    backend: str = choice("kinematic", ("kinematic", "multibody"))
    seed: int = quantity(0, 0, 2**31 - 1)
    noise: bool = True
    label: str = "plain"
    gain: float = 1.0
    friction: float | None = quantity(None, 0.0, 2.0)
    offsets: list[float] = quantity([0.0, 0.0, 0.0, 0.0], -0.1, 0.1, length=4)
    starts: list[float] | None = quantity(None, 0.0, 1.0, length=4)
    counts: list[int] = quantity([1], 0, 9)
    ground: Ground = field(default_factory=Ground)
    gust: Ground | None = None
    script: list[Step] = field(default_factory=lambda: [Step()])


@pytest.fixture
def write(tmp_path):
    """Writes a YAML file and returns its path."""

    def write_file(text, name="mine.yaml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write_file


@pytest.fixture
def load(write):
    """Loads a scenario from the texts of a user's file and a default file, and overrides."""

    def load_texts(text=None, overrides=(), default=""):
        file = None if text is None else write(text)
        return load_scenario(Scenario, write(default, "default.yaml"), file, overrides)

    return load_texts


@pytest.fixture
def message(load, tmp_path):
    """What is said about a scenario, with the test's folder taken out of it."""

    def load_wrong(*args, **kwargs):
        with pytest.raises(ScenarioError) as caught:
            load(*args, **kwargs)
        text = str(caught.value)
        assert "\n" not in text
        return text.replace(f"{tmp_path}/", "")

    return load_wrong


# Layers


def test_empty_files_leave_the_schemas_defaults(load):
    assert load("", default="# nothing\n") == Scenario()


def test_layers_win_in_the_order_schema_default_file_users_file_override(load):
    scenario = load(
        "ground: {pitch_deg: 2}\nseed: 2\n",
        ["seed=3"],
        "ground: {pitch_deg: 1, roll_deg: 1}\nseed: 1\nlabel: ours\n",
    )
    assert scenario.ground == Ground(pitch_deg=2.0, roll_deg=1.0)
    assert (scenario.seed, scenario.label, scenario.backend) == (3, "ours", "kinematic")


def test_the_last_override_of_a_key_wins(load):
    assert load(overrides=["seed=3", "seed=4"]).seed == 4


def test_a_list_replaces_the_list_below_and_its_elements_are_completed(load):
    scenario = load("script: [{time: 1}, {ground: {roll_deg: 3}}]\n")
    assert scenario.script == [Step(time=1.0), Step(ground=Ground(roll_deg=3.0))]


def test_an_override_reaches_into_a_list(load):
    scenario = load(
        "script: [{time: 1}, {time: 2}]\n", ["script.1.ground.roll_deg=3", "offsets.2=0.05"]
    )
    assert scenario.script == [Step(1.0), Step(2.0, Ground(roll_deg=3.0))]
    assert scenario.offsets == [0.0, 0.0, 0.05, 0.0]


def test_an_override_may_be_a_list_or_a_mapping(load):
    scenario = load(overrides=["counts=[1, 2]", "ground={roll_deg: 4}"])
    assert scenario.counts == [1, 2]
    assert scenario.ground == Ground(pitch_deg=5.0, roll_deg=4.0)


def test_optional_values_can_be_set_and_unset(load):
    assert load(overrides=["friction=0.5"]).friction == 0.5
    assert load("friction: null\n", default="friction: 0.5\n").friction is None
    assert load(overrides=["gust.roll_deg=3"]).gust == Ground(roll_deg=3.0)
    starts = [0.1, 0.2, 0.3, 0.4]
    assert load("starts: [0.1, 0.2, 0.3, 0.4]\n").starts == starts
    assert load(overrides=["starts=[0.1, 0.2, 0.3, 0.4]", "starts.1=1"]).starts[1] == 1.0
    assert load("starts: null\n", default="starts: [0, 0, 0, 0]\n").starts is None


def test_loading_does_not_change_the_schemas_defaults(load):
    load(overrides=["offsets.0=0.1", "ground.pitch_deg=1", "script.0.time=9"])
    assert load() == Scenario()


def test_exponents_without_a_point_are_numbers_although_yaml_reads_text(load):
    assert load("gain: 1e-3\n").gain == 1e-3


def test_numbers_take_the_schemas_type(load):
    scenario = load("gain: 2\nseed: 3.0\n")
    assert (type(scenario.gain), type(scenario.seed)) == (float, int)


def test_root_keys_with_an_underscore_are_free_for_anchors(load):
    scenario = load("_slope: &slope {pitch_deg: 7}\nground: *slope\nscript: [{ground: *slope}]\n")
    assert scenario.ground == scenario.script[0].ground == Ground(pitch_deg=7.0)


# Round trip


def test_a_dumped_scenario_loads_as_an_equal_one(load):
    scenario = load(
        'label: "no: #1"\ngain: 1.0e-300\ngust: {}\n', ["offsets=[0.1, -0.03, 0, 1e-17]"]
    )
    assert load(dump_scenario(scenario)) == scenario


def test_none_survives_the_round_trip_over_a_default_file_that_sets_a_value(load):
    default = "friction: 0.5\nstarts: [0, 0, 0, 0]\n"
    scenario = load("friction: null\nstarts: null\n", default=default)
    assert scenario.starts is None
    assert load(dump_scenario(scenario), default=default) == scenario


def test_a_dump_keeps_the_schemas_order_and_lists_of_numbers_on_one_line():
    text = dump_scenario(Scenario())
    assert text.startswith("backend: kinematic\nseed: 0\n")
    assert "offsets: [0.0, 0.0, 0.0, 0.0]\n" in text
    assert "ground:\n  pitch_deg: 5.0\n" in text


# Keys


def test_an_unknown_key_is_refused_with_the_allowed_ones(message):
    assert message("ground: {pich_deg: 3}\n") == (
        "scenario mine.yaml: unknown key 'ground.pich_deg'; "
        "allowed under 'ground': pitch_deg, roll_deg (did you mean pitch_deg?)"
    )


def test_an_unknown_key_at_the_root_is_refused(message):
    text = message("grund: {}\n")
    assert text.startswith("scenario mine.yaml: unknown key 'grund'; allowed: backend, counts,")
    assert text.endswith("(did you mean ground?)")


def test_a_key_without_its_parent_is_found_where_it_belongs(message):
    assert message(overrides=["roll_deg=3"]).endswith("(did you mean ground.roll_deg?)")


def test_an_unknown_key_of_a_list_element_is_named_with_its_number(message):
    assert "unknown key 'script.1.tim'" in message("script: [{}, {tim: 1}]\n")


def test_an_unknown_key_of_the_default_file_is_refused(message):
    assert message(default="sed: 1\n").startswith("scenario default.yaml: unknown key 'sed'")


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("script.1.time=3", "unknown key 'script.1'; 'script' has elements 0..0"),
        ("script.x.time=3", "unknown key 'script.x'; 'script' has elements 0..0"),
        ("script.-1.time=3", "unknown key 'script.-1'; 'script' has elements 0..0"),
        ("ground.roll_deg.x=3", "unknown key 'ground.roll_deg.x'; 'ground.roll_deg' is a number"),
        ("ground..x=3", "unknown key 'ground.'; allowed under 'ground': pitch_deg, roll_deg"),
        ("ground.roll_deg", "override 'ground.roll_deg' is not of the form key=value"),
        ("=3", "override '=3' is not of the form key=value"),
        ("counts=[1", "override 'counts=[1', line 1: "),
    ],
)
def test_an_override_that_leads_nowhere_is_refused(message, override, text):
    assert message(overrides=[override]).startswith(text)


def test_an_element_of_an_empty_list_is_refused(message):
    assert message("script: []\n", ["script.0.time=1"]).endswith("'script' is empty")


def test_a_key_given_twice_is_refused_with_both_lines(message):
    assert message("seed: 1\nnoise: true\nseed: 2\n") == (
        "scenario mine.yaml, line 3: key 'seed' is already given in line 1"
    )


def test_the_error_carries_the_key(load):
    with pytest.raises(ParapodError) as caught:
        load("script: [{ground: {pitch_deg: 40}}]\n")
    assert caught.value.key == "script.0.ground.pitch_deg"


# Values


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("ground.pitch_deg=40", "ground.pitch_deg = 40 is outside -15..15"),
        ("ground.pitch_deg=15.0000001", "ground.pitch_deg = 15.0000001 is outside -15..15"),
        ("seed=-1", "seed = -1 is outside 0..2147483647"),
        ("offsets=[0, 0, 0, 0.2]", "offsets.3 = 0.2 is outside -0.1..0.1"),
        ("offsets.1=-0.2", "offsets.1 = -0.2 is outside -0.1..0.1"),
        ("friction=3", "friction = 3 is outside 0..2"),
        ("ground.pitch_deg=.nan", "ground.pitch_deg must be a finite number in -15..15, not nan"),
        ("ground.pitch_deg=nan", "ground.pitch_deg must be a finite number in -15..15, not nan"),
        ("gain=-.inf", "gain must be a finite number, not -inf"),
        (f"gain=1{'0' * 400}", "gain must be a finite number, not inf"),
        ("ground.pitch_deg=abc", "ground.pitch_deg must be a number, not 'abc'"),
        ("ground.pitch_deg=true", "ground.pitch_deg must be a number, not True"),
        ("ground.pitch_deg=[1]", "ground.pitch_deg must be a number, not [1]"),
        ("ground.pitch_deg=", "ground.pitch_deg must be a number, not null"),
        ("seed=1.5", "seed must be a whole number, not 1.5"),
        ("noise=1", "noise must be true or false, not 1"),
        ("label=3", "label must be text, not 3"),
        ("offsets=3", "offsets must be a list of 4 numbers, not 3"),
        ("offsets=[0, 0, 0]", "offsets must be a list of 4 numbers, not [0, 0, 0]"),
        ("starts=3", "starts must be a list of 4 numbers, not 3"),
        ("starts=[0, 0, 0]", "starts must be a list of 4 numbers, not [0, 0, 0]"),
        ("starts=[0, 0, 0, null]", "starts.3 must be a number, not null"),
        ("starts=[0, 0, 0, 2]", "starts.3 = 2 is outside 0..1"),
        ("starts.0=0.1", "starts is null; give it whole, a list of 4 numbers"),
        ("offsets=null", "offsets must be a list of 4 numbers, not null"),
        ("script={}", "script must be a list of mappings, not {}"),
        ("ground=3", "'ground' must be a mapping with keys pitch_deg, roll_deg, not 3"),
        ("ground=!Hill {roll_deg: 1}", "ground must not have a tag, not '!Hill'"),
        ("backend=yes", "backend must be text, one of kinematic, multibody, not True"),
        (
            "backend=multbody",
            "backend = 'multbody' is not one of kinematic, multibody (did you mean multibody?)",
        ),
    ],
)
def test_a_value_that_is_not_allowed_is_refused(message, override, text):
    assert message(overrides=[override]) == text


def test_a_wrong_value_in_a_file_is_refused_with_the_file(message):
    assert message("ground:\n  pitch_deg: 40\n") == (
        "scenario mine.yaml: ground.pitch_deg = 40 is outside -15..15"
    )


def test_the_ends_of_a_range_are_allowed(load):
    assert load(overrides=["ground.pitch_deg=15", "ground.roll_deg=-15"]).ground == Ground(15, -15)


def test_a_long_value_is_cut_short(message):
    assert len(message(overrides=[f"gain={'x' * 1000}"])) < 100


# Files


def test_a_missing_file_is_refused():
    with pytest.raises(ScenarioError, match=r"^scenario file 'x\.yaml' does not exist$"):
        load_scenario(Scenario, Path("x.yaml"))


def test_a_directory_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read: Is a directory"):
        load_scenario(Scenario, tmp_path)


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("seed: 1\nground: [1, 2\n", "scenario mine.yaml, line 3: "),
        ("seed: 1\n\tnoise: true\n", "scenario mine.yaml, line 2: "),
        ("seed: 1\n---\nseed: 2\n", "scenario mine.yaml, line 2: "),
        ("seed: *nowhere\n", "scenario mine.yaml, line 1: "),
        ("gain: 2024-13-45\n", "scenario mine.yaml is not YAML: "),
        ("seed: \x01\n", "scenario mine.yaml is not YAML: "),
        ("[" * 5000, "scenario mine.yaml is not YAML: "),
        (b"\xff\xfe\xfa", "scenario file 'mine.yaml' is not text in UTF-8"),
        ("- 1\n- 2\n", "scenario mine.yaml: a scenario must be a mapping with keys backend,"),
    ],
)
def test_a_file_that_is_no_mapping_in_yaml_is_refused(message, text, start):
    assert message(text).startswith(start)


# Scenarios made in Python


def test_a_scenario_made_in_python_passes_the_same_check():
    made = Scenario(gain=np.float64(2.0), seed=np.int64(3), gust=Ground())
    check(made)
    made.gain = np.float64(math.inf)
    with pytest.raises(ScenarioError, match="gain must be a finite number"):
        check(made)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"ground": Ground(pitch_deg=40.0)}, "ground.pitch_deg = 40 is outside -15..15"),
        ({"gain": math.nan}, "gain must be a finite number, not nan"),
        ({"gain": "3"}, "gain must be a number, not '3'"),
        ({"noise": "true"}, "noise must be true or false, not 'true'"),
        ({"ground": None}, "'ground' must be a mapping with keys pitch_deg, roll_deg, not null"),
        ({"script": [Step(), Step(time=-1.0)]}, "script.1.time = -1 is outside 0..100"),
    ],
)
def test_a_wrong_scenario_made_in_python_is_refused(change, text):
    with pytest.raises(ScenarioError) as caught:
        check(Scenario(**change))
    assert str(caught.value) == text


def test_an_attribute_that_a_typo_added_is_refused():
    scenario = Scenario()
    scenario.ground.pich_deg = 3.0
    with pytest.raises(ScenarioError, match=r"unknown key 'ground\.pich_deg'"):
        check(scenario)


def test_a_wrong_scenario_is_not_dumped():
    with pytest.raises(ScenarioError, match="gain must be a finite number"):
        dump_scenario(Scenario(gain=math.inf))


# Schemas


def test_a_default_outside_its_range_is_refused(write):
    @dataclass
    class Wrong:
        height: float = quantity(3.0, 0.0, 2.0)

    with pytest.raises(ScenarioError, match=r"^schema Wrong: height = 3 is outside 0\.\.2$"):
        load_scenario(Wrong, write(""))


def test_a_type_that_scenarios_do_not_support_is_the_developers_mistake(write):
    @dataclass
    class Wrong:
        table: dict[str, float] = field(default_factory=dict)

    with pytest.raises(TypeError, match="do not support the type"):
        load_scenario(Wrong, write(""))
