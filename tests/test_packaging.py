"""The package is what `pyproject.toml` says, installed from a wheel as well as from the tree."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

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
    assert listed_packages() == expected | {"parapod"}


def test_rooms_are_not_imported_under_a_second_name():
    import parapod.diagrams.levelling_platform.machine  # noqa: F401

    assert not set(ROOMS) & set(sys.modules)


_BESIDE = """
from parapod import add
import parapod, pkgutil, sys
from collections import Counter
from importlib import import_module
from pathlib import Path

clone = Path(__file__).parent / "parapod"
for room in ("systems", "diagrams", "sims"):
    package = import_module(f"parapod.{room}")
    assert Path(package.__file__).is_relative_to(clone), package.__file__
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        import_module(info.name)
assert add is sys.modules["parapod.diagrams.wiring"].add
times = Counter(
    Path(module.__file__).resolve()
    for module in [*sys.modules.values()]
    if getattr(module, "__file__", None) and "site-packages" not in module.__file__
)
ours = [file for file in times if file.is_relative_to(clone.resolve())]
print(len(ours), [str(file) for file in ours if times[file] > 1])
"""


def test_script_beside_a_clone_of_the_same_name_has_every_module_once(tmp_path):
    (tmp_path / "parapod").symlink_to(ROOT)
    script = tmp_path / "script.py"
    script.write_text(_BESIDE)
    done = subprocess.run(
        [sys.executable, str(script)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    count, twice = done.stdout.split(maxsplit=1)
    assert int(count) > 300
    assert twice.strip() == "[]"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    # From a copy: setuptools leaves a build folder behind, whose old files go into later wheels.
    folder = tmp_path_factory.mktemp("wheel")
    tree = folder / "tree"
    for room in ROOMS:
        shutil.copytree(ROOT / room, tree / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("__init__.py", "pyproject.toml", "README.md", "LICENSE"):
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
        "parapod/sims/levelling_platform/level.yaml",
        "parapod/systems/py.typed",
    ):
        assert needed in names
    assert not [name for name in names if "tests/" in name or "/test_" in name]
    tops = {name.split("/")[0] for name in names}
    assert tops == {"parapod", f"{wheel.name.removesuffix('-py3-none-any.whl')}.dist-info"}
    assert {name for name in names if name.count("/") == 1 and name.startswith("parapod/")} == {
        "parapod/__init__.py"
    }


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


def test_the_citation_has_the_packages_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == version("parapod")
    assert citation["title"].startswith("parapod")
