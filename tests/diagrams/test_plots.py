"""Labels and colours of plots, by the table of ports and the roles of signals."""

import pytest

from parapod.diagrams.machine import find_machine, list_machines
from parapod.diagrams.plots import ASKED, MEASURED, TRUE, Signals, choose, role_of
from parapod.diagrams.ports import Inner
from parapod.diagrams.style import COLOURS
from parapod.systems.core.errors import WiringError

BLUE, ORANGE, GREEN = COLOURS[:3]
PLATFORM = find_machine("levelling_platform")
SIGNALS = Signals(
    "a log",
    {
        "posture_desired_state": 6,
        "attitude_estimated": 2,
        "truth.posture": 3,
        "legs.extension": 4,
        "extension_desired_state": 8,
    },
    {
        name: PLATFORM.unit(name)
        for name in (
            *("posture_desired_state", "attitude_estimated"),
            *("truth.posture", "legs.extension", "extension_desired_state"),
        )
    },
    PLATFORM.element_name,
)


def plot(asked):
    (made,) = choose(SIGNALS, [asked], {})
    return made


def test_a_plot_of_one_quantity_has_its_name_and_the_roles_of_the_curves():
    made = plot("posture_desired_state[1]+attitude_estimated[1]+truth.posture[1]")
    assert made.quantity == "pitch [deg]"
    assert made.legend == (ASKED, MEASURED, TRUE)
    assert made.colours == (BLUE, ORANGE, GREEN)


def test_a_role_has_its_colour_where_another_is_missing():
    assert plot("posture_desired_state[2]+truth.posture[2]").colours == (BLUE, GREEN)
    assert plot("truth.posture[2]").colours == (GREEN,)


def test_elements_of_one_signal_are_told_apart_by_their_names_and_colours():
    made = plot("truth.posture[0:2]")
    assert (made.quantity, made.legend) == ("true posture [deg]", ("roll", "pitch"))
    assert made.colours == (BLUE, ORANGE)


def test_elements_of_several_signals_are_told_apart_by_name_and_role():
    made = plot("attitude_estimated+truth.posture[0:2]")
    assert made.quantity == "[deg]"
    assert made.legend == ("roll measured", "pitch measured", "roll true", "pitch true")


def test_axes_of_a_part_have_the_names_that_its_machine_declares():
    made = plot("legs.extension")
    assert made.quantity == "legs extension [mm]"
    assert made.legend == ("leg 1", "leg 2", "leg 3", "leg 4")


def test_elements_without_names_keep_their_indices():
    made = plot("extension_desired_state[0:2]")
    assert made.quantity == "extension desired state [mm]"
    assert made.legend == ("extension desired state[0]", "[1]")


def test_rates_of_a_state_are_those_of_its_elements():
    made = plot("posture_desired_state[3]")
    assert made.quantity == "rate of roll [deg/s]"


@pytest.mark.parametrize("machine", list_machines(), ids=lambda machine: machine.name)
def test_the_usual_plots_of_a_machine_have_one_colour_a_role(machine):
    signals = {port.name: port.size or 6 for port in machine.table.values()}
    there = Signals(machine.title, signals, {name: machine.unit(name) for name in signals})
    of_roles = {ASKED: BLUE, MEASURED: ORANGE, TRUE: GREEN}
    for made in choose(there, [p for p in machine.view.plots if "[" in p], {}):
        roles = [role_of(curve.signal) for curve in made.curves]
        if len(set(roles)) == len(roles):
            assert made.colours == tuple(of_roles[role] for role in roles)


def test_names_that_do_not_fit_the_size_are_refused():
    with pytest.raises(WiringError, match="'pose' has 4 elements and 3 names"):
        Inner("pose", "m", "a pose", size=4, elements=("x", "y", "z"))
