"""Limits that machines declare for plots, against numbers of the papers and of their settings."""

from operator import attrgetter

import numpy as np
import pytest

from parapod.diagrams.machine import find_machine

# By machine: settings that differ from the usual ones, and limits in the signals' units.
DECLARED = {
    "levelling_platform": (
        {"machine.actuators.supply_voltage": 12.0},
        # Stroke of section 2.
        {"legs.extension": (0.38, 0.46), "truth.extension": (0.38, 0.46)}
        | {"legs.voltage": (-12.0, 12.0)},
    ),
    "machining_centre": (
        {"machine.legs.max_velocity_mm_s": 90.0, "machine.legs.max_force_N": 800.0},
        {"legs.position": (0.39, 0.65), "legs.velocity": (-0.09, 0.09)}
        | {"truth.leg_force": (-800.0, 800.0), "legs.current": (-3.2, 3.2)},
    ),
    "terrain_simulator": (
        {"hip.max_force_N": 900.0, "machine.sliders.max_velocity_m_s": 2.0},
        {"sliders.position": (0.08, 1.12), "sliders.velocity": (-2.0, 2.0)}
        | {"sliders.current": (-40.0, 40.0), "hip.force_command": (-900.0, 900.0)}
        | {"hip.position": (0.42, None), "leg.torque_command": (-250.0, 250.0)},
    ),
    "walking_chair": (
        {"machine.drives.max_velocity_mm_s": 60.0, "control.support_margin_mm": 15.0},
        # Strokes of Table 1, F_N of Eq. (53) at the rated 3 A.
        {"legs.position": ([0.5914, 0.574, 0.574] * 4, [0.8914, 0.874, 0.874] * 4)}
        | {"legs.velocity": (-0.06, 0.06), "legs.current": (-3.0, 3.0)}
        | {"truth.force": (-427.3, 427.3), "support_margin": (0.015, None)},
    ),
}


@pytest.mark.parametrize("name", DECLARED)
def test_limits_are_those_of_drawings_and_settings(name):
    settings, expected = DECLARED[name]
    machine = find_machine(name)
    scenario = machine.scenario()
    for key, value in settings.items():
        part, _, name_of_field = key.rpartition(".")
        setattr(attrgetter(part)(scenario), name_of_field, value)
    limits = machine.for_scenario(scenario).all_limits(scenario)
    for signal, ends in expected.items():
        for found, end in zip(limits[signal], ends, strict=True):
            assert (found is None) == (end is None), signal
            if end is not None:
                np.testing.assert_allclose(found, end, rtol=1e-9, err_msg=signal)
