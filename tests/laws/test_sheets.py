"""Laws of the data sheets of all machines: units, similarity, and what is written."""

import copy
import json
import math
import re
import shutil
from dataclasses import fields
from xml.etree import ElementTree

import numpy as np
import pytest

from parapod.diagrams.machine import find_machine
from parapod.sims.cli.main import main
from parapod.sims.sheet.sheet import GROUP, find_sheet
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.installed import installed
from tests.laws.test_designs import parts, settled

SHEETS = sorted({point.name for point in installed(GROUP)})
each_sheet = pytest.mark.parametrize("name", SHEETS)
# Powers of the scale with which lengths, areas, volumes, masses and so on grow: densities,
# accelerations and angles stay, so times grow with the root and speeds do as well.
POWERS = {
    "": 0.0, "deg": 0.0, "mm": 1.0, "m^2": 2.0, "m^3": 3.0, "kg": 3.0, "N": 3.0, "Nm": 4.0,
    "mm/s": 0.5, "m/s": 0.5, "deg/s": -0.5, "N/um": 2.0, "W": 3.5, "s": 0.5, "m/s^2": 0.0,
}  # fmt: skip
KEYS = {
    "_mm": 1.0, "mass_kg": 3.0, "inertia_kg_m2": 5.0, "_N_um": 2.0, "_Nm_rad": 4.0,
    "_m_s_V": 0.5, "_N_V": 3.0, "coulomb_friction": 3.0, "_force_N": 3.0, "_mm_s": 0.5,
    "velocity_m_s": 0.5, "_ms": 0.5, "_duration": 0.5, "thrust_N": 3.0, "torque_Nm": 4.0,
    "capacity_N": 3.0, "speed_m_s": 0.5, "frequency_Hz": -0.5,
    "_deg_s": -0.5,
}  # fmt: skip
# Parts of a scenario, beside the machine, by which its sheet goes: who is carried, and the job.
JOBS = ("passenger", "gait", "panel", "process", "motion", "place", "hip")


def scenario_of(name):
    return find_machine(name).scenario()


def similar(scenario, scale):
    """A scenario whose machine is larger, of the same densities, under the same accelerations."""
    scenario = copy.deepcopy(scenario)
    scenario.machine = settled(scenario.machine)
    jobs = (getattr(scenario, name) for name in JOBS if hasattr(scenario, name))
    for _, part in (each for whole in (scenario.machine, *jobs) for each in parts(whole)):
        for each in fields(part):
            value, powers = getattr(part, each.name), KEYS.items()
            power = next((p for key, p in powers if each.name.endswith(key)), None)
            if value is None or power is None:
                continue
            setattr(part, each.name, (scale**power * np.array(value)).tolist())
    if hasattr(getattr(scenario, "gait", None), "walk_of"):
        walk = scenario.gait.walk_of(scenario.machine.geometry.leg)
        usual = type(scenario)().gait.walk_of(type(scenario)().machine.geometry.leg)
        assert walk.gaits[0].step == pytest.approx(scale * usual.gaits[0].step)
        scenario.gait.phase_duration = scale**0.5 * usual.gaits[0].phase_duration
    return scenario


# Numbers of a URDF by their elements, and the powers of the scale with which they grow.
MODEL = {
    "origin": {"xyz": 1.0}, "mass": {"value": 3.0}, "cylinder": {"radius": 1.0, "length": 1.0},
    "sphere": {"radius": 1.0},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), 5.0),
    "limit": {"lower": 1.0, "upper": 1.0, "velocity": 0.5, "effort": 3.0},
}  # fmt: skip


def scaled_model(path, scale, folder):
    """A larger model of slides, hinges and cylinders, with its loops beside it."""
    root = ElementTree.parse(path).getroot()
    for element in root.iter():
        for name, power in MODEL.get(element.tag, {}).items():
            numbers = np.array(element.get(name).split(), dtype=float)
            element.set(name, " ".join(f"{number:.15g}" for number in scale**power * numbers))
    (folder / "model.urdf").write_bytes(ElementTree.tostring(root))
    shutil.copy(path.with_suffix(".yaml"), folder / "model.yaml")
    return str(folder / "model.urdf")


@each_sheet
def test_entries_say_their_unit_and_have_a_value(name):
    sheet = find_sheet(name)(scenario_of(name))
    entries = sheet.entries()
    assert set(sheet.highlights) <= set(entries)
    for key, entry in entries.items():
        assert entry.meaning, key
        assert entry.unit in POWERS, key
        suffix = "_" + re.sub(r"[/^]", "_", entry.unit).replace("m_2", "m2").replace("m_3", "m3")
        suffix = suffix.replace("s_2", "s2")
        assert key.endswith(suffix) or not entry.unit, key
        assert math.isfinite(sheet.value(key)), key


@each_sheet
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_the_sheet_of_a_similar_machine_is_similar(name, scale, tmp_path):
    scenario, kind = scenario_of(name), find_sheet(name)
    forces, moments = scale**3 * np.array(kind.usual_wrench[:3]), kind.usual_wrench[3:]
    wrench = (*forces.tolist(), *(scale**4 * np.array(moments)).tolist())
    values = kind(scenario).values()
    larger = similar(scenario, scale)
    if hasattr(scenario.machine, "file"):
        larger.machine.file = scaled_model(scenario.machine.path, scale, tmp_path)
    others = kind(larger, wrench).values()
    for key, entry in kind.entries().items():
        expected = scale ** POWERS[entry.unit] * values[key]
        # Heights at work are round millimetres.
        assert others[key] == pytest.approx(expected, rel=0.02, abs=1e-9), key


@each_sheet
def test_an_entry_that_is_not_there_is_named_with_those_that_are(name):
    sheet = find_sheet(name)(scenario_of(name))
    with pytest.raises(ParapodError, match=r"the sheet has no entry 'mass'.*mass_kg"):
        sheet.value("mass")


@each_sheet
def test_the_command_prints_and_writes_the_sheet(name, tmp_path, capsys):
    experiment = find_machine(name).experiment
    page, numbers = tmp_path / "sheet.html", tmp_path / "sheet.json"
    assert main(["sheet", experiment, "--html", str(page), "--json", str(numbers)]) == 0
    printed = capsys.readouterr().out
    written = json.loads(numbers.read_text())
    entries = find_sheet(name).entries()
    assert list(written["entries"]) == list(entries)
    assert all(entry in printed for entry in entries)
    text = page.read_text()
    assert text.count("data:image/svg+xml") >= 2
    assert all(f">{entry}<" in text for entry in entries)


def test_a_machine_that_cannot_be_has_no_sheet(tmp_path, capsys):
    page = tmp_path / "sheet.html"
    options = ["--set", "machine.legs.l_4_mm=900", "--html", str(page)]
    assert main(["sheet", "level", *options]) == 2
    assert "cannot stand level" in capsys.readouterr().err
    assert not page.exists()


def test_an_experiment_without_a_machine_is_refused(capsys):
    assert main(["sheet", "centre-locks"]) == 2
    assert "no machine that has a data sheet" in capsys.readouterr().err
