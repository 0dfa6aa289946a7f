"""Dataclasses between which a scenario chooses with a tag: read, refused, overridden, dumped."""

from dataclasses import dataclass, field

import pytest

from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.machines import MACHINES
from parapod.diagrams.scenario import check, dump_scenario, load_scenario, quantity
from parapod.diagrams.scenario_tree import Variant
from parapod.systems.core.errors import ScenarioError


@dataclass
class Gripper(Variant):
    arm: str = "left"


@dataclass
class Jaw(Gripper):
    width_mm: float = quantity(80.0, 0.0, 200.0)


@dataclass
class Cup(Gripper):
    vacuum_kpa: float = quantity(60.0, 0.0, 90.0)
    radii_mm: list[float] = quantity([20.0, 20.0], 1.0, 50.0, length=2)


@dataclass
class Spare:
    kept: bool = True


@dataclass
class Scenario:
    grippers: list[Gripper] = field(default_factory=lambda: [Jaw(), Cup()])
    main: Gripper = field(default_factory=Jaw)
    other: Gripper | None = None
    spare: Spare = field(default_factory=Spare)


@pytest.fixture
def write(tmp_path):
    """Writes a YAML file and returns its path."""

    def write_file(text, name="mine.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write_file


@pytest.fixture
def load(write):
    """Loads a scenario from the texts of a user's file and a default file, and overrides."""

    def load_texts(text="", overrides=(), default=""):
        return load_scenario(Scenario, write(default, "default.yaml"), write(text), overrides)

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


# Reading


def test_the_tag_chooses_the_dataclass_and_what_is_not_said_is_its_default(load):
    scenario = load("grippers: [!Cup {vacuum_kpa: 30}, !Jaw {}, !Cup {arm: right}]\n")
    assert scenario.grippers == [Cup(vacuum_kpa=30.0), Jaw(), Cup(arm="right")]
    assert [type(gripper) for gripper in scenario.grippers] == [Cup, Jaw, Cup]


def test_a_tag_stands_before_a_mapping_over_several_lines(load):
    scenario = load("grippers:\n- !Cup\n  radii_mm: [1, 2]\n  arm: right\n")
    assert scenario.grippers == [Cup(arm="right", radii_mm=[1.0, 2.0])]


def test_a_dataclass_defined_later_and_elsewhere_can_be_chosen(write):
    @dataclass
    class Lamp(Variant):
        is_on: bool = True

    @dataclass
    class Bulb(Lamp):
        watts: float = quantity(40.0, 0.0, 100.0)

    @dataclass
    class Room:
        lamp: Lamp = field(default_factory=Bulb)

    empty, file = write("", "default.yaml"), write("lamp: !Spot {angle_deg: 20, watts: 5}\n")
    with pytest.raises(ScenarioError, match="must begin with one of the tags !Bulb, not !Spot"):
        load_scenario(Room, empty, file)

    @dataclass
    class Spot(Bulb):
        angle_deg: float = quantity(30.0, 1.0, 90.0)

    @dataclass
    class _Hidden(Lamp):
        pass

    assert load_scenario(Room, empty, file).lamp == Spot(watts=5.0, angle_deg=20.0)
    with pytest.raises(ScenarioError, match="one of the tags !Bulb, !Spot, not !_Hidden"):
        load_scenario(Room, empty, write("lamp: !_Hidden {}\n"))


def test_an_optional_one_may_be_left_out_given_and_taken_away(load):
    assert load().other is None
    assert load("other: !Cup {}\n").other == Cup()
    assert load("other: null\n", default="other: !Cup {}\n").other is None


# Layers


def test_the_same_tag_again_changes_only_the_keys_it_names(load):
    scenario = load(
        "main: !Jaw {width_mm: 10}\nother: !Cup {arm: right}\n",
        default="main: !Jaw {width_mm: 5, arm: right}\nother: !Cup {vacuum_kpa: 1}\n",
    )
    assert scenario.main == Jaw("right", 10.0)
    assert scenario.other == Cup("right", 1.0)


def test_another_tag_replaces_what_is_below_with_nothing_left_of_it(load):
    scenario = load("main: !Cup {vacuum_kpa: 1}\n", default="main: !Jaw {arm: right}\n")
    assert scenario.main == Cup("left", 1.0)


def test_a_list_replaces_the_list_below(load):
    scenario = load("grippers: [!Jaw {}]\n", default="grippers: [!Jaw {width_mm: 5}, !Cup {}]\n")
    assert scenario.grippers == [Jaw()]
    assert load("grippers: []\n").grippers == []


def test_an_override_reaches_a_key_of_a_variant(load):
    scenario = load(
        "other: !Cup {}\n",
        ["grippers.0.width_mm=7", "grippers.1.radii_mm.0=3", "main.arm=x", "other.vacuum_kpa=2"],
    )
    assert scenario.grippers == [Jaw(width_mm=7.0), Cup(radii_mm=[3.0, 20.0])]
    assert (scenario.main, scenario.other) == (Jaw("x"), Cup(vacuum_kpa=2.0))


def test_an_override_may_choose_another_variant(load):
    overrides = ["grippers.0=!Cup {vacuum_kpa: 5}", "main=!Cup {}", "main.vacuum_kpa=6"]
    scenario = load(overrides=overrides)
    assert scenario.grippers == [Cup(vacuum_kpa=5.0), Cup()]
    assert scenario.main == Cup(vacuum_kpa=6.0)


# Refusals


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "grippers: [!Cup {}, !Jow {}]",
            "grippers.1 must begin with one of the tags !Jaw, !Cup, not !Jow (did you mean Jaw?)",
        ),
        (
            "main: !Gripper {}",
            "main must begin with one of the tags !Jaw, !Cup, not !Gripper",
        ),
        (
            "main: {width_mm: 3}",
            "main must begin with one of the tags !Jaw, !Cup, not {'width_mm': 3}",
        ),
        ("main: null", "main must begin with one of the tags !Jaw, !Cup, not null"),
        ("grippers: [3]", "grippers.0 must begin with one of the tags !Jaw, !Cup, not 3"),
        (
            "grippers: [!Cup {vacum_kpa: 3}]",
            "unknown key 'grippers.0.vacum_kpa'; allowed under 'grippers.0': "
            "arm, radii_mm, vacuum_kpa (did you mean vacuum_kpa?)",
        ),
        (
            "main: !Jaw {vacuum_kpa: 3}",
            "unknown key 'main.vacuum_kpa'; allowed under 'main': arm, width_mm",
        ),
        ("main: !Jaw {width_mm: 300}", "main.width_mm = 300 is outside 0..200"),
        (
            "main: !Cup {radii_mm: [1]}",
            "main.radii_mm must be a list of 2 numbers, not [1]",
        ),
        ("grippers: [!Cup {radii_mm: [1, 99]}]", "grippers.0.radii_mm.1 = 99 is outside 1..50"),
        ("spare: !Spare {kept: true}", "spare must not have a tag, not '!Spare'"),
    ],
)
def test_what_is_wrong_with_a_variant_is_said_in_one_line(message, text, said):
    assert message(f"{text}\n") == f"scenario mine.yaml: {said}"


