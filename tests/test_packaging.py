"""The package is what `pyproject.toml` says, installed from a wheel as well as from the tree."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("systems", "diagrams", "urdf", "sims")


def listed_packages():
    with (ROOT / "pyproject.toml").open("rb") as file:
        return set(tomllib.load(file)["tool"]["setuptools"]["packages"])


def test_every_folder_with_code_or_data_is_a_listed_package():
    folders = {
        file.parent
        for room in ROOMS
        for file in (ROOT / room).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    expected = {"parapod." + ".".join(f.relative_to(ROOT).parts) for f in folders}
    # The public names are those of the package itself.
    assert listed_packages() == expected - {"parapod.sims.public"} | {"parapod"}


def test_rooms_are_not_imported_under_a_second_name():
    import parapod.diagrams.levelling_platform.machine  # noqa: F401

    assert not set(ROOMS) & set(sys.modules)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    # From a copy: setuptools leaves a build folder behind, whose old files go into later wheels.
    folder = tmp_path_factory.mktemp("wheel")
    tree = folder / "tree"
    for room in ROOMS:
        shutil.copytree(ROOT / room, tree / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps"]
    command += ["--no-build-isolation", "--wheel-dir", str(folder), str(tree)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_wheel_holds_the_models_the_scenarios_and_nothing_of_the_tests(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for needed in (
        "parapod/urdf/package.xml",
        "parapod/urdf/levelling_platform/leg.urdf",
        "parapod/urdf/ground/ground.urdf",
        "parapod/urdf/levelling_platform/platform_full.dmd.yaml",
        "parapod/sims/levelling_platform/level.yaml",
        "parapod/systems/py.typed",
    ):
        assert needed in names
    assert not [name for name in names if "tests/" in name or "/test_" in name]
    assert not [name for name in names if name.startswith("systems")]


def test_wheel_installed_elsewhere_runs_the_main_job(wheel, tmp_path):
    site = tmp_path / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
    subprocess.run([*command, "--target", str(site), str(wheel)], check=True)
    program = (
        "import sys; sys.path.insert(0, sys.argv.pop(1))\n"
        "import parapod.sims.cli.main as cli\n"
        "assert cli.__file__.startswith(sys.path[0]), cli.__file__\n"
        "sys.exit(cli.main())"
    )
    arguments = ["run", "level", "--backend", "kinematic", "--json", "level.json"]
    done = subprocess.run(
        [sys.executable, "-c", program, str(site), *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "level.json").is_file()
