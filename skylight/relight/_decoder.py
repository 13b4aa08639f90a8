"""The sky decoder: an ONNX graph run by onnxruntime, and files of its latents; without torch.

A graph is checked before the runtime loads it. As relighting needs no ``onnx`` package, protocol
buffers' wire format is read here; numbers of fields are those of onnx.proto,
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
"""

import math
import reprlib
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from skylight.errors import AssetError, InputError
from skylight.io._bounded import file_bytes, json_content

MODEL_BYTES_MAX = 2**24  # the decoder takes 2^22; looking at each field takes time
# arithmetic on tensors alone: nothing that loops, branches, or reads files
OPERATORS = frozenset((
    "Abs", "Add", "BatchNormalization", "Cast", "Clip", "Concat", "Constant", "ConstantOfShape",
    "Conv", "ConvTranspose", "Cos", "DepthToSpace", "Div", "Elu", "Equal", "Erf", "Exp", "Expand",
    "Flatten", "Gather", "Gelu", "Gemm", "GroupNormalization", "Identity", "InstanceNormalization",
    "LayerNormalization", "LeakyRelu", "Log", "MatMul", "Max", "Min", "Mul", "Neg", "PRelu", "Pad",
    "Pow", "Range", "Reciprocal", "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceSum",
    "Relu", "Reshape", "Resize", "Shape", "Sigmoid", "Sin", "Slice", "Softmax", "Softplus",
    "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Tanh", "Tile", "Transpose", "Unsqueeze", "Where",
))  # fmt: skip
_GRAPH, _OPSETS, _TRAINING, _FUNCTIONS = 7, 8, 20, 25  # of ModelProto
_NODE, _INITIALIZER, _SPARSE_INITIALIZER = 1, 5, 15  # of GraphProto
_OPERATOR, _ATTRIBUTE, _DOMAIN = 4, 5, 7  # of NodeProto
_TENSOR, _TENSORS, _SUBGRAPHS = 5, 10, (6, 11, 22, 23)  # of AttributeProto; sparse ones too
_EXTERNAL, _LOCATION = 13, 14  # of TensorProto
_STANDARD = (b"", b"ai.onnx")


def require_plain(model: bytes) -> None:
    """Refuse a model that is more than a graph of :data:`OPERATORS` with its weights inside."""
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


DECODER_BYTES_MAX = 2**29  # of all decoders together, four times what _BATCH takes
_BATCH = 32
_only_once = threading.Lock()


class SkyDecoder:
    """Latents to skies, by a graph that :func:`skylight.relight._export.export_decoder` wrote.

    ``model`` is the file's path, or its bytes; by default the decoder that comes with skylight.
    ``centre_azimuth_rad`` is where decoded skies have their sun, and ``latents`` how many numbers
    make a sky.
    """

    def __init__(self, model: str | Path | bytes | None = None) -> None:
        import onnxruntime  # slow to import

        if model is None:
            model = Path(str(files("skylight.models") / "data" / "sky_decoder.onnx"))
        name = "decoder" if isinstance(model, bytes) else str(model)
        mend = "write one with: skylight export decoder --out sky_decoder.onnx"
        if not isinstance(model, bytes) and not Path(model).is_file():
            raise AssetError(f"{name}: no sky decoder there; {mend}")
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # what fails is told by the exception
        with _only_once:
            _bound_memory()
        options.add_session_config_entry("session.use_env_allocators", "1")
        try:
            source = model if isinstance(model, bytes) else file_bytes(Path(model))
            require_plain(source)
            self._session = onnxruntime.InferenceSession(
                source,
                options,
                providers=["CPUExecutionProvider"],
                enable_fallback=0,  # to the same again, with a print
            )
            metadata = self._session.get_modelmeta().custom_metadata_map
            self.centre_azimuth_rad = float(metadata["centre_azimuth_rad"])
            ends = [(end.name, end.type) for end in self._session.get_inputs()]
            ends += [(end.name, end.type) for end in self._session.get_outputs()]
            if ends != [(name, "tensor(float)") for name in ("latent", "radiance")]:
                raise ValueError(f"it goes from and to {ends}")
            self.latents = self._session.get_inputs()[0].shape[1]
            if not isinstance(self.latents, int):
                raise ValueError("it does not say how many latents it takes")
            if not math.isfinite(self.centre_azimuth_rad):
                raise ValueError("the sun's column is no number")
        # onnxruntime's exceptions share no base class but Exception
        except Exception as error:
            reason = f" ({error})" if isinstance(error, ValueError) else ""
            raise AssetError(
                f"{name}: damaged, or no sky decoder of skylight{reason}; {mend}"
            ) from error
        self._name = name

    def decode(self, latents: Float32[np.ndarray, "b z"]) -> Float32[np.ndarray, "b 32 128 3"]:
        """Relative radiance (mean luminance about 1) of skies with the sun in the centre column."""
        parts = [latents[i : i + _BATCH] for i in range(0, max(1, len(latents)), _BATCH)]
        try:
            made = [self._session.run(["radiance"], {"latent": part})[0] for part in parts]
            skies = np.concatenate([np.asarray(each) for each in made])
        except Exception as error:  # as above
            reason = str(error).splitlines()[0]
            raise AssetError(f"{self._name}: it cannot be run ({reason})") from error
        if skies.shape != (len(latents), 32, 128, 3):
            raise AssetError(f"{self._name}: no sky decoder, it gives {skies.shape}")
        return skies


