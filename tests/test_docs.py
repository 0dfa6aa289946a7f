"""What the documents take from the code is what the code says."""

import contextlib
import importlib
import inspect
import pkgutil
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import parapod.systems
from parapod.diagrams.drivers.cia402 import Epos2PositionScrews
from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.machine import list_machines
from parapod.diagrams.walking_chair.drivers import Epos2Legs
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.sims.cli.arguments import load
from parapod.sims.cli.main import main, make_parser
from parapod.sims.lab.discovery import find_entry
from parapod.systems.core import schema
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.controller import Timing
from parapod.systems.hardware.cia402.makers import EPOS2
from parapod.systems.hardware.cia402.set_up import outputs_pdo, reports
from parapod.systems.hardware.cia402.settings import AxesSettings, Control
from parapod.systems.hardware.cia402.switches import switches_of_limbs
from parapod.systems.hardware.emulation.harness import KINDS
from parapod.systems.levelling_platform.supervisor import as_mermaid

_DOCS = Path(__file__).parents[1] / "docs"
_README = _DOCS.parent / "README.md"
_OPERATION = (_DOCS / "operation.md").read_text()
_GLOSSARY = (_DOCS / "glossary.md").read_text()
_HARDWARE = "\n".join(page.read_text() for page in (_DOCS / "hardware").glob("*.md"))
LEVEL = find_entry("level")


def quoted_commands():
    """Commands of all documents, and what is said to be printed by each: page, command, lines."""
    for page in (_README, *sorted(_DOCS.rglob("*.md"))):
        blocks = re.findall(r" *```(?:sh|bash|console)\n(.*?)```", page.read_text(), re.DOTALL)
        for block in blocks:
            said = None
            for line in re.sub(r"\s*\\\n\s*", " ", block).splitlines():
                found = re.fullmatch(r"\s*(?:\$ )?(?:\.venv/bin/)?parapod ([a-z].*)", line)
                if found:
                    command, said = shlex.split(found[1], comments=True), []
                    yield pytest.param(page, command, said, id=f"{page.stem}: {' '.join(command)}")
                elif said is not None:
                    said.append(line.strip())


@pytest.mark.parametrize(("page", "command", "said"), [*quoted_commands()])
def test_a_quoted_command_is_understood_and_refused_with_the_quoted_words(
    page, command, said, capsys, reader_of
):
    if "rps-tilt" in command:
        pytest.skip("its package is installed by tests/your_own/test_machine.py alone")
    reader_of(page)
    if said and said[0].startswith("parapod: error: "):
        assert main(command) == 2
        words = map(re.escape, re.split(r"\s*\.\.\.", said[0]))
        assert re.match(".*".join(words), capsys.readouterr().err)
        return
    arguments = make_parser().parse_args(command)
    # Files that the reader has.
    own = any(re.search(r"\.(yaml|urdf|py)$", w) and not Path(w).exists() for w in command)
    if hasattr(arguments, "overrides") and arguments.name and not own:
        load(arguments)


# Commands that need devices or a person, or do not end by themselves.
_ATTENDED = ("emulate", "operate", "home", "check", "adopt", "bench-rt")
# What a command would need besides.
_ELSEWHERE = ("hardware", "--cluster", "rps-tilt", "first.mcap")


def _runnable(command):
    """The command as it ends by itself, within its page's folder; None: it cannot be run here."""
    if command[0] in _ATTENDED or set(_ELSEWHERE) & set(command):
        return None
    if command[0] == "plot" and "--out" not in command:
        return None
    # Watching takes as long as what is watched; twenty seeds and a grid show no more than two.
    brief = [re.sub(r"(\d):\d+$", r"\1:2", word) for word in command if word != "--meshcat"]
    if "--seeds" in brief:
        brief[brief.index("--seeds") + 1] = "2"
    if command[0] == "replay" and "--html" not in brief:
        brief += ["--html", "page.html"]
    return brief


def quoting_pages():
    """Pages with the commands that can be run, in their order."""
    pages = {}
    # What is printed is known once all are.
    for page, command, said in [param.values for param in [*quoted_commands()]]:
        brief = None if said and said[0].startswith("parapod: error: ") else _runnable(command)
        if brief is not None:
            pages.setdefault(page, []).append(brief)
    return [pytest.param(page, each, id=page.stem) for page, each in pages.items()]


