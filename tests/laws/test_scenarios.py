"""Laws of every experiment's scenario, and of every driver that a scenario can name."""

import re
import typing

import pytest

from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.discovery import list_entries
from parapod.systems.core.scenario_file import describe, dump_scenario, load_scenario
from parapod.systems.core.schema import (
    Options,
    Schema,
    fields_of,
    is_family,
    is_schema,
    split_optional,
)

# Units, of one number or of each of several, as in [V, V] and [(m/s)/V].
_UNIT = re.compile(r"\[[^\[\]]+\]")


def default_scenario(entry):
    return load_scenario(entry.load().schema, entry.default_scenario)


def schemas(kind):
    """A schema and all that can stand within it."""
    found = [kind]
    for found_kind in found:
        for inner, _ in fields_of(found_kind).values():
            inner, _ = split_optional(inner)
            inner = (*typing.get_args(inner), inner)[0]
            more = DRIVERS if inner is Driver else [inner] if is_schema(inner) else []
            found += [kind for kind in more if kind not in found]
    return found


ENTRIES = list_entries()
ROOTS = [entry.load().schema for entry in ENTRIES]
# Drivers of parapod's own: those that every machine can name, and those of each machine.
DRIVERS = [kind for kind in Driver.variants().values() if kind.__module__.startswith("parapod.")]
SCHEMAS = list(dict.fromkeys(schema for root in ROOTS for schema in schemas(root)))


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.__name__)
def test_every_key_is_described_with_its_unit(schema):
    assert issubclass(schema, Schema)
    assert schema.__doc__
    assert "Attributes:" in schema.__doc__ or schema.__bases__ != (Schema,)
    texts = describe(schema)
    for name, (kind, rule) in fields_of(schema).items():
        text = texts[name]
        assert text, name
        assert not re.match(r"(of|as|with|where|what|how|likewise)\b", text), (name, text)
        assert "likewise" not in text, (name, text)
        inner, _ = split_optional(kind)
        is_number = float in (inner, *typing.get_args(inner)) and not isinstance(rule, Options)
        assert not is_number or _UNIT.search(text), (name, text)
        unit = re.search(r"_(mm|deg|ms|kg|kpa|khz|mg|rpm|um|m|s|deg_s|mm_s|m_s|mm_s2)$", name)
        assert not unit or _UNIT.search(text), (name, text)
        if is_family(inner):
            assert all(variant.__doc__ for variant in inner.variants().values()), name


@pytest.mark.parametrize("comments", [False, True])
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_default_scenario_is_written_and_read_as_an_equal_one(entry, comments, tmp_path):
    scenario = default_scenario(entry)
    text = dump_scenario(scenario, comments)
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    assert load_scenario(type(scenario), None, file) == scenario
    assert load_scenario(type(scenario), entry.default_scenario, file) == scenario
    assert all(len(line) <= 99 for line in text.splitlines())


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_default_scenario_says_only_what_differs_from_the_schema(entry):
    if entry.default_scenario is None:
        return
    schema = entry.load().schema
    keys = re.findall(r"^( *)(\w+):", entry.default_scenario.read_text(), re.MULTILINE)
    named, path = [], []
    for indent, key in keys:
        path = [*path[: len(indent) // 2], key]
        named.append(".".join(path))
    scenario, default = default_scenario(entry), schema()
    for key in named:
        ours, theirs = scenario, default
        for name in key.split("."):
            ours, theirs = getattr(ours, name), getattr(theirs, name)
        assert ours != theirs, f"{key} is the schema's default"


@pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: driver.__name__)
def test_every_driver_can_be_chosen_by_its_tag(driver):
    override = [f"drivers=[!{driver.__name__} {{}}]"]
    assert load_scenario(HardwareScenario, overrides=override).drivers == [driver()]


def test_a_drivers_setting_is_overridden_by_its_number():
    override = ["hardware.drivers.2.node_ids=[5, 6, 7, 8]"]
    scenario = load_scenario(LevellingScenario, overrides=override)
    assert scenario.hardware.drivers[2].node_ids == [5, 6, 7, 8]
