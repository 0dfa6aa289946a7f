"""Scenario files: the layers, the words for everything that is wrong, and the way back."""

import copy
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import pytest
import yaml

from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import describe, dump_scenario, load_scenario
from parapod.systems.core.schema import Schema, Variant, checked, choice, quantity


@dataclass
class Ground(Schema):
    """The ground. It is firm.

    Attributes:
        pitch_deg: pitch of the ground [deg].
        roll_deg: roll of the ground, positive where the right side is the lower one of the two
            and the platform has to be levelled by its left legs [deg].
    """

    pitch_deg: float = quantity(5.0, -15.0, 15.0)
    roll_deg: float = quantity(0.0, -15.0, 15.0)


@dataclass
class Step(Schema):
    """One step.

    Attributes:
        time: beginning of the step [s].
        ground: see `Ground`.
    """

    time: float = quantity(0.0, 0.0, 100.0)
    ground: Ground = field(default_factory=Ground)


@dataclass
class Reach(Schema):
    """An arm.

    Attributes:
        arm: model of the arm.
    """

    arm: str = "left"


@dataclass
class Gripper(Variant):
    """Root of the grippers.

    Attributes:
        arm: arm that holds it.
    """

    arm: str = "left"


@dataclass
class Jaw(Gripper):
    """A gripper with two jaws.

    Attributes:
        width_mm: opening [mm].
    """

    width_mm: float = quantity(80.0, 0.0, 200.0)


@dataclass
class Cup(Gripper):
    """A suction cup.

    Attributes:
        arm: arm with the pump.
    """

    vacuum_kpa: float = quantity(60.0, 0.0, 90.0)
    radii_mm: list[float] = quantity([20.0, 20.0], 1.0, 50.0, length=2)


@dataclass
class Scenario(Schema):
    """All that a scenario can hold.

    A second paragraph, for the head of the file.

    Attributes:
        backend: plant.
        seed: seed of everything random.
        noise: noise of the sensors.
        label: name of the run.
        gain: gain [-].
        friction: friction, if it is known [-].
        offsets: offsets of the legs [m].
        starts: places from which the legs begin [m].
        counts: counts.
        ground: see `Ground`; nobody has told the controller.
        gust: see `Ground`.
        script: steps in their order.
        faults: steps that fail; of another kind.
        grippers: grippers of the arms.
        main: the one that works.
        other: a spare one.
    """

    backend: str = choice("kinematic", ("kinematic", "multibody", "off"))
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
    faults: list[Step] = field(default_factory=list)
    grippers: list[Gripper] = field(default_factory=lambda: [Jaw(), Cup()])
    main: Gripper = field(default_factory=Jaw)
    other: Gripper | None = None


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

    def load_texts(text=None, overrides=(), default=None):
        files = (
            None if default is None else write(default, "default.yaml"),
            None if text is None else write(text),
        )
        return load_scenario(Scenario, *files, overrides)

    return load_texts


@pytest.fixture
def message(load, tmp_path):
    """The words for a wrong scenario, with the test's folder taken out of them."""

    def load_wrong(*args, **kwargs):
        with pytest.raises(ScenarioError) as caught:
            load(*args, **kwargs)
        text = str(caught.value).replace(f"{tmp_path}/", "")
        assert text.isprintable()
        assert len(text) < 500
        return text

    return load_wrong


# Layers


