"""Names of places: which mean the same, and which do not."""

import os
import socket
import threading

import pytest

from parapod.systems.hardware import places
from parapod.systems.hardware.exclusive import is_kept, lock_path, only_program
from parapod.systems.hardware.places import normal_form

# Address of a computer by its names, as a name server tells it.
KNOWN = {
    "bench": ["10.9.8.7", "fd00::7"],
    "bench.lab.example": ["fd00::7", "10.9.8.7"],
    "other": ["10.9.8.8"],
    "me": ["127.0.1.1"],
}
CARD = "PXI1Slot2 at "


@pytest.fixture(autouse=True)
def name_server(monkeypatch):
    """Knows the hosts of `KNOWN` and numbers, and nothing else."""

    def ask(host, port, **options):
        numbers = KNOWN.get(host) or [{"localhost": "127.0.0.1"}.get(host, host)]
        flag = socket.AI_NUMERICHOST
        return [found for n in numbers for found in really(n, port, flags=flag, **options)]

    really = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", ask)
    places._computer.cache_clear()
    yield
    places._computer.cache_clear()


@pytest.fixture
def ports(tmp_path, monkeypatch):
    """Files `tty`, `tty2` and `sock`, with links to the first and the last."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "by-id").mkdir()
    for name in ("tty", "tty2", "sock"):
        (tmp_path / name).touch()
    (tmp_path / "adapter").symlink_to("tty")
    (tmp_path / "by-id" / "adapter").symlink_to("../adapter")
    (tmp_path / "link").symlink_to("sock")
    return tmp_path


@pytest.mark.parametrize(
    "names",
    [
        ["{}/tty", "{}/adapter", "{}/by-id/adapter", "{}/by-id/../tty", "{}//tty"],
        ["unix:{}/sock", "unix:{}/link", "unix://{}/sock", "unix:sock"],
        [CARD + "unix:{}/sock", CARD + "unix:{}/link"],
        [
            *(CARD + f"{host}:31763" for host in ("localhost", "LOCALHOST", "localhost.")),
            *(CARD + f"{host}:31763" for host in ("127.0.0.1", "127.1", "[::1]", "0.0.0.0")),
            *(CARD + f"{host}:31763" for host in ("[::ffff:127.0.0.1]", "me", "127.0.1.1")),
            *(CARD + f"dns:{slashes}localhost:31763" for slashes in ("", "///", "//1.1.1.1/")),
            *(CARD + target for target in ("ipv4:127.0.0.1:31763", "ipv6:[::1]:31763")),
        ],
        [CARD + f"{host}:31763" for host in ("bench", "Bench.lab.example", "10.9.8.7")],
        ["/dev/not-there", "/dev/./not-there"],
    ],
)
def test_names_of_one_place_have_one_lock(ports, names):
    assert len({lock_path(name.format(ports)) for name in names}) == 1


def test_other_places_have_other_locks(ports):
    others = [
        *(f"{ports}/tty", f"{ports}/tty2", f"unix:{ports}/tty", f"unix:{ports}/sock"),
        *("can0", "can1", "/dev/spidev0.0", "/dev/spidev0.1", "PXI1Slot2", "PXI1Slot3"),
        *(CARD + f"localhost:{port}" for port in (31763, 31764)),
        *(CARD + f"{host}:31763" for host in ("bench", "other", "10.9.8.9", "nowhere")),
        *("PXI1Slot3 at localhost:31763", CARD + f"unix:{ports}/sock"),
    ]
    assert len({lock_path(name) for name in others}) == len(others)


def test_one_program_shares_a_place_under_two_names(ports):
    with only_program(f"{ports}/adapter"):
        with only_program(f"{ports}/tty"):
            pass
        assert is_kept(f"{ports}/tty")
    assert not is_kept(f"{ports}/tty")


def test_lock_is_given_back_though_its_link_leads_elsewhere_by_then(ports):
    with only_program(f"{ports}/adapter"):
        os.replace(ports / "by-id" / "adapter", ports / "adapter")
        (ports / "adapter").unlink()
        (ports / "adapter").symlink_to("tty2")
        assert not is_kept(f"{ports}/adapter")
        assert is_kept(f"{ports}/tty")
    assert not is_kept(f"{ports}/tty")


def test_name_server_that_does_not_answer_is_not_waited_for(monkeypatch):
    over = threading.Event()
    monkeypatch.setattr(places, "_PATIENCE", 0.01)
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: over.wait() and [])
    try:
        assert normal_form(CARD + "Bench:31763") == CARD + "bench:31763"
    finally:
        over.set()
