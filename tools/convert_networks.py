"""Networks of MediaPipe from TensorFlow Lite to ONNX, so that onnxruntime runs them.

    pip install tflite onnx ai-edge-litert
    python tools/convert_networks.py face_landmarker.task hair_segmenter.tflite \\
        --out skylight/faces/data

Takes ``.tflite`` files and ``.task`` files, which are zips of them; of the face landmarker's, the
detector and the landmarks. Weights keep their precision (float16 ones are cast as the network is
loaded); inside, tensors are (batch, channels, rows, columns), outside (batch, rows, columns,
channels) as before. Only what the face landmarker and the hair segmenter use is translated, and
anything else is refused. The outputs are compared with LiteRT's on random pictures.
"""

import argparse
import zipfile
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import tflite
from onnx import TensorProto, helper, numpy_helper
from tflite import BuiltinOperator as Op

from skylight.io._atomic import atomic_path

OPSET, IR = 17, 8
TASK = {
    "face_detector.tflite": "face_detector.onnx",
    "face_landmarks_detector.tflite": "face_landmarks.onnx",
}
NAMES = {code: name for name, code in vars(Op).items() if isinstance(code, int)}
TYPES = {0: np.float32, 1: np.float16, 2: np.int32}
INWARD, OUTWARD = (0, 3, 1, 2), (0, 2, 3, 1)


