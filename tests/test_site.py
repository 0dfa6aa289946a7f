"""The site's reference holds everything that the code has."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from parapod.diagrams.drivers.driver import Driver
from parapod.sims.cli.main import COMMANDS
from parapod.sims.lab.discovery import list_entries
from parapod.systems.core import schema
from parapod.systems.core.errors import ParapodError
from parapod.systems.levelling_platform.fault_detection import Finding
from tests.laws.conftest import SYSTEMS, TEMPLATES

_ROOT = Path(__file__).parents[1]
_SITE = _ROOT / "docs" / "site"
_ENTRIES = [entry for entry in list_entries() if entry.package == "parapod"]


@pytest.fixture(scope="module")
def reference():
    spec = importlib.util.spec_from_file_location("reference", _SITE / "reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def keys_of(kind, prefix=""):
    """Dotted keys of a schema."""
    for name, (field, _) in schema.fields_of(kind).items():
        inner, _ = schema.split_optional(field)
        yield f"{prefix}{name}"
        if schema.is_schema(inner) and not schema.is_family(inner):
            yield from keys_of(inner, f"{prefix}{name}.")


def test_every_system_has_its_symbol_and_table(reference):
    pages = dict(reference.systems())
    text = "\n".join(page for name, page in pages.items() if name != "systems/index.md")
    headings = set(re.findall(r"^## (\w+)$", text, re.MULTILINE))
    symbols = set(re.findall(r'class="name">(\w+)<', text))
    assert headings == symbols
    assert set(SYSTEMS) <= headings
    assert text.count("| port | size | unit | meaning |") == len(headings)
    for package in re.findall(r"^(\w+)$", pages["systems/index.md"].split("maxdepth: 1")[1], re.M):
        assert f"systems/{package}.md" in pages


def test_systems_say_whether_they_convert(reference):
    pages = dict(reference.systems())
    text = "\n".join(page for name, page in pages.items() if name != "systems/index.md")
    parts = dict(re.findall(r"^## (\w+)$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    converting = {name for name, part in parts.items() if "\nConverts to AutoDiffXd.\n" in part}
    assert converting == set(TEMPLATES) & set(parts)


def test_indices_describe_every_page_and_name_every_system(reference):
    pages = dict(reference.all_pages())
    pages_of_one = {"systems/index.md", "errors.md", "findings.md"}
    listed = re.findall(r"^\* \[(.*?)\]\((.*?)\): (.*)$", pages["index.md"], re.MULTILINE)
    assert all(re.match(r"\S.{10,}\.$", described) for _, _, described in listed)
    linked = {page.partition("#")[0] for _, page, _ in listed} | {
        "systems/index.md",
        *pages_of_one,
    }
    indices = {"index.md", "scenarios/index.md", "diagrams/index.md"}
    assert linked == {name for name in pages if name.endswith(".md")} - indices
    assert [name.strip("`") for name, page, _ in listed if page.startswith("commands")] == [
        f"parapod {name}" for name in COMMANDS
    ]
    for page in linked - {"commands.md", *pages_of_one}:
        folder, _, name = page.partition("/")
        assert name.removesuffix(".md") in pages[f"{folder}/index.md"]
    systems = re.findall(r"^\* \[(\w+)\]\((\w+\.md)#", pages["systems/index.md"], re.MULTILINE)
    for name, page in systems:
        assert f"\n## {name}\n" in pages[f"systems/{page}"], name
    assert set(SYSTEMS) <= {name for name, _ in systems}


def test_keys_stand_in_tables_that_narrow_screens_can_fold(reference):
    (level,) = (entry for entry in _ENTRIES if entry.name == "level")
    text = reference._scenario(level)
    assert text.count(":::{div} keys\n| key | default |") == text.count("| key | default |") > 1
    style = (_SITE / "static" / "site.css").read_text()
    folded = style.partition("@media screen and (max-width: 46em) {")[2].partition("\n}")[0]
    assert ".keys tr { display: flex" in folded


def test_every_setting_of_every_driver_has_a_meaning(reference):
    drivers = {
        name: kind
        for name, kind in Driver.variants().items()
        if kind.__module__.startswith("parapod.")
    }
    text = "\n".join(reference._scenario(entry) for entry in _ENTRIES)
    tables = dict(re.findall(r"^### !(\w+)$(.*?)(?=^##|\Z)", text, re.MULTILINE | re.DOTALL))
    assert tables.keys() >= drivers.keys()
    for name, kind in drivers.items():
        for key in schema.fields_of(kind):
            row = rf"^\| `{key}` \|.*\| [^|]+ \|$"
            assert re.search(row, tables[name], re.MULTILINE), f"{name}.{key}"


def test_every_finding_has_its_row(reference):
    (page,) = (page for name, page in reference.all_pages() if name == "findings.md")
    rows = set(re.findall(r"^\* `(\w+)`: .+; \w+, within [\d.]+ s, .+$", page, re.MULTILINE))
    assert rows == {finding.name.lower() for finding in Finding}


def test_a_picture_of_a_loop_is_as_wide_as_its_page_and_one_has_all_ports(reference):
    pytest.importorskip("pygraphviz")
    pages = dict(reference.diagrams())
    overview, whole = (pages[f"diagrams/walking_chair{end}.svg"] for end in ("", "_ports"))
    assert re.search(rb'<svg [^>]*width="100%"\s+viewBox', overview)
    assert overview.count(b'class="edge"') < whole.count(b'class="edge"')
    page = pages["diagrams/walking_chair.md"]
    assert 'data="walking_chair.svg"' in page
    assert 'href="walking_chair_ports.svg"' in page


def conf():
    """Settings of Sphinx as a module."""
    spec = importlib.util.spec_from_file_location("conf", _SITE / "conf.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_formulas_become_mathml_without_a_script_or_a_network():
    pytest.importorskip("math_core")
    mathml = conf().mathml
    assert mathml(r"g = R^\top n", False) == (
        "<math><mi>g</mi><mo>=</mo><msup><mi>R</mi><mi>⊤</mi></msup><mi>n</mi></math>"
    )
    block = mathml(r"a &= b \\ c &= d", True)
    assert block.startswith('<math display="block"')
    assert block.count("<mtr>") == 2
    # Sphinx numbers a block; its lines have no numbers beside that.
    numbered = mathml(r"\begin{align} a &= b \\ c &= d \end{align}", True)
    assert "(1)" not in re.sub("<[^>]*>", "", numbered)


def test_a_mistake_in_a_formula_is_an_error():
    core = pytest.importorskip("math_core")
    with pytest.raises(core.LatexError, match="foo"):
        conf().mathml(r"\foo x", False)


def test_classes_of_arguments_are_described_and_drakes_words_are_left_out(reference):
    pages = dict(reference.systems())
    text = "\n".join(pages.values())
    assert "Overloaded function" not in text
    assert "SystemScalarConverter" not in text
    sensors = pages["systems/sensors.md"]
    described = sensors[sensors.index("### ImuParams") :].partition("\n### ")[0]
    for word in ("gyro_noise_density: float = 0.000235619,", "rad/s/sqrt(Hz)", "data sheet"):
        assert word in described
    assert not re.search(r"^- `\s", text, re.MULTILINE)  # a line that goes on is no entry
    for name in re.findall(r"= ([A-Z]\w+)\(\.\.\.\)", text):
        assert f"### {name}\n" in text, name


def test_every_system_shows_the_arguments_that_it_takes(reference):
    pages = dict(reference.systems())
    text = "\n".join(pages.values())
    assert "**kwargs" not in text
    actuators = pages["systems/actuators.md"]
    pi = actuators[actuators.index("```python\nPiController(") :]
    assert re.findall(r"^    (.*),$", pi.partition("\n)")[0], re.MULTILINE) == [
        "params: PiControllerParams = PiControllerParams(...)",
        "channels: int = 4",
        "period: float = 0.01",
    ]
    for name in ("LinearActuatorParams", "PiControllerParams"):
        assert f"\n### {name}\n" in actuators
    assert "* `gain_scale`: factor (n or scalar) of the nominal motor constants" in actuators
    assert "* `converter`" not in text


def test_a_symbol_has_inputs_left_and_outputs_right(reference):
    (page,) = (text for name, text in reference.systems() if name == "systems/actuators.md")
    symbol = re.search(r'<div class="block-symbol">.*name">PiController<.*', page)[0]
    left, right = symbol.split("PiController")
    assert re.findall(r"<span>(\w+)<", left) == ["desired_state", "measured", "enable"]
    assert re.findall(r"<span>(\w+)<", right) == ["voltage"]


@pytest.mark.parametrize("entry", _ENTRIES, ids=lambda entry: entry.name)
def test_every_key_of_a_scenario_has_its_meaning(reference, entry):
    text = reference._scenario(entry)
    rows = dict(re.findall(r"^\| \**`([\w.]+)`\** \|(.*)\|$", text, re.MULTILINE))
    for key in keys_of(entry.load().schema):
        default, admissible, meaning = re.split(r"(?<!\\)\|", rows[key])
        assert meaning.strip(), key
        assert admissible.strip() or not default.strip(), key


def test_a_key_is_told_with_default_range_and_unit(reference):
    (level,) = (entry for entry in _ENTRIES if entry.name == "level")
    text = reference._scenario(level)
    assert "| `ground.roll_deg` | `2.0` | -15..15 | roll of the ground [deg]. |" in text
    assert "### !Epos2Wheels" in text


def test_every_command_and_error_is_there(reference):
    ((_, commands),) = reference.commands()
    assert re.findall(r"^### parapod (\S+)$", commands, re.MULTILINE) == [*COMMANDS]
    assert commands.count("usage: parapod ") == 1 + len(COMMANDS)
    assert "--vary" in commands
    ((_, errors),) = reference.errors()
    told = set(re.findall(r"^#+ (\w+)$", errors, re.MULTILINE))

    def kinds(kind):
        yield kind
        for inner in kind.__subclasses__():
            yield from kinds(inner)

    named = {k.__name__ for k in kinds(ParapodError) if k.__module__.startswith("parapod.")}
    assert {name for name in named if not name.startswith("_")} <= told


def test_a_docstring_becomes_markdown(reference):
    arguments = "Args:\n    a: one number\n        and more.\n    b: two.\n"
    text = f"Adds.\n\n{arguments}\nRaises:\n    E: no.\n"
    assert reference.as_markdown(text) == (
        "Adds.\n\n\n**Args**\n\n* `a`: one number\n  and more.\n* `b`: two.\n\n\n**Raises**\n\n"
        "* `E`: no."
    )


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_needs_no_network(tmp_path):
    pytest.importorskip("myst_nb")
    pytest.importorskip("furo")
    command = [sys.executable, _SITE / "build.py", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    for page in (tmp_path / "html").rglob("*.html"):
        parts = re.findall(r"<(?:script|img|link|object)[^>]*>", page.read_text())
        loaded = re.findall(r'(?:src|href|data)="(\w+:)', "".join(parts))
        assert not [scheme for scheme in loaded if scheme != "data:"], page


def test_links_to_the_example_stay_inside_the_site(tmp_path):
    spec = importlib.util.spec_from_file_location("build", _SITE / "build.py")
    build = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(_SITE))
    try:
        spec.loader.exec_module(build)
    finally:
        sys.path.remove(str(_SITE))
    page = _ROOT / "docs" / "your_own" / "machine.md"
    assert "](../../examples" in page.read_text()
    assert "](../../examples" not in build._adapted(page)
