"""The sky decoder as an ONNX graph, run by onnxruntime: torch is never imported here."""

import math
import threading
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from skylight.errors import AssetError
from skylight.io.bounded import file_bytes
from skylight.relight.onnx_graph import require_plain

DECODER_BYTES_MAX = 2**29  # of all decoders together, four times what _BATCH takes
_BATCH = 32
_only_once = threading.Lock()


class SkyDecoder:
    """Latents to skies, by a graph that :func:`skylight.relight.export.export_decoder` wrote.

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
