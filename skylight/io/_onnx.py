"""Modules written as ONNX graphs that onnxruntime runs without torch."""

import logging
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skylight import __version__
from skylight.errors import not_installed

_OPSET = 20  # from 19 on a padding may wrap around
_HALVED = 1024  # numbers; fewer are not worth a cast


def onnx_graph(
    module: nn.Module,
    inputs: Mapping[str, Tensor],
    output: str,
    *,
    sizes: Mapping[str, Mapping[int, str]],
    metadata: Mapping[str, str],
) -> bytes:
    """What ``module(*inputs.values())`` computes, as an ONNX file's bytes.

    ``sizes`` names the axes of each input whose sizes are free. Weights that half precision holds
    are stored so, and cast when the graph is loaded.

    Raises
    ------
    DependencyError
        The extra "export" is not installed.
    """
    try:
        import onnx
        import onnxscript.optimizer
    except ImportError as error:
        raise not_installed(error.name or "onnx", "writing ONNX") from error
    free = {name: torch.export.Dim(name) for axes in sizes.values() for name in axes.values()}
    # it reports every operator of torchvision, which is not needed
    registration = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = registration.level
    registration.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch's deprecations within torch
            program = torch.onnx.export(
                module.eval(),
                tuple(inputs.values()),
                input_names=list(inputs),
                output_names=[output],
                dynamic_shapes=tuple(
                    {axis: free[name] for axis, name in sizes[each].items()} for each in inputs
                ),
                opset_version=_OPSET,
                dynamo=True,
                verbose=False,
            )
    finally:
        registration.setLevel(level)
    assert program is not None
    # The limits' defaults leave the einsum that folds upsampling into the kernels; this turns it
    # into constants.
    model = onnxscript.optimizer.optimize(
        program.model_proto, input_size_limit=10**7, output_size_limit=10**7
    )
    _halve(model.graph)
    for part in (*model.graph.node, *model.graph.value_info, model.graph):
        part.ClearField("metadata_props")  # where in this machine's folders each step was traced
        part.ClearField("doc_string")
    onnx.helper.set_model_props(model, {"skylight_version": __version__, **metadata})
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _halve(graph: Any) -> None:
    """Store as float16, with a cast before their use, the large weights that lose nothing by it."""
    from onnx import TensorProto, helper, numpy_helper

    casts = []
    for weight in list(graph.initializer):
        value = numpy_helper.to_array(weight)
        if value.dtype != np.float32 or value.size < _HALVED:
            continue
        with np.errstate(over="ignore"):
            half = value.astype(np.float16)
        if np.array_equal(half.astype(np.float32), value):
            name = weight.name
            graph.initializer.remove(weight)
            graph.initializer.append(numpy_helper.from_array(half, f"{name}_half"))
            casts.append(helper.make_node("Cast", [f"{name}_half"], [name], to=TensorProto.FLOAT))
    for cast in reversed(casts):
        graph.node.insert(0, cast)
