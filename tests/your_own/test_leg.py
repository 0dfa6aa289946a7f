"""The leg that the documents put on the bench."""

from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.terrain_simulator.leg import make_leg_model
from parapod.sims.lab.discovery import find_experiment
from parapod.systems.core.scenario_file import load_scenario

PAGE = Path(__file__).parents[2] / "docs" / "your_own" / "leg.md"


@pytest.fixture
def read(reader_of):
    """read(name, *overrides): an experiment and its scenario with the leg of the page."""
    reader_of(PAGE)

    def load(name, *overrides):
        experiment = find_experiment(name)
        return experiment, load_scenario(
            experiment.schema, None, Path("my_leg.yaml"), list(overrides)
        )

    return load


def test_the_leg_bends_as_two_links_of_its_file_do(read):
    _, scenario = read("bench-leg")
    model = make_leg_model(scenario.leg.description)
    hip, knee = model.reach((0.0, -0.5))
    bend = np.arccos(0.25 / 0.3)
    assert (hip, knee) == pytest.approx((bend, -2.0 * bend), abs=1e-9)


def test_it_passes_the_checks_of_its_jump_and_its_walk(read):
    for name, overrides in (
        ("bench-leg", ("hip_mm=500", "mass_kg=20")),
        ("bench-walk", ("place.hip_mm=500", "hip.mass_kg=20", "gait.speed_m_s=0.5")),
    ):
        experiment, scenario = read(name, *overrides)
        assert all(override in PAGE.read_text() for override in overrides)
        experiment.check(scenario)