class Converter:
    """One graph; ``tensors`` maps a tensor's number to its name in ONNX (4-D ones are NCHW)."""

    def __init__(self, content: bytes) -> None:
        self.model = tflite.Model.GetRootAsModel(content, 0)
        self.graph = self.model.Subgraphs(0)
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, onnx.TensorProto] = {}
        self.numbers: dict[int, np.ndarray] = {}  # constant tensors as they are stored
        self.dequantised: dict[int, int] = {}  # float32 tensor -> its float16 constant
        for number in range(self.graph.TensorsLength()):
            tensor = self.graph.Tensors(number)
            raw = self.model.Buffers(tensor.Buffer()).DataAsNumpy()
            if not isinstance(raw, int) and len(raw):
                values = np.frombuffer(raw.tobytes(), TYPES[tensor.Type()])
                self.numbers[number] = values.reshape(self.shape(number))

    def shape(self, number: int) -> tuple[int, ...]:
        shape = self.graph.Tensors(number).ShapeAsNumpy()
        return () if isinstance(shape, int) else tuple(int(side) for side in shape)

    def constant(self, number: int) -> np.ndarray:
        return self.numbers[self.dequantised.get(number, number)]

    def convert(self) -> onnx.ModelProto:
        inputs = [self.graph.Inputs(i) for i in range(self.graph.InputsLength())]
        outputs = [self.graph.Outputs(i) for i in range(self.graph.OutputsLength())]
        for number in inputs:
            self.add("Transpose", ["picture"], [f"t{number}"], perm=INWARD)
        for i in range(self.graph.OperatorsLength()):
            self.translate(self.graph.Operators(i))
        for number in outputs:
            self.outward(f"t{number}", f"out{number}", self.shape(number))
        value = helper.make_tensor_value_info
        graph = helper.make_graph(
            self.nodes,
            "network",
            [value("picture", TensorProto.FLOAT, self.shape(n)) for n in inputs],
            [value(f"out{n}", TensorProto.FLOAT, self.shape(n)) for n in outputs],
            list(self.constants.values()),
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
        model.ir_version = IR
        model = onnx.shape_inference.infer_shapes(model)
        onnx.checker.check_model(model, full_check=True)
        return model

    def add(self, kind: str, inputs: list[str], outputs: list[str], **attributes: object) -> None:
        self.nodes.append(helper.make_node(kind, inputs, outputs, **attributes))

    def stored(self, name: str, values: np.ndarray) -> str:
        """The name of a float32 tensor that holds ``values``, stored at their own precision."""
        if name not in self.constants:
            self.constants[name] = numpy_helper.from_array(np.ascontiguousarray(values), name)
            if values.dtype == np.float16:
                self.add("Cast", [name], [f"{name}_32"], to=TensorProto.FLOAT)
        return f"{name}_32" if values.dtype == np.float16 else name

    def outward(self, name: str, to: str, shape: tuple[int, ...]) -> None:
        if len(shape) == 4:
            self.add("Transpose", [name], [to], perm=OUTWARD)
        else:
            self.add("Identity", [name], [to])

    def translate(self, operator: tflite.Operator) -> None:
        code = self.model.OperatorCodes(operator.OpcodeIndex())
        kind = NAMES[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
        if kind == "CUSTOM":
            kind = code.CustomCode().decode()
        inputs = [operator.Inputs(i) for i in range(operator.InputsLength())]
        outputs = [operator.Outputs(i) for i in range(operator.OutputsLength())]
        options = operator.BuiltinOptions()
        method = getattr(self, f"on_{kind.lower()}", None)
        if method is None:
            raise SystemExit(f"{kind} is not translated: write on_{kind.lower()}")
        method(operator, options, inputs, outputs)

    def activated(self, options: object, name: str) -> str:
        """The name to write to before the operator's own activation gives ``name``."""
        kind = options.FusedActivationFunction()  # type: ignore[attr-defined]
        if kind == tflite.ActivationFunctionType.NONE:
            return name
        if kind != tflite.ActivationFunctionType.RELU:
            raise SystemExit(f"activation {kind} is not translated")
        return f"{name}_linear"

    def finish(self, before: str, name: str) -> None:
        if before != name:
            self.add("Relu", [before], [name])

    def pads(
        self,
        padding: int,
        shape: tuple[int, ...],
        window: tuple[int, int],
        strides: tuple[int, int],
    ) -> list[int]:
        """TensorFlow's "SAME": what is odd goes to the end; "VALID": nothing."""
        if padding == tflite.Padding.VALID:
            return [0, 0, 0, 0]
        before, after = [], []
        for side, reach, stride in zip(shape[1:3], window, strides, strict=True):
            total = max((-(-side // stride) - 1) * stride + reach - side, 0)
            before.append(total // 2)
            after.append(total - total // 2)
        return before + after

    def read(self, options: object, as_: type) -> object:
        found = as_()
        found.Init(options.Bytes, options.Pos)  # type: ignore[attr-defined]
        return found

    # ------------------------------------------------------------------------------ operators

    def on_dequantize(self, _: object, __: object, inputs: list[int], outputs: list[int]) -> None:
        self.dequantised[outputs[0]] = inputs[0]

    def _convolve(self, o, inputs, outputs, weights, group, dilations):
        window = weights.shape[2:]
        strides = (o.StrideH(), o.StrideW())
        reach = tuple((w - 1) * d + 1 for w, d in zip(window, dilations, strict=True))
        names = [f"t{inputs[0]}", self.stored(f"w{inputs[1]}", weights)]
        if len(inputs) > 2 and inputs[2] >= 0:
            names.append(self.stored(f"b{inputs[2]}", self.constant(inputs[2])))
        name = f"t{outputs[0]}"
        before = self.activated(o, name)
        pads = self.pads(o.Padding(), self.shape(inputs[0]), reach, strides)
        self.add(
            "Conv", names, [before], group=group, pads=pads, strides=strides, dilations=dilations,
            kernel_shape=window,
        )  # fmt: skip
        self.finish(before, name)

    def on_conv_2d(self, _: object, options: object, inputs: list[int], outputs: list[int]) -> None:
        o = self.read(options, tflite.Conv2DOptions)
        weights = self.constant(inputs[1]).transpose(0, 3, 1, 2)
        dilations = (o.DilationHFactor(), o.DilationWFactor())
        self._convolve(o, inputs, outputs, weights, 1, dilations)

    def on_depthwise_conv_2d(self, _, options, inputs, outputs):
        o = self.read(options, tflite.DepthwiseConv2DOptions)
        weights = self.constant(inputs[1]).transpose(3, 0, 1, 2)  # (channels, 1, h, w)
        dilations = (o.DilationHFactor(), o.DilationWFactor())
        self._convolve(o, inputs, outputs, weights, self.shape(inputs[0])[3], dilations)

    def on_relu(self, _, __, inputs, outputs):
        self.add("Relu", [f"t{inputs[0]}"], [f"t{outputs[0]}"])

    def on_prelu(self, _, __, inputs, outputs):
        slope = self.constant(inputs[1]).reshape(-1, 1, 1)
        self.add(
            "PRelu", [f"t{inputs[0]}", self.stored(f"s{inputs[1]}", slope)], [f"t{outputs[0]}"]
        )

    def on_logistic(self, _, __, inputs, outputs):
        self.add("Sigmoid", [f"t{inputs[0]}"], [f"t{outputs[0]}"])

    def on_add(self, _, options, inputs, outputs):
        if any(n in self.numbers or n in self.dequantised for n in inputs):
            raise SystemExit("the addition of a constant is not translated")
        before = self.activated(self.read(options, tflite.AddOptions), f"t{outputs[0]}")
        self.add("Add", [f"t{n}" for n in inputs], [before])
        self.finish(before, f"t{outputs[0]}")

    def on_pad(self, _, __, inputs, outputs):
        pads = self.constant(inputs[1])[list(INWARD)].T.reshape(-1).astype(np.int64)
        names = [f"t{inputs[0]}", self.stored(f"p{outputs[0]}", pads)]
        self.add("Pad", names, [f"t{outputs[0]}"])

    def on_max_pool_2d(self, _, options, inputs, outputs):
        o = self.read(options, tflite.Pool2DOptions)
        window, strides = (o.FilterHeight(), o.FilterWidth()), (o.StrideH(), o.StrideW())
        pads = self.pads(o.Padding(), self.shape(inputs[0]), window, strides)
        before = self.activated(o, f"t{outputs[0]}")
        self.add(
            "MaxPool", [f"t{inputs[0]}"], [before], kernel_shape=window, strides=strides, pads=pads
        )
        self.finish(before, f"t{outputs[0]}")

    def on_reshape(self, _, __, inputs, outputs):
        shape = self.shape(outputs[0])
        flat = f"t{inputs[0]}_outward"
        self.outward(f"t{inputs[0]}", flat, self.shape(inputs[0]))
        to = f"t{outputs[0]}" + ("_outward" if len(shape) == 4 else "")
        self.add("Reshape", [flat, self.stored(f"r{outputs[0]}", np.array(shape))], [to])
        if len(shape) == 4:
            self.add("Transpose", [to], [f"t{outputs[0]}"], perm=INWARD)

    def on_concatenation(self, _, options, inputs, outputs):
        o = self.read(options, tflite.ConcatenationOptions)
        axis = o.Axis() % len(self.shape(outputs[0]))
        if len(self.shape(outputs[0])) == 4:
            axis = INWARD.index(axis)
        before = self.activated(o, f"t{outputs[0]}")
        self.add("Concat", [f"t{n}" for n in inputs], [before], axis=axis)
        self.finish(before, f"t{outputs[0]}")

    # MediaPipe's own operators, all by two in either direction (mediapipe/util/tflite/operations)

    def on_maxpoolingwithargmax2d(self, _, __, inputs, outputs):
        self.add(
            "MaxPool", [f"t{inputs[0]}"], [f"t{n}" for n in outputs], kernel_shape=(2, 2),
            strides=(2, 2),
        )  # fmt: skip

    def on_maxunpooling2d(self, _, __, inputs, outputs):
        self.add(
            "MaxUnpool", [f"t{n}" for n in inputs], [f"t{outputs[0]}"], kernel_shape=(2, 2),
            strides=(2, 2),
        )  # fmt: skip

    def on_convolution2dtransposebias(self, _, __, inputs, outputs):
        kernel = self.constant(inputs[1])  # (out, h, w, in)
        window = kernel.shape[1:3]
        over = [w - 2 for w in window]
        if any(side < 0 for side in over):
            raise SystemExit(f"a transposed convolution of {window} by 2 is not translated")
        pads = [side // 2 for side in over] + [side - side // 2 for side in over]
        names = [
            f"t{inputs[0]}",
            self.stored(f"w{inputs[1]}", kernel.transpose(3, 0, 1, 2)),
            self.stored(f"b{inputs[2]}", self.constant(inputs[2])),
        ]
        self.add(
            "ConvTranspose", names, [f"t{outputs[0]}"], kernel_shape=window, strides=(2, 2),
            pads=pads,
        )  # fmt: skip


def run_onnx(content: bytes, picture: np.ndarray) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(None, {"picture": picture})


def run_litert(content: bytes, picture: np.ndarray) -> list[np.ndarray]:
    from ai_edge_litert import interpreter as litert

    interpreter = litert.Interpreter(model_content=content)
    interpreter.allocate_tensors()
    (taken,) = interpreter.get_input_details()
    interpreter.set_tensor(taken["index"], picture)
    interpreter.invoke()
    return [interpreter.get_tensor(each["index"]) for each in interpreter.get_output_details()]


def convert(name: str, content: bytes, out: Path) -> None:
    model = Converter(content).convert()
    shape = [side.dim_value for side in model.graph.input[0].type.tensor_type.shape.dim]
    made, worst = model.SerializeToString(), 0.0
    with atomic_path(out) as path:
        path.write_bytes(made)
    for seed in range(3):
        picture = np.random.default_rng(seed).random(shape, dtype=np.float32)
        pairs = zip(run_onnx(made, picture), run_litert(content, picture), strict=True)
        worst = max(
            worst, *(float(np.abs(a - b).max() / max(np.abs(b).max(), 1)) for a, b in pairs)
        )
    print(f"{name} -> {out}: {len(made) / 1e6:.2f} MB, outputs differ by up to {worst:.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    for file in arguments.files:
        if file.suffix != ".task":
            convert(file.name, file.read_bytes(), arguments.out / f"{file.stem}.onnx")
            continue
        with zipfile.ZipFile(file) as task:
            for source, target in TASK.items():
                convert(source, task.read(source), arguments.out / target)


if __name__ == "__main__":
    main()
