import tempfile

import pytest

from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.ni.emulator import NiServer
from parapod.systems.hardware.ni.terminals import LegWiring


@pytest.fixture
def harness():
    sizes = {"voltage": 4, "stop": 1, "extension": 4, "limits": 12, "emergency_stop": 1}
    return Harness({f"legs.{name}": size for name, size in sizes.items()})


@pytest.fixture
def misbehaviour():
    return Misbehaviour()


@pytest.fixture
def serve(harness, misbehaviour):
    """serve(**arguments) gives a server that listens until the test is over."""
    servers = []
    # The path of a Unix socket is short.
    with tempfile.TemporaryDirectory(prefix="ni") as folder:

        def start(product="PXIe-6363", **wires):
            wiring = LegWiring(harness, misbehaviour, **wires)
            server = NiServer(f"{folder}/socket", wiring, product=product)
            servers.append(server)
            return server.__enter__()

        yield start
        for server in servers:
            server.__exit__(None, None, None)


@pytest.fixture
def server(serve):
    return serve()
