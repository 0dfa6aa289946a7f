"""The machine that the documents build: installed and run as a package of its own."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "three_rps"
PAGE = (ROOT / "docs" / "your_own" / "machine.md").read_text(encoding="utf-8")
LONGEST = 300  # lines of the whole package


def sources():
    return [*PACKAGE.glob("*.toml"), *PACKAGE.glob("parapod_three_rps/*.py")]


@pytest.fixture(scope="module")
def command(command_with):
    """Runs the command with the package installed."""
    return command_with("three_rps")


def test_every_listing_of_the_page_is_a_piece_of_the_package():
    pieces = [path.read_text(encoding="utf-8") for path in sources()]
    listings = re.findall(r"```(?:python|toml)\n(.*?)\n```", PAGE, re.DOTALL)
    *shown, notebook = listings
    assert len(shown) == 6
    for listing in shown:
        assert any(listing in piece for piece in pieces), listing[:200]
    assert "parapod.run" in notebook


def test_the_page_shows_or_links_all_of_the_package():
    shown = set(PAGE.split("\n"))
    linked = {Path(path).name for path in re.findall(r"\]\(\S+?/([\w/]+\.py)\)", PAGE)}
    assert linked == {"kinematics.py"}
    for path in sources():
        text = path.read_text(encoding="utf-8").split("\n")
        left_out = [line for line in text if line.strip() and line not in shown]
        # What the page can do without: imports, constants and `Drawing` of machine.py.
        assert path.name in linked or len(left_out) <= 40, left_out


def test_the_package_is_brief():
    assert sum(len(path.read_text().splitlines()) for path in sources()) <= LONGEST


def test_it_is_listed_under_its_own_heading(command):
    done = command("list")
    assert done.returncode == 0, done.stderr
    heading = done.stdout.index("The 3-RPS platform")
    assert done.stdout.index("rps-tilt", heading) > heading > done.stdout.index("chair-walk")


def test_its_experiment_holds_its_bounds(command, tmp_path):
    files = [tmp_path / "tilt.json", tmp_path / "figures", tmp_path / "tilt.npz"]
    brief = ("--set", "motion.period=3")
    done = command(
        "run", "rps-tilt", *brief, "--json", files[0], "--figures", files[1], "--log", files[2]
    )
    assert done.returncode == 0, done.stderr
    assert all(path.exists() for path in files)
    result = json.loads(files[0].read_text())
    assert result["passed"]
    assert 1e-4 < result["tilt_error_deg"] < 0.1


def test_the_bound_breaks_where_the_platform_turns_too_fast_for_its_legs(command):
    done = command("run", "rps-tilt", "--set", "motion.period=1")
    assert done.returncode == 1, done.stderr
    assert "broken: tilt_error_deg" in done.stdout


def test_mistakes_are_refused_in_one_line(command):
    mistakes = {
        "--set motion.tilt_deg=28": "motion.tilt_deg = 28 exceeds the legs' stroke by 9.6 mm",
        "--set motion.tilt=3": "unknown key 'motion.tilt'; allowed under 'motion': ",
        "--backend multibody": "is not one on which 'rps-tilt' runs; there are: kinematic",
    }
    # All in one process: what is refused is tested, and not how a process begins.
    program = (
        "from parapod.sims.cli.main import main\n"
        f"print(*(main(['run', 'rps-tilt', *each.split()]) for each in {[*mistakes]!r}))"
    )
    done = command(program=program)
    assert done.stdout.split() == ["2"] * len(mistakes), done.stderr
    lines = done.stderr.splitlines()
    for line, said in zip(lines, mistakes.values(), strict=True):
        assert line.startswith("parapod: error: ")
        assert said in line