@pytest.mark.parametrize(
    ("text", "overrides", "default", "differs"),
    [
        (None, [], None, {}),
        ("", [], "# nothing\n", {}),
        ("seed: 2\n", ["seed=3"], "seed: 1\nlabel: ours\n", {"seed": 3, "label": "ours"}),
        (None, ["seed=3", "seed=4"], None, {"seed": 4}),
        ("ground: {pitch_deg: 2}\n", [], "ground: {roll_deg: 1}\n", {"ground": Ground(2.0, 1.0)}),
        (
            "script: [{time: 1}, {ground: {roll_deg: 3}}]\n",
            ["script.0.ground.pitch_deg=4", "offsets.2=0.05"],
            "script: [{time: 9}]\n",
            {
                "script": [Step(1.0, Ground(4.0)), Step(ground=Ground(roll_deg=3.0))],
                "offsets": [0.0, 0.0, 0.05, 0.0],
            },
        ),
        (None, ["counts=[1, 2]"], None, {"counts": [1, 2]}),
        (None, ["ground={roll_deg: 4}"], None, {"ground": Ground(roll_deg=4.0)}),
        ("friction: null\n", [], "friction: 0.5\n", {"friction": None}),
        ("starts: null\n", [], "starts: [0, 0, 0, 0]\n", {"starts": None}),
        (None, ["gust.roll_deg=3"], None, {"gust": Ground(roll_deg=3.0)}),
        (None, ["starts=[0, 0, 0, 0]", "starts.1=1"], None, {"starts": [0.0, 1.0, 0.0, 0.0]}),
        ("gain: 1e-3\nseed: 3.0\n", [], None, {"gain": 1e-3, "seed": 3}),
        ("gain: 2\nbackend: off\n", [], None, {"gain": 2.0, "backend": "off"}),
        ("noise: 'false'\n", [], None, {"noise": False}),
        (
            "_slope: &slope {pitch_deg: 7}\nground: *slope\nscript: [{ground: *slope}]\n",
            [],
            None,
            {"ground": Ground(7.0), "script": [Step(ground=Ground(7.0))]},
        ),
        (
            "_both: &both {pitch_deg: 7, roll_deg: 1}\nground: {<<: *both, roll_deg: 2}\n",
            [],
            None,
            {"ground": Ground(7.0, 2.0)},
        ),
        (
            "grippers: [!Cup {vacuum_kpa: 30}, !Jaw {}]\nother: !Cup {}\n",
            ["grippers.0.radii_mm.1=3", "other.arm=x"],
            None,
            {"grippers": [Cup(vacuum_kpa=30.0, radii_mm=[20.0, 3.0]), Jaw()], "other": Cup("x")},
        ),
        ("grippers:\n- !Cup\n  arm: right\n", [], None, {"grippers": [Cup("right")]}),
        # The same tag again changes only the keys it names; another one leaves nothing.
        ("main: !Jaw {width_mm: 1}\n", [], "main: !Jaw {arm: x}\n", {"main": Jaw("x", 1.0)}),
        ("main: !Cup {vacuum_kpa: 1}\n", [], "main: !Jaw {arm: x}\n", {"main": Cup("left", 1.0)}),
        (None, ["main=!Cup {}", "main.vacuum_kpa=6"], None, {"main": Cup(vacuum_kpa=6.0)}),
        (None, ["main=!Cup"], None, {"main": Cup()}),
        ("other: null\n", [], "other: !Cup {}\n", {"other": None}),
    ],
)
def test_a_layer_changes_what_it_names_and_no_more(load, text, overrides, default, differs):
    scenario = load(text, overrides, default)
    assert scenario == Scenario(**differs)
    assert load() == Scenario()


@dataclass
class Renamed(Schema):
    """A scenario two of whose keys have moved."""

    moved: ClassVar = {"slope": "ground.pitch_deg", "field": "ground"}
    ground: Ground = field(default_factory=Ground)


@pytest.mark.parametrize(
    ("text", "overrides", "expected"),
    [
        ("slope: 3\n", [], Ground(3.0)),
        ("slope: 3\nground: {roll_deg: 1}\n", [], Ground(3.0, 1.0)),
        ("field: {roll_deg: 1}\n", ["slope=4"], Ground(4.0, 1.0)),
        (None, ["field.roll_deg=2", "ground.pitch_deg=1"], Ground(1.0, 2.0)),
    ],
)
def test_a_former_key_is_read_with_a_warning(tmp_path, text, overrides, expected):
    path = None if text is None else tmp_path / "scenario.yaml"
    if path is not None:
        path.write_text(text)
    with pytest.warns(DeprecationWarning, match=r"the key (slope|field) is now ground"):
        scenario = load_scenario(Renamed, None, path, overrides)
    assert scenario == Renamed(expected)