@pytest.mark.parametrize("value", ["!Jaw", "!Jaw 3", "!Jaw [1, 2]"])
def test_a_tag_without_a_mapping_is_refused_with_its_line(message, value):
    text = message(f"spare: {{}}\nmain: {value}\n")
    assert text.startswith("scenario mine.yaml, line 2: expected a mapping node")


@pytest.mark.parametrize("tag", ["!!python/object:os.system", "!!python/name:os.system", "!!set"])
def test_yamls_own_tags_make_no_objects(message, tag):
    assert message(f"main: {tag} {{}}\n").startswith("scenario mine.yaml")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "grippers.0.vacuum_kpa=3",
            "unknown key 'grippers.0.vacuum_kpa'; allowed under 'grippers.0': arm, width_mm",
        ),
        (
            "grippers.0={width_mm: 3}",
            "grippers.0 must begin with one of the tags !Jaw, !Cup, not {'width_mm': 3}",
        ),
        ("grippers.1.vacuum_kpa=91", "grippers.1.vacuum_kpa = 91 is outside 0..90"),
        (
            "other.width_mm=3",
            "other is null; give it whole, with one of the tags !Jaw, !Cup",
        ),
        ("grippers.2.arm=x", "unknown key 'grippers.2'; 'grippers' has elements 0..1"),
    ],
)
def test_an_override_that_does_not_fit_its_variant_is_refused(message, override, said):
    assert message(overrides=[override]) == said


def test_the_error_carries_the_key(load):
    with pytest.raises(ScenarioError) as caught:
        load("grippers: [!Jaw {width_mm: -1}]\n")
    assert caught.value.key == "grippers.0.width_mm"


# Round trip


def test_a_dumped_scenario_loads_as_an_equal_one_with_its_tags(load):
    scenario = load("grippers: [!Cup {radii_mm: [1, 2]}, !Jaw {}]\nmain: !Cup {}\n")
    text = dump_scenario(scenario)
    assert text.startswith("grippers:\n- !Cup\n  arm: left\n")
    assert "main: !Cup\n  arm: left\n" in text
    assert "other: null\n" in text
    assert load(text) == scenario
    assert [type(gripper) for gripper in load(text).grippers] == [Cup, Jaw]
    assert load(text, default="other: !Jaw {}\n") == scenario


def test_a_scenario_made_in_python_passes_the_same_check():
    check(Scenario([Cup(), Jaw()], Cup(), Jaw()))
    with pytest.raises(ScenarioError, match=r"^grippers\.0\.width_mm = 900 is outside 0\.\.200$"):
        check(Scenario([Jaw(width_mm=900.0)]))
    scenario = Scenario()
    scenario.main.widht_mm = 3.0
    with pytest.raises(ScenarioError, match=r"unknown key 'main\.widht_mm'"):
        check(scenario)


def test_an_object_that_is_no_variant_is_refused():
    with pytest.raises(ScenarioError, match="main must begin with one of the tags"):
        check(Scenario(main=Spare()))
    with pytest.raises(ScenarioError, match="spare must not have a tag"):
        check(Scenario(spare=Jaw()))


# The drivers of hardware


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.experiment)
def test_the_default_drivers_survive_the_round_trip(write, machine):
    scenario = machine.scenario()
    assert scenario.hardware.drivers
    file = write(dump_scenario(scenario))
    assert load_scenario(machine.scenario, write("", "default.yaml"), file) == scenario


@pytest.mark.parametrize(
    "driver",
    [kind for kind in Driver.variants().values() if kind.__module__.startswith("parapod.")],
    ids=lambda driver: driver.__name__,
)
def test_every_driver_can_be_chosen_by_its_tag(write, driver):
    file = write(f"drivers: [!{driver.__name__} {{}}]\n")
    scenario = load_scenario(HardwareScenario, write("", "default.yaml"), file)
    assert scenario.drivers == [driver()]


def test_a_drivers_setting_is_overridden_by_its_number(write):
    override = ["hardware.drivers.2.node_ids=[5, 6, 7, 8]"]
    scenario = load_scenario(LevellingScenario, write("", "default.yaml"), None, override)
    assert scenario.hardware.drivers[2].node_ids == [5, 6, 7, 8]