@pytest.mark.slow
@pytest.mark.parametrize(("page", "commands"), quoting_pages())
def test_the_commands_of_a_page_do_what_they_say(page, commands, reader_of, capsys):
    reader_of(page)
    for command in commands:
        is_faulty = any(word.startswith("faults=") for word in command)
        # A study asks where bounds break.
        expected = (0, 1) if command[0] == "study" else (int(is_faulty),)
        assert main(command) in expected, (command, capsys.readouterr())
        said = capsys.readouterr().out
        for option in ("--html", "--log", "--json", "--out", "--figures"):
            if option in command:
                assert Path(command[command.index(option) + 1]).exists(), (command, said)


def test_the_phases_are_drawn_from_the_table_of_transitions():
    assert f"```mermaid\n{as_mermaid()}\n```" in _OPERATION


def test_every_driver_is_in_the_table():
    text = _HARDWARE
    own = {n for n, kind in Driver.variants().items() if kind.__module__.startswith("parapod.")}
    assert len(own) >= 8
    for name in own:
        assert re.search(rf"^\| .*`!{name}`.* \| ", text, re.MULTILINE)


def frame_bits(size):
    """Bits of a data frame in the worst case (ISO 11898-1), with the pause after it.

    Of the 34 + 8 n bits from its start to its checksum every fourth but the first is a stuff bit.
    """
    return 47 + 8 * size + (33 + 8 * size) // 4


def bus_load(settings, period):
    """Largest share of the bus's time: SYNC, its answers, a command each, and a heartbeat."""
    cycle = frame_bits(0) + len(settings.node_ids) * frame_bits(
        objects.PROFILE_VELOCITY.command.size
    )
    cycle += sum(frame_bits(pdo.size) for i in settings.node_ids for pdo in reports(settings, i))
    heartbeat = frame_bits(1) / max(period, Timing().heartbeat_period)
    return (cycle / period + heartbeat) / settings.bitrate


def test_frames_take_as_many_bits_as_in_the_worst_case():
    # 8 bytes: 111 bits with the pause, and 24 stuff bits; none: 47 + 8.
    assert [frame_bits(size) for size in (0, 1, 6, 8)] == [55, 65, 115, 135]


def test_the_load_of_the_chairs_bus_is_what_its_driver_makes_of_it():
    load, slow = (bus_load(Epos2Legs(bitrate=b), 0.01) for b in (1_000_000, 500_000))
    text = " ".join(_HARDWARE.split())
    assert (
        f"that is {10.0 * load:.1f} ms of a period of 10 ms, a load of {100.0 * load:.0f} %"
        in text
    )
    assert f"At 500 kbit/s it would be {100.0 * slow:.0f} %" in text
    # One of the frames has the digital inputs as well.
    reading = frame_bits(0) + 23 * frame_bits(6) + frame_bits(8)
    assert f"of which the readings are {1e-3 * reading:.1f} ms" in text


def test_the_load_of_eight_legs_with_switches_is_what_the_documents_say():
    settings = Epos2PositionScrews(node_ids=[*range(1, 9)], **switches_of_limbs(4))
    commands = (EPOS2.modes[Control.POSITION][0].target, outputs_pdo(AxesSettings()))
    each = [pdo for i in settings.node_ids for pdo in (*reports(settings, i), *commands)]
    assert len(each) == 8 * 4
    cycle = frame_bits(0) + sum(frame_bits(pdo.size) for pdo in each)
    share = (cycle / 0.01 + frame_bits(1) / Timing().heartbeat_period) / settings.bitrate
    text = " ".join(_HARDWARE.split())
    assert f"{1e-3 * cycle:.1f} ms at 1 Mbit/s, a load of {100.0 * share:.0f} % at 100" in text


def test_the_screws_with_locks_and_clamps_are_those_of_three_limbs(tmp_path):
    (example,) = re.findall(
        r"```yaml\n(hardware:\n.*?!Epos2PositionScrews\n.*?)```", _HARDWARE, re.DOTALL
    )
    example = example[example.rindex("hardware:") :]
    file = tmp_path / "lab.yaml"
    file.write_text(example)
    (driver,) = load_scenario(LevellingScenario, file).hardware.drivers
    given = switches_of_limbs(3)
    assert {name: getattr(driver, name) for name in given} == given
    device = driver.make(PartPorts({"emergency_stop": 1}, {}))
    assert device.measures["locks.closed"] == 12