def test_a_former_key_is_an_attribute_and_beside_its_new_one_it_is_refused(tmp_path):
    scenario = Renamed()
    with pytest.warns(DeprecationWarning, match=r"the key slope is now ground\.pitch_deg"):
        scenario.slope = 3
    with pytest.warns(DeprecationWarning, match=r"the key field is now ground"):
        assert scenario.field.pitch_deg == 3.0
    with pytest.raises(AttributeError, match="nothing"):
        _ = scenario.nothing
    path = tmp_path / "both.yaml"
    path.write_text("slope: 3\nground: {pitch_deg: 3}\n")
    says = r"slope and ground\.pitch_deg are the same key"
    warns = pytest.warns(DeprecationWarning, match="the key slope")
    with warns, pytest.raises(ScenarioError, match=says):
        load_scenario(Renamed, None, path)


@dataclass
class Built(Schema):
    """A scenario with a machine."""

    machine: Ground = field(default_factory=Ground)


def test_a_machine_may_stand_in_a_file_of_its_own(tmp_path):
    machine, job = tmp_path / "machine.yaml", tmp_path / "job.yaml"
    machine.write_text("pitch_deg: 4\n")
    job.write_text("machine: !File machine.yaml\n")
    assert load_scenario(Built, None, job) == Built(Ground(4.0))
    assert load_scenario(Built, None, None, [f"machine=!File {machine}"]) == Built(Ground(4.0))
    both = load_scenario(Built, None, job, ["machine.roll_deg=1"], machine)
    assert both == Built(Ground(4.0, 1.0))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("machine: !File none.yaml\n", r"scenario file '.*none\.yaml' does not exist"),
        ("machine: !File\n", "!File must be followed by the name of a file"),
        ("machine: !File [a]\n", "!File must be followed by the name of a file"),
        ("machine: !File machine.yaml\n", r"unknown key 'machine\.lean'"),
        ("machine: !File again.yaml\n", "!File is for scenarios of one's own"),
    ],
)
def test_a_wrong_file_of_a_machine_is_refused_in_one_line(tmp_path, text, says):
    (tmp_path / "machine.yaml").write_text("lean: 4\n")
    (tmp_path / "again.yaml").write_text("pitch_deg: !File machine.yaml\n")
    job = tmp_path / "job.yaml"
    job.write_text(text)
    with pytest.raises(ScenarioError, match=says) as caught:
        load_scenario(Built, None, job)
    assert "\n" not in str(caught.value)
    with pytest.raises(ScenarioError, match=r"unknown key 'machine\.lean'"):
        load_scenario(Built, None, None, (), tmp_path / "machine.yaml")


def test_values_have_the_schema_s_types(load):
    scenario = load("gain: 2\nseed: 3.0\ncounts: [2.0]\n")
    values = (scenario.gain, scenario.seed, *scenario.counts)
    assert [type(value) for value in values] == [float, int, int]


# Refusals of overrides, and of the same text in a file

