"""Addresses of emulated devices."""

import getpass
import os
import stat
import tempfile
from pathlib import Path

import pytest

from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.addresses import (
    emulator_directory,
    make_emulator_directory,
    resolved,
)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """No environment but that which a test sets."""
    monkeypatch.delenv("PARAPOD_EMULATOR", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.chdir(tmp_path)


def test_the_environment_names_the_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PARAPOD_EMULATOR", "/x/y")
    assert emulator_directory() == Path("/x/y")


def test_otherwise_it_is_in_the_users_runtime_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PARAPOD_EMULATOR", "")
    assert emulator_directory() == tmp_path / "parapod-emulator"


def test_without_one_it_is_a_temporary_one_of_the_users_own(monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/nowhere/at/all")
    mine = Path(tempfile.gettempdir()) / f"parapod-emulator-{getpass.getuser()}"
    assert emulator_directory() == mine


def test_nothing_is_made_by_asking(tmp_path, monkeypatch):
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "new"))
    resolved("emulator/can")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("plant", "why"),
    [
        (lambda path, target: path.symlink_to(target), "is a symbolic link"),
        (lambda path, target: path.mkdir() or path.chmod(0o777), "can be written by other users"),
        (
            lambda path, target: path.mkdir() or os.chown(path, os.getuid() + 1, -1),
            "belongs to another user",
        ),
    ],
    ids=["link", "open to all", "another user's"],
)
def test_a_directory_that_somebody_else_may_have_planted_is_refused(
    tmp_path, monkeypatch, plant, why
):
    target, path = tmp_path / "victim", tmp_path / "planted"
    target.mkdir()
    try:
        plant(path, target)
    except PermissionError:
        pytest.skip("only root can give a folder to another user")
    monkeypatch.setenv("PARAPOD_EMULATOR", str(path))
    with pytest.raises(
        ScenarioError, match=f"^the emulator's folder .*planted.* {why}; remove it"
    ):
        make_emulator_directory()
    assert list(target.iterdir()) == []


def test_a_directory_is_made_for_this_user_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "new" / "one"))
    for _ in range(2):
        assert stat.S_IMODE(make_emulator_directory().stat().st_mode) == 0o700


@pytest.mark.parametrize(
    ("address", "path"),
    [
        ("emulator/can", "/e/can"),
        ("unix:emulator/ni.sock", "unix:/e/ni.sock"),
        ("emulator/deep/er", "/e/deep/er"),
    ],
)
def test_an_emulated_address_is_in_the_directory(monkeypatch, address, path):
    monkeypatch.setenv("PARAPOD_EMULATOR", "/e")
    assert resolved(address) == path


@pytest.mark.parametrize(
    "address",
    [
        "",
        "/dev/ttyACM0",
        "/dev/spidev0.0",
        "can0",
        "unix:/run/ni.sock",
        "host:31763",
        "ip:10.0.0.7",
        "/emulator/can",
        "my-emulator/can",
        "emulator",
        "unix:",
    ],
)
def test_a_real_address_stays_as_it_is(monkeypatch, address):
    monkeypatch.setenv("PARAPOD_EMULATOR", "/e")
    assert resolved(address) == address


def test_resolving_twice_is_resolving_once(monkeypatch):
    monkeypatch.setenv("PARAPOD_EMULATOR", "/e")
    for address in ("emulator/can", "unix:emulator/ni.sock"):
        assert resolved(resolved(address)) == resolved(address)
