"""Messages of the NI gRPC Device Server, as they follow from the signatures of functions.

The numbers of their fields are those of nidaqmx.proto and session.proto in the public repository
ni/grpc-device. The messages are in a pool of their own, beside those of the driver library.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from parapod.systems.core.extras import need

SERVICE = "nidaqmx_grpc.NiDAQmx"

# An enumeration is an int, and so is an unsigned number: below 2^31 they look alike on the wire.
_TYPES = {bool: "BOOL", bytes: "BYTES", float: "DOUBLE", int: "INT32", str: "STRING"}


class Codec(NamedTuple):
    """Translation of a function's messages.

    Attributes:
        decode: gives the arguments of a request by their names; a session has a `name`.
        encode: gives the response of what is returned.
    """

    decode: Callable[[bytes], dict[str, Any]]
    encode: Callable[[Any], bytes]


def codecs(owner: type, functions: Mapping[str, tuple[int, ...]]) -> dict[str, Codec]:
    """Codecs of methods that are functions of the server.

    Args:
        owner: class with a method of each function's name. Its parameters are fields of the
            request; others of the request are skipped. It returns the fields of the response
            behind the status, which is 0: none, one, or a tuple. A class that is no number, text
            or list of them is that of a session.
        functions: number of each parameter's field in the request, by function.

    Raises:
        MissingExtra: Protocol Buffers are not installed.
    """
    protos = need("google.protobuf.descriptor_pb2")
    file = protos.FileDescriptorProto(name="functions.proto", package="parapod", syntax="proto3")

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

    declare("Session", {"name": str}, (1,))
    for function, numbers in functions.items():
        hints = get_type_hints(getattr(owner, function))
        returned = hints.pop("return")
        results = get_args(returned) if get_origin(returned) is tuple else (returned,)
        results = () if returned is type(None) else results
        declare(f"{function}Request", hints, numbers)
        answers = {f"result{k}": result for k, result in enumerate(results, start=2)}
        declare(f"{function}Response", answers, range(2, 2 + len(results)))
    pool = need("google.protobuf.descriptor_pool").DescriptorPool()
    pool.Add(file)
    factory = need("google.protobuf.message_factory")
    classes = factory.GetMessageClassesForFiles([file.name], pool)
    return {
        name: _codec(*(classes[f"parapod.{name}{kind}"] for kind in ("Request", "Response")))
        for name in functions
    }


def _codec(request: Any, response: Any) -> Codec:
    def decode(data: bytes) -> dict[str, Any]:
        message = request.FromString(data)
        return {field.name: getattr(message, field.name) for field in request.DESCRIPTOR.fields}

    def encode(returned: Any) -> bytes:
        results = returned if isinstance(returned, tuple) else (returned,)
        return response(
            **{
                field.name: {"name": result.name} if field.message_type else result
                for field, result in zip(response.DESCRIPTOR.fields, results, strict=False)
            }
        ).SerializeToString()

    return Codec(decode, encode)