OVERRIDES = [
    # Keys
    ("grund=1", "unknown key 'grund'; allowed: backend, counts, faults, friction, gain, "),
    ("ground.pich_deg=3", "unknown key 'ground.pich_deg'; allowed under 'ground': pitch_deg, rol"),
    ("roll_deg=3", "unknown key 'roll_deg'; allowed: "),
    ("script.0.tim=1", "unknown key 'script.0.tim'; allowed under 'script.0': ground, time (did"),
    ("script.1.time=3", "unknown key 'script.1'; 'script' has elements 0..0"),
    ("script.\u0663.time=3", "unknown key 'script.\u0663'; 'script' has elements 0..0"),
    ("script.00.time=3", "unknown key 'script.00'; 'script' has elements 0..0"),
    (f"script.{'9' * 5000}.time=3", "unknown key 'script.9999"),
    ("faults.0.time=1", "unknown key 'faults.0'; 'faults' is empty"),
    ("ground.roll_deg.x=3", "unknown key 'ground.roll_deg.x'; 'ground.roll_deg' is a number, not"),
    ("ground..x=3", "unknown key 'ground.'; allowed under 'ground': pitch_deg, roll_deg"),
    ("ground.roll_deg", "override 'ground.roll_deg' is not of the form key=value"),
    ("=3", "override '=3' is not of the form key=value"),
    ("counts=[1", "override 'counts=[1', line 1: "),
    ("grippers.0.vacuum_kpa=3", "unknown key 'grippers.0.vacuum_kpa'; allowed under 'grippers.0'"),
    ("other.width_mm=3", "other is null; give it whole, with one of the tags !Jaw, !Cup"),
    ("starts.0=0.1", "starts is null; give it whole, a list of 4 numbers"),
    # Values
    ("ground.pitch_deg=40", "ground.pitch_deg = 40 is outside -15..15"),
    ("ground.pitch_deg=15.0000001", "ground.pitch_deg = 15.0000001 is outside -15..15"),
    ("ground.pitch_deg=.nan", "ground.pitch_deg must be a finite number in -15..15, not nan"),
    ("ground.pitch_deg=abc", "ground.pitch_deg must be a number, not 'abc'"),
    ("ground.pitch_deg=", "ground.pitch_deg must be a number, not null"),
    ("gain=-.inf", "gain must be a finite number, not -inf"),
    (f"gain=1{'0' * 400}", "gain must be a finite number, not inf"),
    ("noise=1", "noise must be true or false, not 1"),
    ("offsets=[0, 0, 0, 0.2]", "offsets.3 = 0.2 is outside -0.1..0.1"),
    ("starts=[0, 0, 0, null]", "starts.3 must be a number, not null"),
    ("script={}", "script must be a list of mappings, not {}"),
    ("ground=!Hill {roll_deg: 1}", "ground must not have a tag, not '!Hill'"),
    ("backend=yes", "backend must be text, one of kinematic, multibody, off, not True"),
    ("backend=multbody", "backend = 'multbody' is not one of kinematic, multibody, off"),
    # Variants
    ("grippers=[!Cup {}, !Jow {}]", "grippers.1 must begin with one of the tags !Jaw, !Cup, not"),
    ("main=!Gripper {}", "main must begin with one of the tags !Jaw, !Cup, not !Gripper"),
    ("main={width_mm: 3}", "main must begin with one of the tags !Jaw, !Cup, not {'width_mm': 3}"),
    ("main=!Jaw {width_mm: 300}", "main.width_mm = 300 is outside 0..200"),
    ("main=!Cup {radii_mm: [1, 99]}", "main.radii_mm.1 = 99 is outside 1..50"),
    ("main=!!python/object:os.system {}", "main must begin with one of the tags !Jaw, !Cup, not "),
    ("main=!Jaw 3", "override 'main=!Jaw 3', line 1: expected a mapping node"),
    # Tags of YAML's own that do not fit, and numbers that have no decimal form
    ("backend=!!bool 1", "override 'backend=!!bool 1' is not YAML: a value does not fit its tag"),
    ("seed=!!int x", "override 'seed=!!int x' is not YAML: invalid literal"),
    ("gain=!!binary x", "override 'gain=!!binary x', line 1: failed to decode base64 data"),
    ("gain=!!omap [1]", "override 'gain=!!omap [1]', line 1: expected a mapping"),
    (f"label=0x{'f' * 5000}", "label must be text, not a very long int"),
    (f"counts=[0x{'f' * 5000}, x]", "counts.0 must be a finite number in 0..9, not inf"),
    # Whatever people type
    ("x\ny=1", "unknown key 'x\\ny'; allowed: backend, "),
    ("ground.\x1b[31m=1", "unknown key 'ground.\\x1b[31m'; allowed under 'ground': "),
    (f"{'x' * 10_000}=1", "unknown key 'xxxx"),
    (f"{'x.' * 10_000}=1", "unknown key 'x'; allowed"),
    (f"label=[{'x' * 10_000}]", "label must be text, not ['xxxx"),
    ('ground={"a\\nb": 1}', "unknown key 'ground.a\\nb'; allowed under 'ground': "),
    ('{"": 1}=', "unknown key '{\"\": 1}'; allowed: "),
    ("seed=\x00", "override 'seed=\\x00' is not YAML: "),
    ("seed=" + "\n" * 10, "seed must be a whole number, not null"),
    ("gain=" + "1" * 300_000, "override 'gain=1111"),
]


