"""ONNX: what is asked of a graph before the runtime sees it, and decoders that pass."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from skylight.errors import InputError
from skylight.relight._decoder import SkyDecoder, require_plain


def seeds() -> list[bytes]:
    weights = numpy_helper.from_array(np.zeros((64, 4), np.float32), "w")
    shape = numpy_helper.from_array(np.array([1, 32, 128, 3]), "shape")
    total = numpy_helper.from_array(np.array([1]), "axes")
    graph = helper.make_graph(
        [
            helper.make_node("MatMul", ["latent", "w"], ["m"]),
            helper.make_node("ReduceSum", ["m", "axes"], ["s"]),
            helper.make_node("Expand", ["s", "shape"], ["radiance"]),
        ],
        "decoder",
        [helper.make_tensor_value_info("latent", TensorProto.FLOAT, ["b", 64])],
        [helper.make_tensor_value_info("radiance", TensorProto.FLOAT, ["b", 32, 128, 3])],
        [weights, shape, total],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(model, {"centre_azimuth_rad": "0.02"})
    outside = onnx.ModelProto()
    outside.CopyFrom(model)
    tensor = outside.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../weights.bin")
    return [model.SerializeToString(), outside.SerializeToString()]


def read(content: bytes) -> None:
    try:
        require_plain(content)
    except ValueError as error:
        raise InputError(str(error)) from error
    decoder = SkyDecoder(content)
    assert decoder.decode(np.zeros((1, 64), np.float32)).shape == (1, 32, 128, 3)
