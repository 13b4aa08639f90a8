"""Sparse codes: filters, their rotations and colours; as tensors, and as files."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.utils._pytree import _register_namedtuple as register_named_tuple

from skylight.errors import InputError
from skylight.io._bounded import json_content, write_json

FORMAT, VERSION = "skylight sparse code", 1


class CodeTensors(NamedTuple):
    """Codes ``sum_j weights_j R_j d_(filters_j)`` of any batch, padded to one length k.

    ``rotations`` are the Euler angles (alpha, beta, gamma) of R = Rz(alpha) Ry(beta) Rz(gamma)
    about the zenith: longitude and zenith angle of the filter's centre, and its twist, in radians.
    The first ``count`` activations of each code are in use; the rest are zeros.

    A pytree: arguments and results of :func:`torch.func.vmap`, :func:`torch.compile` and
    :func:`torch.export.export`. ``torch.load(weights_only=True)`` reads what ``torch.save`` wrote.
    """

    filters: Int[Tensor, "*batch k"]
    rotations: Float[Tensor, "*batch k 3"]
    weights: Float[Tensor, "*batch k c"]
    count: Int[Tensor, "*batch"]

    @property
    def used(self) -> Bool[Tensor, "*batch k"]:
        """Which activations are no padding."""
        place = torch.arange(self.filters.shape[-1], device=self.count.device)
        return place < self.count[..., None]

    def to(self, device: torch.device) -> "CodeTensors":
        return CodeTensors(*(each.to(device) for each in self))


# a named tuple is a pytree already; these are for programs and codes in files
register_named_tuple(CodeTensors, serialized_type_name="skylight.csc.CodeTensors")
torch.serialization.add_safe_globals([CodeTensors])


@dataclass(frozen=True, kw_only=True)
class SparseCode:
    """``sum_j weights_j R_j d_(filters_j)``: s activations of a dictionary's filters, as a file.

    ``directions`` (s,3) are the world directions of the filters' centres; ``twists_rad`` (s,) how
    far each is rotated about that direction first; ``weights`` (s,3) the colours, in radiance times
    the root of a steradian, as filters have unit norm over the sphere. ``height`` is the rows of
    the map that was coded, which with ``banded`` decides the sub-dictionaries; ``fingerprint``
    names the dictionary itself. ``relative_error`` is ``|x - decoded| / |x|`` of the coded map,
    weighted by solid angle, or of the shading from which the code was estimated.
    """

    dictionary: str
    fingerprint: str
    height: int
    banded: bool
    filters: Int[Tensor, " s"]
    directions: Float[Tensor, "s 3"]
    twists_rad: Float[Tensor, " s"]
    weights: Float[Tensor, "s 3"]
    relative_error: float

    def __len__(self) -> int:
        return len(self.filters)

    @property
    def floats(self) -> int:
        """Numbers that it takes in full: three colours, and one word for place, twist and filter.

        A place of 128 x 256 (15 bits), one of 32 twists (5) and one of 4,096 filters (12) fill 32
        bits.
        """
        return 4 * len(self)

    @property
    def rotations(self) -> Float[Tensor, "s 3"]:
        """Euler angles (alpha, beta, gamma) about the zenith: longitude, zenith angle, twist."""
        x, y, z = self.directions.unbind(1)
        beta = torch.atan2(torch.hypot(x, z), y)
        return torch.stack([torch.atan2(x, z), beta, self.twists_rad], 1)

    def tensors(self) -> CodeTensors:
        """The code as tensors, unbatched and not padded."""
        return CodeTensors(self.filters, self.rotations, self.weights, torch.tensor(len(self)))

    def save(self, path: str | Path) -> None:
        """Write a JSON file, whole or not at all."""
        rows = zip(
            self.filters.tolist(),
            self.directions.tolist(),
            self.twists_rad.tolist(),
            self.weights.tolist(),
            strict=True,
        )
        write_json(
            path,
            {
                "format": FORMAT,
                "version": VERSION,
                "dictionary": self.dictionary,
                "fingerprint": self.fingerprint,
                "height": self.height,
                "banded": self.banded,
                "relative_error": self.relative_error,
                "activations": [
                    {"filter": f, "direction": d, "twist_deg": math.degrees(t), "rgb": w}
                    for f, d, t, w in rows
                ],
            },
        )

    @staticmethod
    def load(path: str | Path) -> "SparseCode":
        """Read what :meth:`save` wrote.

        Raises
        ------
        InputError
            The file is missing, damaged, or something else.
        """
        try:
            content = json_content(Path(path))
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise InputError(f"{path} is no JSON file: {error}") from error
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise InputError(f"{path} is no sparse code: choose a file that `skylight code` wrote")
        if content.get("version") != VERSION:
            raise InputError(
                f"{path} has version {content.get('version')} of the format, this skylight reads "
                f"{VERSION}: code the map again"
            )
        try:
            each = content["activations"]
            code = SparseCode(
                dictionary=content["dictionary"],
                fingerprint=content["fingerprint"],
                height=int(content["height"]),
                banded=bool(content["banded"]),
                relative_error=float(content["relative_error"]),
                filters=torch.tensor([a["filter"] for a in each], dtype=torch.long),
                directions=_table([a["direction"] for a in each]),
                twists_rad=torch.deg2rad(_table([[a["twist_deg"]] for a in each], 1)[:, 0]),
                weights=_table([a["rgb"] for a in each]),
            )
            whole = all(type(a["filter"]) is int and a["filter"] >= 0 for a in each)
            named = type(code.dictionary) is type(code.fingerprint) is str
        except (KeyError, TypeError, ValueError, RuntimeError, OverflowError) as error:
            raise InputError(f"{path} is damaged ({error}): code the map again") from error
        unit = (code.directions.norm(dim=1) - 1).abs() < 1e-6
        possible = 0 <= code.relative_error < math.inf  # "inf", a text, is one of float's numbers
        if not (whole and named and possible and bool(unit.all())) or code.height < 1:
            raise InputError(
                f"{path} is damaged: directions must be unit vectors, filters whole numbers, the "
                "dictionary and its fingerprint texts, the "
                "error finite and not negative, the height 1 or more"
            )
        return code


def _table(rows: list[list[float]], columns: int = 3) -> Float[Tensor, "s c"]:
    return torch.tensor(rows, dtype=torch.float64).reshape(len(rows), columns)