@pytest.mark.parametrize(("override", "text"), OVERRIDES, ids=[o[:30] for o, _ in OVERRIDES])
def test_a_wrong_override_is_refused_in_one_line(message, override, text):
    assert message(overrides=[override]).startswith(text)


FILES = [
    ("ground: {pitch_deg: 40}\n", "scenario mine.yaml: ground.pitch_deg = 40 is outside -15..15"),
    ("sed: 1\n", "scenario mine.yaml: unknown key 'sed'; allowed: backend, counts, "),
    ("script: [{}, {tim: 1}]\n", "scenario mine.yaml: unknown key 'script.1.tim'; allowed under"),
    ("1: 2\n", "scenario mine.yaml: unknown key '1'; allowed: backend, "),
    ('"a\\nb": 1\n', "scenario mine.yaml: unknown key 'a\\nb'; allowed: backend, "),
    ("seed: 1\nnoise: true\nseed: 2\n", "scenario mine.yaml, line 3: key 'seed' is already given"),
    ("_x: [{a: 1, a: 2}]\n", "scenario mine.yaml, line 1: key 'a' is already given in line 1"),
    ("main:\n  !Jaw 3\n", "scenario mine.yaml, line 2: expected a mapping node"),
    ("seed: 1\nground: [1, 2\n", "scenario mine.yaml, line 3: "),
    ("seed: 1\n\tnoise: true\n", "scenario mine.yaml, line 2: "),
    ("seed: 1\n---\nseed: 2\n", "scenario mine.yaml, line 2: "),
    ("seed: *nowhere\n", "scenario mine.yaml, line 1: "),
    ("? [1]\n: 2\n", "scenario mine.yaml, line 1: found unhashable key"),
    ("seed: \x01\n", "scenario mine.yaml is not YAML: "),
    ("[" * 5000, "scenario mine.yaml is not YAML: "),
    (b"\xff\xfe\xfa", "scenario file 'mine.yaml' is not text in UTF-8"),
    ("- 1\n- 2\n", "scenario mine.yaml: a scenario must be a mapping with keys backend,"),
    ("# " + "x" * 300_000, "scenario file 'mine.yaml' is larger than 200 kB"),
    ("_x: [" + "x, " * 60_000 + "]", "scenario mine.yaml is not YAML: it has more than 10000"),
    ("_x: &x [*x]\n", "scenario mine.yaml, line 1: an alias stands within what it names"),
]


@pytest.mark.parametrize(("text", "said"), FILES, ids=[str(t[:20]) for t, _ in FILES])
def test_a_wrong_file_is_refused_in_one_line(message, text, said):
    assert message(text).startswith(said)
    if not isinstance(text, bytes):
        assert message(default=text).startswith(said.replace("mine.yaml", "default.yaml"))


def bomb(levels, item):
    """Aliases of which each level repeats the one before nine times."""
    lines = [f"_l0: &l0 {item}"]
    for i in range(1, levels):
        lines.append(f"_l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]")
    return "\n".join([*lines, ""])


