"""Addresses of emulated devices."""

import getpass
import tempfile
from pathlib import Path

import pytest

from parapod.systems.hardware.addresses import emulator_directory, resolved


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
