"""Values put into the text of a scenario file, which otherwise stays as it is."""

import pytest
import yaml

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.yaml_edit import value_at, with_values

LEGS = [{"l_x_mm": 0.1}, {"l_x_mm": 0.2}]
VALUES = {"control.gains": [0.01, 0.02], "control.legs": LEGS}


def data(text):
    return yaml.safe_load(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# nothing yet\n",
        "hardware: {}\n# the end",
        "control:\n  period: 0.01  # tick\n\njob:\n  end: 3\n",
        "control: {period: 0.01}\njob: {end: 3}",
        "control:\n# nothing\njob: {end: 3}\n",
        "control: {}\n",
        "control:\n  gains: [1, 2,\n    3]  # old\n  legs:\n    - {l_x_mm: 3}\n    # between\n"
        "    - l_x_mm: 4\n      l_y_mm: 2  # last\n  pole: 9\njob:\n  end: 3\n",
        "control:\n  legs: []\n  gains:\n    - 1\n    - 2 # two\n",
        "control:\n  gains:\n  legs:\n",
    ],
)
def test_values_are_put_in_and_everything_else_stays(text):
    changed = with_values(text, VALUES)
    before = data(text) or {}
    expected = {**before, "control": {**(before.get("control") or {}), "gains": [0.01, 0.02]}}
    expected["control"]["legs"] = LEGS
    assert data(changed) == expected
    assert data(with_values(changed, VALUES)) == expected


def test_comments_and_order_are_kept():
    text = (
        "# our machine\nhardware: {}  # wires\ncontrol:\n  gains: [1, 2]  # guessed\n"
        "  pole: 9  # slow\n# the end\n"
    )
    assert with_values(text, {"control.gains": [3.5, 4]}) == text.replace("[1, 2]", "[3.5, 4]")
    added = with_values(text, {"control.bias": 0.5})
    assert added == text.replace("# slow\n", "# slow\n  bias: 0.5\n")


def test_tags_of_other_keys_are_kept():
    text = "hardware:\n  drivers:\n    - !NiDaqLegs {target: ''}\n"
    assert with_values(text, {"control.pole": 9}) == f"{text}control:\n  pole: 9\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2]\n", "is not a mapping"),
        ("control: [1]\n", "'control' is not a mapping"),
        ("a: &a {pole: 9}\ncontrol: *a\n", "cannot be changed in its place"),
        ("control: {pole: 9\n", "line"),
    ],
)
def test_a_text_that_cannot_be_changed_in_its_place_is_refused(text, words):
    with pytest.raises(ScenarioError, match=words):
        with_values(text, {"control.gains": [1.0]}, "lab.yaml")


def test_a_value_is_found_by_its_dotted_key():
    assert value_at({"a": {"b": 3}}, "a.b") == 3
    assert value_at({"a": {"b": 3}}, "a.c") is None
    assert value_at(None, "a") is None