@pytest.mark.parametrize("item", ["[x, x, x, x, x, x, x, x, x]", "{a: x}"])
def test_aliases_that_multiply_are_refused_at_once(message, item, work_of):
    with work_of() as work:
        text = message(bomb(9, item))
        assert message(overrides=["label=" + "[" + bomb(9, item).replace("\n", "}, {") + "]"])
    assert text == "scenario mine.yaml: aliases multiply it to more than 10000 values"
    assert work.calls < 60_000


def test_merges_that_multiply_are_refused_at_once(message, work_of):
    lines = ["_l0: &l0 {a: 1, b: 2, c: 3}"]
    for i in range(1, 9):
        lines.append(f"_l{i}: &l{i} {{<<: [{', '.join([f'*l{i - 1}'] * 9)}]}}")
    with work_of() as work:
        assert "aliases multiply it" in message("\n".join(lines))
    assert work.calls < 60_000


def test_aliases_within_reason_are_free(load):
    assert load(bomb(3, "{time: 1}") + "script: [*l0, *l0]\n").script == [Step(1.0)] * 2


@pytest.mark.parametrize(
    ("override", "nearest"),
    [
        ("ground.pich_deg=3", "pitch_deg"),
        ("roll_deg=3", "ground.roll_deg"),
        ("main=!Jow {}", "Jaw"),
        ("backend=multbody", "multibody"),
    ],
)
def test_the_nearest_name_is_suggested(message, override, nearest):
    assert message(overrides=[override]).endswith(f" (did you mean {nearest}?)")


def test_the_error_carries_the_key(load):
    with pytest.raises(ParapodError) as caught:
        load("script: [{ground: {pitch_deg: 40}}]\n")
    assert caught.value.key == "script.0.ground.pitch_deg"


def test_the_ends_of_a_range_are_allowed(load):
    assert load(overrides=["ground.pitch_deg=15", "ground.roll_deg=-15"]).ground == Ground(15, -15)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x.yaml", "scenario file 'x.yaml' does not exist"),
        ("a\nb", "scenario file 'a\\nb' does not exist"),
        (".", "scenario file '.' cannot be read: Is a directory"),
        ("x" * 10_000, "scenario file 'xxxxx"),
        ("\x00", "scenario file '\\x00' cannot be read: embedded null byte"),
    ],
)
def test_a_file_that_cannot_be_read_is_named_in_one_line(name, text):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(Scenario, Path(name))
    assert str(caught.value).startswith(text)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500


def test_two_variants_of_one_name_are_refused_and_a_later_one_of_a_module_counts():
    @dataclass
    class Lamp(Variant):
        is_on: bool = True

    @dataclass
    class Bulb(Lamp):
        watts: float = quantity(40.0, 0.0, 100.0)

    @dataclass
    class Room(Schema):
        lamp: Lamp = field(default_factory=Bulb)

    override = ["lamp=!Spot {watts: 5}"]
    with pytest.raises(ScenarioError, match="must begin with one of the tags !Bulb, not !Spot"):
        load_scenario(Room, overrides=override)

    @dataclass
    class Spot(Bulb):
        angle_deg: float = quantity(30.0, 1.0, 90.0)

    @dataclass
    class _Hidden(Lamp):
        pass

    assert load_scenario(Room, overrides=override).lamp == Spot(watts=5.0)
    with pytest.raises(ScenarioError, match="one of the tags !Bulb, !Spot, not !_Hidden"):
        load_scenario(Room, overrides=["lamp=!_Hidden {}"])


