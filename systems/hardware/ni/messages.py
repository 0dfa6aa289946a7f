"""Messages of the NI gRPC Device Server, as they follow from the signatures of functions."""

from collections.abc import Callable, Mapping
from typing import Any, get_args, get_origin, get_type_hints

from parapod.systems.core.extras import need

SERVICE = "nidaqmx_grpc.NiDAQmx"

# Unsigned numbers and enumerations are an int, too: below 2^31 they look alike on the wire.
_TYPES = {bool: "BOOL", bytes: "BYTES", float: "DOUBLE", int: "INT32", str: "STRING"}

type Codec = tuple[Callable[[bytes], dict[str, Any]], Callable[[Any], bytes]]
"""Gives the arguments in a request, by their names; gives the response of a result."""


def codecs(owner: type, functions: Mapping[str, tuple[int, ...]]) -> dict[str, Codec]:
    """Codecs of methods that are functions of the server.

    They need no part of NI's library, and keep their messages apart from those of it.

    Args:
        owner: class of the methods. Parameters are fields of the request, of which others are
            skipped; what is returned is those of the response behind the status, which is 0:
            None, one, or a tuple. Any class but numbers, texts and lists of these is a session,
            which has a `name`.
        functions: numbers of the parameters in the request, by function: nidaqmx.proto of the
            public repository ni/grpc-device.

    Raises:
        MissingExtra: Protocol Buffers are not installed.
    """
    file = need("google.protobuf.descriptor_pb2").FileDescriptorProto(
        name="functions.proto", package="parapod", syntax="proto3"
    )

    def declare(name: str, fields: Mapping[str, Any], numbers: Any) -> None:
        message = file.message_type.add(name=name)
        for (field, hint), number in zip(fields.items(), numbers, strict=True):
            is_list = get_origin(hint) is list
            kind = _TYPES.get(get_args(hint)[0] if is_list else hint, "MESSAGE")
            message.field.add(
                name=field,
                number=number,
                type=f"TYPE_{kind}",
                label="LABEL_REPEATED" if is_list else "LABEL_OPTIONAL",
                type_name=".parapod.Session" if kind == "MESSAGE" else None,
            )

    declare("Session", {"name": str}, (1,))  # session.proto
    for function, numbers in functions.items():
        hints = get_type_hints(getattr(owner, function))
        returned = hints.pop("return")
        results = get_args(returned) if get_origin(returned) is tuple else (returned,)
        fields = {f"result{k}": hint for k, hint in enumerate(results) if hint is not type(None)}
        declare(f"{function}Request", hints, numbers)
        declare(f"{function}Response", fields, range(2, 2 + len(fields)))
    pool = need("google.protobuf.descriptor_pool").DescriptorPool()
    pool.Add(file)
    factory = need("google.protobuf.message_factory")
    classes = factory.GetMessageClassesForFiles([file.name], pool)
    return {
        name: _codec(classes[f"parapod.{name}Request"], classes[f"parapod.{name}Response"])
        for name in functions
    }


def _codec(request: Any, response: Any) -> Codec:
    def decode(data: bytes) -> dict[str, Any]:
        message = request.FromString(data)
        return {field.name: getattr(message, field.name) for field in request.DESCRIPTOR.fields}

    def encode(returned: Any) -> bytes:
        results = returned if isinstance(returned, tuple) else (returned,)
        fields = {
            field.name: {"name": result.name} if field.message_type else result
            for field, result in zip(response.DESCRIPTOR.fields, results, strict=False)
        }
        return response(**fields).SerializeToString()

    return decode, encode
