"""An NI gRPC Device Server with one X Series card, as NI-DAQmx shows it, on a Unix socket."""

import threading
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import monotonic, sleep, wait
from parapod.systems.hardware.ni.daqmx import FUNCTIONS, NiCard, NiRefusal
from parapod.systems.hardware.ni.messages import SERVICE, Codec, codecs
from parapod.systems.hardware.ni.terminals import NiWiring

# Time between two looks at whether it may answer, or whether its cable is in its place [s].
_POLL = 0.002

# Calls that hang occupy a thread each until their caller gives up.
_THREADS = 32


class NiServer:
    """An NI gRPC Device Server that knows the functions of NI-DAQmx that a controller needs.

    It answers every other function UNIMPLEMENTED, and refuses as the driver does: with the
    error's number in the trailing metadata "ni-error" and its description as text. It runs in a
    thread of its own, from the beginning of a `with` block to its end.

    Misbehaviour: while the device does not answer, calls hang until it does or their deadline is
    over, and are not carried out in that case; while it is unplugged, none listens at the
    socket; everything else changes what counters and inputs show. Tasks and outputs stay, and a
    watchdog that nothing can reset expires.

    Attributes:
        calls: number of calls of each function.
        card: the card.
        wiring: machine to which the card is connected.
        target: the server's address, for a gRPC channel.
    """

    def __init__(
        self,
        path: str | Path,
        wiring: NiWiring,
        device: str = "PXI1Slot2",
        product: str = "PXIe-6363",
    ):
        """Creates a server that does not listen yet.

        Args:
            path: path of the socket; at most some 100 characters.
            wiring: machine to which the card is connected; its misbehaviour is the server's.
            device: the card's name.
            product: the card's type; those of the X Series have a watchdog.

        Raises:
            MissingExtra: gRPC or the driver library is not installed.
        """
        self._grpc = need("grpc")
        self.wiring, self._misbehaviour = wiring, wiring.misbehaviour
        self.card = NiCard(wiring, device, product)
        self.calls: Counter[str] = Counter()
        self.target = f"unix:{path}"
        self._handlers = {
            name: self._handler(name, codec) for name, codec in codecs(NiCard, FUNCTIONS).items()
        }
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="ni-server")
        self._server: Any = None
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="ni-cable", daemon=True)

    def __enter__(self) -> Self:
        self._listen()
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._watcher.join()
        self._hang_up()
        self._pool.shutdown()

    def service(self, details: Any) -> Any:
        """The handler of a call, as gRPC asks for it; None: there is none."""
        service, _, function = details.method.lstrip("/").partition("/")
        self.calls[function] += 1
        return self._handlers.get(function) if service == SERVICE else None

    def _listen(self) -> None:
        self._server = self._grpc.server(self._pool)
        self._server.add_generic_rpc_handlers((self,))
        self._server.add_insecure_port(self.target)
        self._server.start()

    def _hang_up(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.stop(None).wait()

    def _watch(self) -> None:
        """Listens while the cable is in its place, and lets the card do what is due by itself."""
        while not wait(self._closing, _POLL):
            self.card.advance()
            if self._misbehaviour.is_unplugged and self._server is not None:
                self._hang_up()
            elif self._server is None and not self._misbehaviour.is_unplugged:
                self._listen()

    def _handler(self, function: str, codec: Codec) -> Any:
        def answer(arguments: Mapping[str, Any], context: Any) -> Any:
            self._wait(context)
            try:
                return self.card.call(function, arguments)
            except NiRefusal as refusal:
                context.set_trailing_metadata((("ni-error", str(refusal.code)),))
                context.abort(self._grpc.StatusCode.UNKNOWN, str(refusal))

        return self._grpc.unary_unary_rpc_method_handler(answer, *codec)

    def _wait(self, context: Any) -> None:
        """Waits until the card answers; ends the call if it never does."""
        while context.is_active() and not self._misbehaviour.answers(monotonic()):
            if self._misbehaviour.is_unplugged or self._closing.is_set():
                context.abort(self._grpc.StatusCode.UNAVAILABLE, "the cable is out")
            sleep(_POLL)
        if not context.is_active():
            context.abort(self._grpc.StatusCode.CANCELLED, "the caller has given up")