def test_a_name_that_two_packages_give_is_of_the_family_s_own_or_of_none():
    @dataclass
    class Shade(Variant):
        pass

    @dataclass
    class Wide(Shade):
        pass

    @dataclass
    class Room(Schema):
        shade: Shade = field(default_factory=Wide)

    kinds = [
        dataclass(type(name, (Shade,), {"__module__": module}))
        for name, module in (
            *(("Wide", "north.shades"), ("Round", "north.shades")),
            *(("Round", "south.shades"), ("Flat", "south.shades")),
        )
    ]
    assert Shade.variants() == {"Wide": Wide, "Flat": kinds[3]}
    taken = f"!Wide of north.shades is not used: {__name__} has one of that name"
    both = "!Round is defined by north.shades and by south.shades: none is used"
    assert Shade.clashes() == (taken, both)
    assert load_scenario(Room, overrides=["shade=!Wide {}"]).shade == Wide()
    with pytest.raises(
        ScenarioError, match=r"one of the tags !Wide, !Flat, not !Round.*; "
    ) as told:
        load_scenario(Room, overrides=["shade=!Round {}"])
    assert str(told.value).endswith(both)


# Writing

WRITTEN = [
    Scenario(),
    Scenario(label="no: #1", gain=1e-300, gust=Ground(), offsets=[0.1, -0.03, 0.0, 1e-17]),
    Scenario(label="a\nb\t\u2028 \x85'\"", friction=0.5, starts=[0.0] * 4, counts=[]),
    Scenario(label="a\nb", main=Jaw("\nc\n")),
    Scenario(backend="off", label="1e3", script=[], faults=[Step(1.0), Step(2.0)]),
    Scenario(label="", grippers=[], main=Cup(radii_mm=[1.0, 2.0]), other=Jaw("[a, {b: c}]")),
    Scenario(label="~", grippers=[Cup(), Cup(), Jaw()], counts=list(range(9)) * 20),
]


@pytest.mark.parametrize("comments", [False, True])
@pytest.mark.parametrize("scenario", WRITTEN, ids=range(len(WRITTEN)))
def test_what_is_written_is_read_as_an_equal_scenario(load, scenario, comments):
    text = dump_scenario(scenario, comments)
    default = "friction: 0.5\nstarts: [1, 1, 1, 1]\nother: !Jaw {}\ncounts: [3]\nlabel: x\n"
    assert load(text) == load(text, default=default) == scenario
    assert all(len(line) <= 99 for line in text.splitlines())
    assert comments or "\n\n" not in text
    types = [type(gripper) for gripper in (*scenario.grippers, scenario.main)]
    again = load(text)
    assert [type(gripper) for gripper in (*again.grippers, again.main)] == types


def test_text_survives_as_an_element_of_a_list():
    @dataclass
    class Words(Schema):
        words: list[str] = field(default_factory=list)

    words = Words(["a, b", "[", "off", "1", "", "#", "x: y", "a\nb", "é" * 60, "-" * 60])
    text = dump_scenario(words)
    assert load_scenario(Words, overrides=[f"words={text.partition(':')[2]}"]) == words


def test_keys_stand_in_the_schema_s_order_and_numbers_on_one_line():
    text = dump_scenario(Scenario(), comments=False)
    assert text.startswith("backend: kinematic\nseed: 0\n")
    assert "offsets: [0.0, 0.0, 0.0, 0.0]\n" in text
    assert "ground:\n  pitch_deg: 5.0\n" in text
    assert "grippers:\n- !Jaw\n  arm: left\n" in text
    assert "main: !Jaw\n  arm: left\n" in text
    assert "script:\n- time: 0.0\n  ground:\n    pitch_deg: 5.0\n" in text
    assert "#" not in text


def test_comments_explain_every_key_once():
    text = dump_scenario(Scenario(script=[Step(), Step()]), comments=True)
    for line in (
        "# All that a scenario can hold.",
        "# A second paragraph, for the head of the file.",
        "seed: 0                        # seed of everything random (0..2147483647)",
        "offsets: [0.0, 0.0, 0.0, 0.0]  # offsets of the legs [m] (4 numbers, each -0.1..0.1)",
        "friction: null                 # friction, if it is known [-] (0..2 or null)",
        "# The ground. It is firm. Nobody has told the controller.",
        "  pitch_deg: 5.0  # pitch of the ground [deg] (-15..15)",
        "# grippers of the arms (any of !Jaw, !Cup)",
        "# A gripper with two jaws.",
        "  arm: left       # arm that holds it",
    ):
        assert line in text.splitlines(), line
    assert text.count("# beginning of the step [s]") == 1
    assert text.count("pitch of the ground") == 1


