"""Packages of the examples, installed beside parapod as a user would."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def command_with(tmp_path_factory):
    """command_with(name): runs the command with a package installed; nothing else is changed."""

    def install(name):
        target = tmp_path_factory.mktemp("installed")
        copy, package = tmp_path_factory.mktemp("source") / name, EXAMPLES / name
        for path in (*package.glob("*.toml"), *package.glob("*/*.py")):
            place = copy / path.relative_to(package)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
        options = ["--quiet", "--no-deps", "--no-build-isolation", "--target", target, copy]
        pip = [sys.executable, "-m", "pip", "install", *map(str, options)]
        subprocess.run(pip, check=True)

        def run(*arguments, program=None):
            how = ["-m", "parapod.sims"] if program is None else ["-c", program]
            return subprocess.run(
                [sys.executable, *how, *map(str, arguments)],
                capture_output=True,
                text=True,
                env=os.environ | {"PYTHONPATH": str(target)},
                cwd=target,
                check=False,
            )

        return run

    return install