def test_forces_are_measured_and_commanded_as_the_examples_say(tmp_path):
    text, drivers = _HARDWARE, []
    for tag in ("NiDaqForceCells", "Epos2ForceSlides"):
        (example,) = re.findall(
            rf"```yaml\n(hardware:\n  drivers:\n    - !{tag}\n.*?)```", text, re.DOTALL
        )
        file = tmp_path / f"{tag}.yaml"
        file.write_text(example)
        drivers += load_scenario(LevellingScenario, file).hardware.drivers
    devices = [driver.make(PartPorts({}, {})) for driver in drivers]
    assert [device.commands for device in devices] == [
        {},
        {"force_command": 1, "brake": 1},
        {"torque_command": 2, "brake": 1},
    ]
    assert devices[0].measures == {"force": 3}
    assert drivers[1].max_velocity == pytest.approx(1.0)
    step = 20.0 / 2**16
    assert f"converter is {1e3 * step:.2f} mV" in " ".join(text.split())
    assert f"or {200.0 * step:.2f} N with 200 N/V" in " ".join(text.split())


def test_what_the_limits_allow_is_what_the_documents_say():
    (driver,) = CHAIR.drivers(CHAIR.scenario())
    limits = driver.limits
    text = " ".join(_HARDWARE.split())
    shown = []
    for distance in (0.01, 0.001):
        position = [upper - distance for upper in limits.upper]
        shown.append(1e3 * limits.allowed((1.0,) * 12, position)[0])
    fast, slow = shown
    assert f"At 10 mm from a limit {fast:.0f} mm/s are allowed, at 1 mm {slow:.1f} mm/s" in text


# --- studies

_STUDIES = (_DOCS / "studies.md").read_text()


def test_every_form_of_values_that_the_documents_show_is_understood():
    from parapod.sims.study.variables import read_variables, split_variable
    from parapod.systems.core.schema import checked

    shown = re.findall(r"^\| `'?([\w.]+=[^`']+)'?` \|", _STUDIES, re.MULTILINE)
    assert len(shown) == 7
    for text in shown:
        key, values = split_variable(text)
        (variable,) = read_variables(
            LevellingScenario, checked(LevellingScenario()), {key: values}
        )
        assert len(variable.at(np.linspace(0.0, 1.0, 5))) == 5


def names_of_the_code():
    """Functions, classes and their attributes, ports of all machines, keys of scenarios."""
    for info in pkgutil.walk_packages(parapod.systems.__path__, "parapod.systems."):
        if ".hardware" in info.name or ".mujoco" in info.name:
            continue
        for name, value in vars(importlib.import_module(info.name)).items():
            yield name
            if isinstance(value, type):
                keys = getattr(value, "__dataclass_fields__", getattr(value, "_fields", ()))
                yield from (f"{name}.{key}" for key in keys)
            elif callable(value):
                with contextlib.suppress(ValueError, TypeError):
                    yield from inspect.signature(value).parameters
    for machine in list_machines():
        yield from machine.table
        yield from _keys(machine.scenario)


def _keys(kind, prefix=""):
    for name, (field, _) in schema.fields_of(kind).items():
        yield f"{prefix}{name}"
        inner, _ = schema.split_optional(field)
        if schema.is_schema(inner) and not schema.is_family(inner):
            yield from _keys(inner, f"{prefix}{name}.")


def test_symbols_of_the_glossary_are_called_so_in_the_code():
    rows = re.findall(r"^\| (.*) \| (.*) \| (.*) \| (.*) \|$", _GLOSSARY, re.MULTILINE)
    said = [name for *_, code, _ in rows for name in re.findall(r"`([\w.]+)[^`]*`", code)]
    assert len(said) > 50
    assert {*said} - {*names_of_the_code()} - {"X_AB", "R_AB", "p_AB"} == set()


def test_every_kind_of_fault_is_told_of_in_its_table():
    rows = re.findall(r"^\| (\w+) \| ", (_DOCS / "faults.md").read_text(), re.MULTILINE)
    assert rows[: len(KINDS) + 1] == ["kind", *KINDS]
