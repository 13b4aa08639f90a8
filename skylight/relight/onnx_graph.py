"""Checks of ONNX graphs before the runtime loads them.

Reads protocol buffers' wire format itself, as relighting needs no ``onnx`` package. Numbers of
fields: onnx.proto, https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
"""

from collections.abc import Iterator

MODEL_BYTES_MAX = 2**24  # the decoder takes 2^22; looking at each field takes time
# arithmetic on tensors alone: nothing that loops, branches, or reads files
OPERATORS = frozenset((
    "Abs", "Add", "BatchNormalization", "Cast", "Clip", "Concat", "Constant", "ConstantOfShape",
    "Conv", "ConvTranspose", "Cos", "DepthToSpace", "Div", "Equal", "Exp", "Expand", "Flatten",
    "Gather", "Gemm", "Identity", "Log", "MatMul", "Max", "Min", "Mul", "Neg", "Pad", "Pow",
    "Range", "Reciprocal", "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceSum", "Relu",
    "Reshape", "Resize", "Shape", "Sigmoid", "Sin", "Slice", "Softmax", "Softplus", "Split",
    "Sqrt", "Squeeze", "Sub", "Sum", "Tanh", "Tile", "Transpose", "Unsqueeze", "Where",
))  # fmt: skip
_GRAPH, _OPSETS, _TRAINING, _FUNCTIONS = 7, 8, 20, 25  # of ModelProto
_NODE, _INITIALIZER, _SPARSE_INITIALIZER = 1, 5, 15  # of GraphProto
_OPERATOR, _ATTRIBUTE, _DOMAIN = 4, 5, 7  # of NodeProto
_TENSOR, _TENSORS, _SUBGRAPHS = 5, 10, (6, 11, 22, 23)  # of AttributeProto; sparse ones too
_EXTERNAL, _LOCATION = 13, 14  # of TensorProto
_STANDARD = (b"", b"ai.onnx")


def require_plain(model: bytes) -> None:
    """Refuse a model that is more than a graph of :data:`OPERATORS` with its weights inside.

    Raises
    ------
    ValueError
        It is damaged, too large, or has custom operators, functions, nested graphs or data in
        other files.
    """
    if len(model) > MODEL_BYTES_MAX:
        raise ValueError(f"{len(model)} bytes are more than the {MODEL_BYTES_MAX} that are read")
    for field, value in _fields(model):
        if field in (_FUNCTIONS, _TRAINING):
            raise ValueError("it has functions of its own")
        if field == _OPSETS:
            _require_standard(next((v for f, v in _fields(_message(value)) if f == 1), b""))
        if field == _GRAPH:
            _require_graph(_message(value))


def _require_graph(graph: bytes) -> None:
    for field, value in _fields(graph):
        if field == _NODE:
            _require_node(_message(value))
        elif field == _INITIALIZER:
            _require_inside(_message(value))
        elif field == _SPARSE_INITIALIZER:
            raise ValueError("it has sparse weights")


def _require_node(node: bytes) -> None:
    for field, value in _fields(node):
        if field == _OPERATOR:
            name = _message(value).decode("utf-8", "replace")
            if name not in OPERATORS:
                raise ValueError(f"it asks for the operator {name!r}")
        elif field == _DOMAIN:
            _require_standard(value)
        elif field == _ATTRIBUTE:
            for part, content in _fields(_message(value)):
                if part in _SUBGRAPHS:
                    raise ValueError("it has graphs within graphs")
                if part in (_TENSOR, _TENSORS):
                    _require_inside(_message(content))


def _require_inside(tensor: bytes) -> None:
    if any(field in (_EXTERNAL, _LOCATION) and value for field, value in _fields(tensor)):
        raise ValueError("its weights lie in another file")


def _require_standard(domain: bytes | int) -> None:
    if _message(domain) not in _STANDARD:
        raise ValueError(f"it asks for operators of {_message(domain)!r}")


def _message(value: bytes | int) -> bytes:
    if not isinstance(value, bytes):
        raise ValueError("damaged: a number where a message belongs")
    return value


def _fields(message: bytes) -> Iterator[tuple[int, bytes | int]]:
    """(number, value) of a message's fields; bytes of what has a length, else a whole number."""
    place = 0
    while place < len(message):
        key, place = _varint(message, place)
        kind = key & 7
        if kind == 0:
            value, place = _varint(message, place)
        elif kind in (1, 5):
            end = place + (8 if kind == 1 else 4)
            value = int.from_bytes(message[place:end], "little")
            place = end
        elif kind == 2:
            length, place = _varint(message, place)
            value = message[place : place + length]
            place += length
        else:
            raise ValueError("damaged: no such kind of field")
        if place > len(message):
            raise ValueError("damaged or cut short")
        yield key >> 3, value


def _varint(message: bytes, place: int) -> tuple[int, int]:
    """(number, where it ends)."""
    value = shift = 0
    while shift < 64:
        if place >= len(message):
            raise ValueError("damaged or cut short")
        byte = message[place]
        value |= (byte & 0x7F) << shift
        place, shift = place + 1, shift + 7
        if byte < 0x80:
            return value, place
    raise ValueError("damaged: an endless number")
