"""The worked examples of designs, in small: what is searched for is what rigid bodies do."""

import yaml

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.sims.cli.main import main
from parapod.sims.levelling_platform.sheet import PlatformSheet
from parapod.sims.terrain_simulator.sheet import BenchSheet
from parapod.systems.core.scenario_file import load_scenario

RANGES = {
    "l_c1_mm": "250:450",
    "l_3_mm": "70:110",
    "l_4_mm": "400:520",
    "extension_max_mm": "420:440",
}
VARY = [f"machine.legs.{key}={values}" for key, values in RANGES.items()]
HOLD = ("level_range_deg>=8", "parallelogram_deg>=25", "clearance_mm>=20")


def test_a_platform_that_is_designed_to_level_steeper_ground_does(tmp_path, capsys):
    mine = tmp_path / "mine.yaml"
    goals = ["--vary", *VARY, "--minimise", "footprint_m2", "--hold", *HOLD]
    options = ["--designs", "400", "--workers", "1", "--into", str(mine), "--simulate"]
    assert main(["design", "level", *goals, *options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "all bounds held: 10 of 10" in printed
    assert "level_range_deg: predicted" in printed
    assert set(yaml.safe_load(mine.read_text())) == {"legs"}
    sheet = PlatformSheet(load_scenario(LevellingScenario, machine=mine))
    assert sheet.value("level_range_deg") >= 8.0
    usual = PlatformSheet(load_scenario(LevellingScenario))
    assert sheet.value("footprint_m2") < usual.value("footprint_m2")


def test_a_bench_that_is_designed_for_a_large_box_has_a_larger_one(tmp_path):
    mine = tmp_path / "bench.yaml"
    ranges = ["machine.link_mm=220:320", "machine.strut_mm=320:440"]
    goals = ["--vary", *ranges, "--maximise", "box_area_30_m2", "--hold", "least_sin_mu>=.25"]
    options = ["--designs", "60", "--population", "20", "--workers", "1", "--into", str(mine)]
    assert main(["design", "bench-walk", *goals, *options]) == 0
    usual, larger = (load_scenario(TerrainBenchScenario, machine=path) for path in (None, mine))
    assert usual.machine.geometry.slider_max == larger.machine.geometry.slider_max
    areas = [BenchSheet(scenario).value("box_area_30_m2") for scenario in (usual, larger)]
    assert areas[1] > 1.1 * areas[0]
