"""Networks from MediaPipe's ``.task`` files, run by LiteRT (extra ``mediapipe``)."""

import threading
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from skylight.errors import DependencyError, InputError
from skylight.io.bounded import require_plain_packing

_BYTES_MAX = 2**28  # MediaPipe's are below 10 MB


def read_task(task_file: Path, networks: tuple[str, ...]) -> dict[str, bytes]:
    """The named networks' files.

    Raises
    ------
    InputError
        There is no such file, it is damaged, or one of the networks is not in it.
    """
    if not task_file.is_file():
        raise InputError(f"{task_file}: there is no such file; download the model first")
    try:
        with zipfile.ZipFile(task_file) as archive:
            missing = sorted(set(networks) - set(archive.namelist()))
            if missing:
                raise InputError(
                    f"{task_file} is another task's file: it holds no {' and no '.join(missing)}"
                )
            members = [archive.getinfo(name) for name in networks]
            require_plain_packing(members)
            together = sum(member.file_size for member in members)
            if together > _BYTES_MAX:
                raise ValueError(f"networks of {together} bytes")
            return {name: archive.read(name) for name in networks}
    # encrypted: RuntimeError
    except (
        zipfile.BadZipFile, OSError, EOFError, zlib.error, ValueError, RuntimeError,
    ) as error:  # fmt: skip
        raise InputError(
            f"{task_file} is no whole .task file ({error}); download it again"
        ) from error


class Network:
    """A TensorFlow Lite model that takes one square RGB picture; ``source`` names it in errors.

    Raises
    ------
    DependencyError
        LiteRT is not installed.
    InputError
        ``content`` is no such model.
    """

    def __init__(self, content: bytes, source: str) -> None:
        try:
            from ai_edge_litert import interpreter as litert  # optional
        except ImportError as error:
            raise DependencyError(
                "MediaPipe's landmarks need LiteRT: pip install 'skylight[mediapipe]'"
            ) from error
        self._source = source
        self._one_at_a_time = threading.Lock()  # the interpreter keeps its picture
        try:
            self._interpreter: Any = litert.Interpreter(
                model_content=content,
                # the default delegate is some 20 ms a face faster, and writes to standard error
                experimental_op_resolver_type=(
                    litert.OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES
                ),
            )
            self._interpreter.allocate_tensors()
            (self._input,) = self._interpreter.get_input_details()
            _, self.side, width, channels = self._input["shape"].tolist()
        except (ValueError, RuntimeError) as error:
            raise InputError(f"{source} is no model that LiteRT can run ({error})") from error
        if (width, channels) != (self.side, 3):
            raise InputError(f"{source} takes no square RGB pictures")
        self._outputs = self._interpreter.get_output_details()

    def check_outputs(self, *sizes: int) -> None:
        """:class:`InputError` unless the first outputs hold as many numbers each."""
        made = tuple(int(np.prod(output["shape"])) for output in self._outputs)
        if made[: len(sizes)] != sizes:
            raise InputError(
                f"{self._source} is of another version: it gives {made} numbers, not {sizes}"
            )

    def run(self, picture: Float32[ndarray, "s s 3"]) -> list[ndarray]:
        """All outputs for one picture, in the model's order."""
        with self._one_at_a_time:
            self._interpreter.set_tensor(self._input["index"], picture[None])
            self._interpreter.invoke()
            return [self._interpreter.get_tensor(output["index"]) for output in self._outputs]
