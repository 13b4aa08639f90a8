"""Maps to sparse codes and back."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight.csc.code import SparseCode
from skylight.csc.correlation import RotationCorrelation
from skylight.csc.dictionary import FilterBank, load_dictionary
from skylight.csc.layers import (
    AnyLayer,
    Layer,
    PixelLayer,
    degree_of,
    has_pixels,
    layer_of,
    layers_for,
)
from skylight.csc.norms import atom_norms
from skylight.csc.objective import SampledSignal
from skylight.csc.positions import Positions
from skylight.csc.pursuit import Pursuit, PursuitOptions, Support
from skylight.csc.search import pursue
from skylight.errors import InputError
from skylight.sphere.frame import pixel_from_direction
from skylight.sphere.latlong_transform import LatLongTransform

_AT_ONCE = 32  # filters turned together, whose Wigner matrices take 0.7 MB each at degree 40
Progress = Callable[[float], None]


class SphericalSparseCoder(nn.Module):
    """``code = coder(maps)``, ``coder.decode(code)``: convolutional sparse coding on the sphere.

    Parameters
    ----------
    dictionary
        "iso", "ani", "vmf", a file that a dictionary was saved to, or a bank of filters.
    height
        Rows of the lat-long maps to code.
    activations
        How many filters a code may use at most; a map that needs fewer gets fewer.
    options
        Which weights are allowed, and the pursuit; see
        :class:`~skylight.csc.pursuit.PursuitOptions`.
    banded
        Only the dictionary itself, at 32 x 64 positions: the thesis' coder. Otherwise maps of 64
        rows and more get sharper filters too (:func:`~skylight.csc.layers.layers_for`).
    dtype
        Of the search. Weights are fitted in double precision in any case.

    Memory, mostly of the search: 90 MB for ``ani`` at 32 rows, 300 MB at 128.
    """

    def __init__(
        self,
        dictionary: str | FilterBank = "ani",
        *,
        height: int = 32,
        activations: int = 64,
        options: PursuitOptions | None = None,
        banded: bool = False,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        bank = load_dictionary(dictionary) if isinstance(dictionary, str) else dictionary
        directions = 2 * height * height
        if bank.coefficients.shape[1] > directions:
            raise InputError(
                f"filters of degree {bank.degree} have {bank.coefficients.shape[1]} coefficients, "
                f"a map of {height}x{2 * height} only {directions} directions: use a finer map or "
                "a dictionary of lower degree"
            )
        if not 1 <= activations <= directions:
            raise InputError(
                f"{activations} activations of a map with {directions} directions: ask for 1 to "
                f"{directions}"
            )
        self.bank, self.height, self.activations = bank, height, activations
        self.banded = banded
        self.options = options or PursuitOptions()
        self.layers = nn.ModuleList(
            [Layer(bank, Positions(), dtype=dtype)]
            if banded
            else layers_for(bank, height, dtype=dtype)
        )
        self.degree = degree_of(self._layers)
        self.transform = LatLongTransform(self.degree, height)

    @cached_property
    def norms(self) -> list[Float[Tensor, "_ _ rows 1"]] | None:
        """What the dictionary's atoms weigh on the pixels of a map as coarse as its positions.

        The best atom has the largest correlation for its norm. Norms differ by up to 9 % on 32
        rows, which only an exact search needs to know; so only exchanges use them, as they take
        some seconds to make.
        """
        first = self._layers[0].correlation
        if isinstance(first, RotationCorrelation) and self.height == first.positions.rows:
            return atom_norms(first, self.transform)
        return None

    @property
    def _layers(self) -> list[AnyLayer]:
        return [each for each in self.layers if isinstance(each, Layer | PixelLayer)]

    @property
    def _pixels(self) -> PixelLayer | None:
        last = self._layers[-1]
        return last if isinstance(last, PixelLayer) else None

    def forward(
        self, maps: Float[Tensor, "*b h w 3"], progress: Progress | None = None
    ) -> SparseCode | list[SparseCode]:
        """The code of one map, or those of a batch, which share the processor's cores."""
        if maps.ndim == 3:
            return self.path(maps, [self.activations], progress)[0]
        if self.options.sweeps:
            _ = self.norms  # made once, by one thread
        with _one_thread_each(torch.get_num_threads()) as pool:
            return list(pool.map(lambda one: self.path(one, [self.activations])[0], maps))

    def path(
        self, radiance: Float[Tensor, "h w 3"], counts: list[int], progress: Progress | None = None
    ) -> list[SparseCode]:
        """Codes of several sizes, ascending, from one pursuit, which goes on from each."""
        if radiance.shape != (self.height, 2 * self.height, 3):
            raise InputError(
                f"this coder takes maps of {self.height}x{2 * self.height} with 3 colours, got "
                f"{tuple(radiance.shape)}: resize the map or make a coder for its height"
            )
        if not bool(radiance.isfinite().all()):
            raise InputError("the map has values that are NaN or infinite: repair them first")
        signal = SampledSignal.of(
            radiance.to(self.bank.coefficients.device, torch.float64),
            self.transform,
            pixels=has_pixels(self._layers),
        )
        total = float(signal.energy.sum())
        if total == 0:
            raise InputError("the map is black: there is nothing to code")
        norms = self.norms if self.options.sweeps else None
        pursuit = Pursuit(self._layers, signal, self.options, norms)
        return [self._code(s, total) for s in pursue(pursuit, counts, progress)]

    def _code(self, support: Support, total: float) -> SparseCode:
        directions, twists = [], []
        for filter_, place in zip(support.filters.tolist(), support.places, strict=True):
            positions = self._layers[layer_of(self._layers, filter_)].correlation.positions
            directions.append(positions.directions(place[None])[0])
            twists.append(positions.gamma[place[2]])
        return SparseCode(
            dictionary=self.bank.name,
            fingerprint=self.bank.fingerprint,
            height=self.height,
            banded=self.banded,
            filters=support.filters,
            directions=torch.stack(directions) if directions else torch.zeros(0, 3).double(),
            twists_rad=torch.stack(twists) if twists else torch.zeros(0).double(),
            weights=support.weights,
            relative_error=max(0.0, support.error / total) ** 0.5,
        )

    def check(self, code: SparseCode) -> None:
        """Raise :class:`InputError` where this coder cannot decode ``code``."""
        made = (code.dictionary, code.fingerprint, code.height, code.banded)
        if made != (self.bank.name, self.bank.fingerprint, self.height, self.banded):
            raise InputError(
                f"the code was made with dictionary {code.dictionary!r} ({code.fingerprint}) for "
                f"maps of {code.height} rows, this coder has {self.bank.name!r} "
                f"({self.bank.fingerprint}) for {self.height}: make a coder that matches"
            )
        if len(code) and not 0 <= int(code.filters.min()) <= int(code.filters.max()) < self.count:
            raise InputError(f"the code names filters that {self.bank.name!r} does not have")

    def decode(self, code: SparseCode, height: int | None = None) -> Float[Tensor, "h w 3"]:
        """The coded map at any number of rows; negative where weights of either sign make it so."""
        self.check(code)
        coefficients = self.coefficients(code.filters, code.angles(), code.weights)
        transform = self.transform
        if height is not None and height != self.height:
            transform = LatLongTransform(self.degree, height)
        smooth = transform.synthesise(coefficients.T).movedim(0, -1)
        return smooth if self._pixels is None else smooth + self.dots(code, transform).to(smooth)

    def dots(self, code: SparseCode, transform: LatLongTransform) -> Float[Tensor, "h w 3"]:
        """The code's pixels, their energy put where they are in a map of any height."""
        height, width = transform.grid.layout or (0, 0)
        out = torch.zeros(height * width, 3, dtype=torch.float64)
        assert self._pixels is not None
        chosen = torch.nonzero(code.filters == self._pixels.first)[:, 0]
        row, column = pixel_from_direction(code.directions[chosen], height, width)
        pixel = row.round().long().clamp(0, height - 1) * width + column.round().long() % width
        row, column = pixel_from_direction(code.directions[chosen], self.height, 2 * self.height)
        source = row.round().long().clamp(0, self.height - 1) * 2 * self.height
        source = source + column.round().long() % (2 * self.height)
        energy = self.transform.grid.solid_angles[source].sqrt()
        radiance = energy / transform.grid.solid_angles[pixel]
        out = out.index_add(0, pixel, code.weights[chosen] * radiance[:, None])
        return out.reshape(height, width, 3)

    @property
    def count(self) -> int:
        """Filters in all layers."""
        return sum(layer.count for layer in self._layers)

    def coefficients(
        self,
        filters: Int[Tensor, " s"],
        angles: tuple[Float[Tensor, " s"], Float[Tensor, " s"], Float[Tensor, " s"]],
        weights: Float[Tensor, "s c"],
    ) -> Float[Tensor, "k c"]:
        """``sum_j R_j d_j w_j`` about the zenith, pixels left out; differentiable."""
        device = self.bank.coefficients.device
        filters, weights = filters.to(device), weights.to(device)
        alpha, beta, gamma = (angle.to(device) for angle in angles)
        total = weights.new_zeros((self.degree + 1) ** 2, weights.shape[1])
        last = self.count
        for layer in reversed(self._layers):
            chosen = torch.nonzero((filters >= layer.first) & (filters < last))[:, 0]
            last = layer.first
            if isinstance(layer, PixelLayer):
                continue
            for some in chosen.split(_AT_ONCE):
                atoms = layer.turned(filters[some], alpha[some], beta[some], gamma[some])
                part = atoms.T @ weights[some]
                total = total + torch.nn.functional.pad(part, (0, 0, 0, len(total) - len(part)))
        return total


@contextmanager
def _one_thread_each(count: int) -> Iterator[ThreadPoolExecutor]:
    """As many workers as torch has threads: a pursuit's steps are too short to share well."""
    try:
        with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield pool
    finally:
        torch.set_num_threads(count)


def coder_for(code: SparseCode, dictionary: str | Path | None = None) -> SphericalSparseCoder:
    """The coder that decodes ``code``; ``dictionary`` is the file of one that is not built in."""
    source = code.dictionary if dictionary is None else str(dictionary)
    return SphericalSparseCoder(source, height=code.height, banded=code.banded)
