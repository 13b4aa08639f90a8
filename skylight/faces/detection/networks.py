"""MediaPipe's networks, run by onnxruntime (``tools/convert_networks.py`` made the files)."""

from functools import cache
from importlib.resources import files

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from skylight.errors import AssetError


class Network:
    """A network of this package that takes one picture; threads may share it.

    Raises
    ------
    AssetError
        Its file is missing or damaged.
    """

    def __init__(self, name: str) -> None:
        import onnxruntime  # where it is used only: imported, it leaves a file in TMPDIR

        source = files("skylight.faces") / "data" / f"{name}.onnx"
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # what is wrong is raised, and told once
        options.intra_op_num_threads = 1  # a face is work for one core
        try:
            self._session = onnxruntime.InferenceSession(
                source.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        # onnxruntime raises classes of its own, whose base is Exception
        except Exception as error:
            first = str(error).partition("\n")[0]
            raise AssetError(f"{source} cannot be read ({first}); reinstall skylight") from error
        (self._input,) = self._session.get_inputs()

    @property
    def side(self) -> int:
        """Rows and columns of the picture."""
        return self._input.shape[1]

    def run(self, picture: Float32[ndarray, "s s c"]) -> list[ndarray]:
        """All outputs for one picture of as many channels as it takes, in the model's order."""
        outputs = self._session.run(None, {self._input.name: picture[None]})
        return [np.asarray(output) for output in outputs]


@cache
def network(name: str) -> Network:
    """``face_detector``, ``face_landmarks`` or ``hair_segmenter``, loaded once a process."""
    return Network(name)