def test_an_empty_list_shows_an_element_that_may_be_uncommented(load):
    text = dump_scenario(Scenario(script=[]), comments=True)
    head, _, rest = text.partition("script: []")
    lines = rest.splitlines()[1:]
    assert lines[0] == "# An element, with its defaults:"
    example = [line.removeprefix("# ") for line in lines[1 : lines.index("")]]
    head = "\n".join(line for line in head.splitlines() if not line.startswith("script"))
    assert load("\n".join([head, "script:", *example])).script == [Step()]


def test_a_scenario_that_is_not_admissible_is_not_written():
    scenario = Scenario()
    scenario.counts.append(10)
    with pytest.raises(ScenarioError, match=r"^counts\.1 = 10 is outside 0\.\.9$"):
        dump_scenario(scenario)


def test_descriptions_come_from_the_docstrings_of_a_schema_and_its_bases():
    texts = describe(Jaw)
    assert texts == {"arm": "arm that holds it.", "width_mm": "opening [mm]."}
    assert describe(Cup) == {"arm": "arm with the pump.", "vacuum_kpa": "", "radii_mm": ""}


# Anything at all


def mutated(tree, rng):
    """The tree with one value, key or element changed into something else."""
    places = []
    values = [None, True, -1, 1e9, "x", "off", [], {}, [1], {"a": 1}, "\x1b\n", 10**400]

    def visit(node):
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                visit(node[key])

    visit(tree)
    node, key = rng.choice(places)
    if rng.random() < 0.3 and isinstance(node, dict):
        node[rng.choice(["x", "_tag", "a\nb", 3, "y" * 999])] = node.pop(key)
    else:
        node[key] = copy.deepcopy(rng.choice([*values, rng.uniform(-20.0, 20.0)]))
    return tree


def changed(rng):
    tree = checked(Scenario(gust=Ground()))
    for _ in range(rng.randint(1, 2)):
        tree = mutated(tree, rng)
    return yaml.safe_dump(tree)


def typed_over(rng):
    text = list(
        "seed: 3\nground: {roll_deg: 1.5}\nmain: !Jaw {arm: x}\nscript:\n- time: 1\n- {}\n"
    )
    for _ in range(rng.randint(1, 3)):
        text[rng.randrange(len(text))] = rng.choice("!&*-:?{}[]#|>%@`'\"\n\t\x00 1e.xé")
    return "".join(text)


@pytest.mark.parametrize(("make", "count"), [(changed, 150), (typed_over, 200)])
def test_whatever_is_done_to_a_file_gives_a_scenario_or_one_line(load, make, count):
    rng = random.Random(0)
    assert {loads(load, make(rng)) for _ in range(count)} == {True, False}


def loads(load, text):
    """Whether a text is a scenario; else what is said about it must be one line."""
    try:
        scenario = load(text)
    except ScenarioError as error:
        said = str(error)
        assert (said.isprintable(), len(said) < 700) == (True, True), text
        return False
    assert load(dump_scenario(scenario, comments=True)) == scenario
    return True


def test_names_of_models_and_functions_in_a_file_are_beside_it(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "arm.urdf").write_text("<robot name='arm'/>")
    (folder / "law.py").write_text("def make(): ...")
    job, gripper = tmp_path / "job.yaml", folder / "gripper.yaml"
    job.write_text("!File own/gripper.yaml")
    for name, located in (
        ("arm.urdf", f"{folder / 'arm.urdf'}"),
        ("law.py:make", f"{folder / 'law.py'}:make"),
        ("elsewhere.urdf", "elsewhere.urdf"),
        ("left", "left"),
    ):
        gripper.write_text(f"arm: '{name}'")
        assert load_scenario(Reach, file=gripper).arm == located
        assert load_scenario(Reach, file=job).arm == located
