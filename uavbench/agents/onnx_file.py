"""Reading the metadata of an ONNX file and where its weights are, without a library and before the model is run.

An ONNX file is a Protocol Buffers message: a sequence of fields, each with a number and a value; some values are messages
themselves (https://protobuf.dev/programming-guides/encoding; the numbers are those of onnx.proto3).
"""

from collections.abc import Iterator

from uavbench.errors import UavbenchError

#: For each kind of message, the numbers of the fields that may contain tensors, and the kind of their values.
_PARTS = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
_METADATA = 14  # the field metadata_props of a model
_ELSEWHERE = (13, 14)  # the fields external_data and data_location of a tensor
_FIXED = {1: 8, 5: 4}  # size in bytes, by wire type


class OnnxFileError(UavbenchError, ValueError):
    """The content of a file is no ONNX model."""


def has_external_data(content: bytes) -> bool:
    """Return whether some of a model's weights are in other files.

    Raises
    ------
    OnnxFileError
        When ``content`` is no ONNX model.
    """
    todo = [("model", memoryview(content))]
    while todo:
        kind, message = todo.pop()
        for number, value in _fields(message):
            if kind == "tensor" and number in _ELSEWHERE and value:
                return True
            if isinstance(value, memoryview) and number in _PARTS[kind]:
                todo.append((_PARTS[kind][number], value))
    return False


def metadata(content: bytes) -> dict[str, str]:
    """Return a model's metadata, by name.

    Raises
    ------
    OnnxFileError
        When ``content`` is no ONNX model.
    """
    entries = [value for number, value in _fields(memoryview(content)) if number == _METADATA and isinstance(value, memoryview)]
    parts = [{number: bytes(value) for number, value in _fields(entry) if isinstance(value, memoryview)} for entry in entries]
    return {part.get(1, b"").decode(errors="replace"): part.get(2, b"").decode(errors="replace") for part in parts}


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield the number and the value of each field: an integer, bytes, or 0 in place of a value of fixed size."""
    at, value = 0, 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == 0:
            value, at = _varint(message, at)
        elif kind == 2:
            size, at = _varint(message, at)
            value, at = message[at : at + size], at + size
        elif kind in _FIXED:
            value, at = 0, at + _FIXED[kind]
        else:
            raise OnnxFileError("it is no ONNX model")
        if number == 0 or at > len(message):
            raise OnnxFileError("it is no ONNX model, or is cut short")
        yield number, value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return the integer that is encoded from ``at`` on, seven bits per byte, lowest first, and where it ends."""
    value = 0
    for k, byte in enumerate(message[at : at + 10]):
        value |= (byte & 127) << 7 * k
        if byte < 128:
            return value, at + k + 1
    raise OnnxFileError("it is no ONNX model, or is cut short")