@cache
def _bound_memory() -> None:
    """Sessions that use the environment's memory get no more than :data:`DECODER_BYTES_MAX`."""
    import onnxruntime

    limits = {
        "max_mem": DECODER_BYTES_MAX,
        "arena_extend_strategy": 1,  # as much as is asked for
        "initial_chunk_size_bytes": -1,
        "max_dead_bytes_per_chunk": -1,
    }
    onnxruntime.create_and_register_allocator(
        onnxruntime.OrtMemoryInfo(
            "Cpu",
            onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR,
            0,
            onnxruntime.OrtMemType.DEFAULT,
        ),
        onnxruntime.OrtArenaCfg(limits),
    )


LATENT = 64  # of the decoder that ships
_OTHER_DECODER = "0.1."  # versions of skylight whose estimates are latents of another decoder


@dataclass(frozen=True, kw_only=True)
class Latent:
    """Latents of a sky, and what the file says about the rest of the light."""

    z: Float32[np.ndarray, " z"]
    azimuth_rad: float = 0.0
    exposure: float | None = None
    ground_albedo: tuple[float, float, float] | None = None


def read_latent(path: str | Path, count: int = LATENT) -> Latent:
    """A JSON file as :func:`skylight.relight._runtime.relight_files` describes it, of so many
    latents."""
    path = Path(path)
    try:
        content = json_content(path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a JSON file") from error
    except ValueError as error:
        raise InputError(f"{path}: no JSON ({error})") from error
    if isinstance(content, list):
        content = {"latent": content}
    if not isinstance(content, dict) or not {"latent", "params"} & content.keys():
        raise InputError(f'{path}: expected {count} numbers, or an object with "latent"')
    if content.get("light", "autoencoder") != "autoencoder":
        raise InputError(
            f"{path}: the estimate of another light model ({content['light']}); estimate with "
            "--light autoencoder, or relight with the estimate's light probe"
        )
    version = _version_of(content)
    if version.startswith(_OTHER_DECODER):
        raise InputError(
            f"{path}: estimated by skylight {version}, whose sky decoder was another; relight with "
            "the probe.exr beside it, or estimate again"
        )
    if "latent" in content:
        values = _numbers(path, "latent", content["latent"], count)
    else:
        values = _numbers(path, "params", content["params"], count + 1)
    exposure, ground = None, None
    if content.get("exposure") is not None:
        (exposure,) = _numbers(path, "exposure", [content["exposure"]], 1)
        if exposure <= 0:
            raise InputError(f'{path}: "exposure" must be above 0, got {exposure}')
    if content.get("ground_albedo") is not None:
        red, green, blue = ground = _numbers(path, "ground_albedo", content["ground_albedo"], 3)
        if not all(0 <= value <= 1 for value in ground):
            raise InputError(f'{path}: "ground_albedo" must be from 0 to 1, got {ground}')
        ground = red, green, blue
    return Latent(
        z=np.array(values[:count], np.float32),
        azimuth_rad=values[count] if len(values) > count else 0.0,
        exposure=exposure,
        ground_albedo=ground,
    )


def _version_of(content: Mapping[str, object]) -> str:
    """Of skylight, in an estimate.json; "" elsewhere."""
    versions = content.get("versions")
    version = versions.get("skylight") if isinstance(versions, dict) else None
    return version if isinstance(version, str) else ""


def _is_number(value: object) -> bool:
    """A number that float32 can hold."""
    limit = 3.4e38
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < limit


def _numbers(path: Path, name: str, values: object, count: int) -> list[float]:
    """``count`` finite numbers, or an :class:`InputError` that says what is there instead."""
    if not isinstance(values, list) or len(values) != count:
        got = len(values) if isinstance(values, list) else f"a {type(values).__name__}"
        raise InputError(f'{path}: "{name}" must have {count} numbers, got {got}')
    for place, value in enumerate(values):
        if not _is_number(value):
            shown = reprlib.repr(value)
            raise InputError(
                f'{path}: "{name}" has no number for float32 at place {place}: {shown}'
            )
    return [float(value) for value in values]
