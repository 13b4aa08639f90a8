"""Maps to sparse codes and back."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight._modes import full_precision, on_cpu, transformed
from skylight._module import Module
from skylight.csc._code import CodeTensors, SparseCode
from skylight.csc._dictionary import FilterBank, load_dictionary
from skylight.csc._greedy import Pursuit, PursuitOptions, Support, pursue, pursue_together
from skylight.csc._least_squares import SampledSignal
from skylight.csc._positions import Positions, centres_of
from skylight.csc._sub_dictionaries import (
    BoxDictionary,
    Part,
    SearchPlan,
    SubDictionary,
    degree_of,
    has_pixels,
    multiresolution,
    rotated_atoms,
)
from skylight.csc._wigner import RotationCorrelation, atom_norms
from skylight.errors import InputError, check_shape
from skylight.sphere._envmap import averaged
from skylight.sphere._frame import pixel_from_direction
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.work._progress import Progress
from skylight.work._threads import cores

_TOGETHER = 32  # maps whose activations are searched for together, 3 MB each and more
_RIDGE = 1e-12  # of a Gram matrix: atoms that have become dependent leave it solvable


class SphericalSparseCoder(Module):
    """Convolutional sparse coding on the sphere: ``codes = coder(maps)``, ``coder.decode(codes)``.

    The filters of ``dictionary`` are the only parameters. Which filters are active, and at which
    rotations, is found by a greedy search without gradient; :meth:`refit` gives the weights on such
    a support as a differentiable function of maps and filters, :meth:`decode` the maps of a code.
    So a dictionary is learned by an ordinary optimiser::

        codes = coder(maps)
        loss = coder.relative_error(maps, coder.refit(maps, codes)).square().mean()

    Parameters
    ----------
    dictionary
        "iso", "ani", "vmf", "box" (the filters of "ani" and boxes of the map's pixels), a file that
        a dictionary was saved to, or a bank of filters.
    height
        Rows of the lat-long maps to code.
    activations
        How many filters a code may use at most; a map that needs fewer gets fewer.
    options
        Which weights are allowed, and the pursuit; see
        :class:`~skylight.csc._greedy.PursuitOptions`.
    banded
        Only the dictionary itself, at 32 x 64 positions: the thesis' coder. Otherwise maps of 64
        rows and more get sharper filters too
        (:func:`~skylight.csc._sub_dictionaries.multiresolution`).
    dtype
        Of the search; ``.double()`` and ``.float()`` change it too. Weights are fitted in double
        precision in any case. Where TF32 is allowed, the search may take another of filters whose
        correlations differ by .1 %; the code's error stays within 1 %.

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
        directions, coefficients = 2 * height * height, (bank.degree + 1) ** 2
        if coefficients > directions:
            raise InputError(
                f"filters of degree {bank.degree} have {coefficients} coefficients, "
                f"a map of {height}x{2 * height} only {directions} directions: use a finer map or "
                "a dictionary of lower degree"
            )
        if not 1 <= activations <= directions:
            raise InputError(
                f"{activations} activations of a map with {directions} directions: ask for 1 to "
                f"{directions}"
            )
        self.height, self.activations, self.banded = height, activations, banded
        self.options = options or PursuitOptions()
        self.sub_dictionaries = nn.ModuleList(
            [SubDictionary(bank, Positions(), dtype=dtype)]
            if banded
            else multiresolution(bank, height, dtype=dtype)
        )
        self.degree = degree_of(self.parts)
        self.transform = LatLongTransform(self.degree, height)
        self._norms: tuple[SearchPlan, list[Tensor]] | None = None

    @property
    def parts(self) -> list[Part]:
        """The sub-dictionaries: the dictionary itself, then sharper ones of finer maps."""
        return [p for p in self.sub_dictionaries if isinstance(p, SubDictionary | BoxDictionary)]

    @property
    def bank(self) -> FilterBank:
        """The dictionary."""
        first = self.parts[0]
        assert isinstance(first, SubDictionary)
        return first.bank

    @property
    def count(self) -> int:
        """Filters in all sub-dictionaries."""
        return sum(part.count for part in self.parts)

    @torch.no_grad()
    def norms(self) -> list[Float[Tensor, "_ _ rows 1"]] | None:
        """The L2 norms of the dictionary's atoms as sampled by a map as coarse as their positions.

        The best atom has the largest correlation for its norm. Norms differ by up to 9 % on 32
        rows, which only an exact search needs to know; so only exchanges use them, as they take
        some seconds to make. None where positions are not the map's pixels.
        """
        plan = self.parts[0].plan()
        if not isinstance(plan.correlation, RotationCorrelation) or (
            self.height != plan.positions.rows
        ):
            return None
        assert isinstance(plan, SearchPlan)
        if self._norms is None or self._norms[0] is not plan:
            self._norms = plan, atom_norms(plan.correlation, self.transform)
        return self._norms[1]

    @on_cpu
    def forward(self, maps: Float[Tensor, "*batch h w 3"]) -> CodeTensors:
        """The codes of maps, padded to ``activations``; no gradient flows through the search.

        Weights have the maps' dtype. The maps of a batch are searched together, on a CPU by as many
        workers as torch has threads, but no more than the process may use cores.

        Raises
        ------
        InputError
            Maps of another size, black or not finite, or within a transform of :mod:`torch.func`,
            :func:`torch.compile` or :func:`torch.export.export`.
        """
        if transformed() or torch.compiler.is_compiling():
            raise InputError(
                "which filters are active is searched for, which no graph and no transform of "
                "torch.func can follow: code the maps before, and refit or decode within"
            )
        self._check_maps(maps)
        flat = maps.reshape(-1, *maps.shape[-3:])
        if len(flat) == 0:
            blank = maps.new_zeros(*maps.shape[:-3], self.activations, 3)
            return CodeTensors(blank[..., 0].long(), blank.double(), blank, blank[..., 0, 0].long())
        for part in self.parts:
            _ = part.plan().correlation  # made once, by one thread
        if self.options.sweeps:
            self.norms()

        workers = min(len(flat), torch.get_num_threads(), cores())
        if self.bank.unnormalised.device.type != "cpu":
            workers = 1
        if workers == 1:
            supports = self._search_together(flat)
        else:
            with _one_thread_each(workers) as pool:
                shares = list(pool.map(self._search_together, flat.tensor_split(workers)))
            supports = [support for share in shares for support in share]
        codes = [support.tensors(self.parts, self.activations) for support in supports]
        columns = (torch.stack(column) for column in zip(*codes, strict=True))
        filters, rotations, weights, count = (
            c.reshape((*maps.shape[:-3], *c.shape[1:])).to(maps.device) for c in columns
        )
        return CodeTensors(filters, rotations, weights.to(maps.dtype), count)

    @on_cpu
    def path(
        self, radiance: Float[Tensor, "h w 3"], counts: list[int], progress: Progress | None = None
    ) -> list[SparseCode]:
        """Codes of several sizes, ascending, from one pursuit, which continues from each."""
        self._check_maps(radiance)
        with full_precision(radiance):
            signal = self._signal(radiance)
            energy = float(signal.energy.sum())
            return [
                self.sparse_code(s.tensors(self.parts), max(0.0, s.error / energy) ** 0.5)
                for s in pursue(self._start(signal), counts, progress)
            ]

    def _signal(self, radiance: Float[Tensor, "h w 3"]) -> SampledSignal:
        radiance = radiance.detach().to(self.bank.unnormalised.device, torch.float64)
        return SampledSignal.of(radiance, self.transform, pixels=has_pixels(self.parts))

    @torch.no_grad()
    def _start(self, signal: SampledSignal) -> Pursuit:
        norms = self.norms() if self.options.sweeps else None
        return Pursuit(self.parts, signal, self.options, norms)

    @torch.no_grad()
    def _search_together(self, maps: Float[Tensor, "n h w 3"]) -> list[Support]:
        with full_precision(maps):  # the next atom is the largest of many that are alike
            return self._searched(maps)

    def _searched(self, maps: Float[Tensor, "n h w 3"]) -> list[Support]:
        return [
            support
            for some in maps.split(_TOGETHER)
            for support in pursue_together(
                [self._start(self._signal(one)) for one in some], self.activations
            )
        ]

    def _check_maps(self, maps: Float[Tensor, "*batch h w 3"]) -> None:
        if maps.shape[-3:] != (self.height, 2 * self.height, 3):
            raise InputError(
                f"this coder takes maps of {self.height}x{2 * self.height} with 3 colours, got "
                f"{tuple(maps.shape[-3:])}: resize the map or make a coder for its height"
            )
        if not bool(maps.isfinite().all()):
            raise InputError("the map has values that are NaN or infinite: repair them first")
        if not bool(maps.flatten(-3).any(-1).all()):
            raise InputError("the map is black: there is nothing to code")

    def refit(self, maps: Float[Tensor, "*batch h w 3"], codes: CodeTensors) -> CodeTensors:
        """The least-squares weights of fixed filters and rotations, differentiable in both.

        That is in the maps and in the dictionary's filters. Weights that are 0 stay 0, so on the
        support of a non-negative code the derivative is that of its non-negative least squares.
        """
        check_shape("SphericalSparseCoder's maps", maps.shape, self.height, 2 * self.height, 3)
        # in float64: atoms that are alike have no inverse of their Gram matrix in float32
        atoms = self._sampled_atoms(codes).flatten(-2).double()
        solid_angles = self.transform.solid_angles.expand(-1, 2 * self.height).flatten()
        weighted = atoms * solid_angles.double()
        target = maps.double().flatten(-3, -2)
        right = (weighted @ target).mT[..., None]  # (*batch, 3, k, 1)
        used = (codes.weights != 0).mT
        gram = (weighted @ atoms.mT)[..., None, :, :] * (used[..., None] & used[..., None, :])
        diagonal = gram.diagonal(dim1=-2, dim2=-1)
        # what is no activation has no atom
        extra = torch.where(diagonal > 0, _RIDGE * diagonal, 1)
        # the ridge leaves nothing to check, for which a device would wait
        solved, _ = torch.linalg.solve_ex(gram + torch.diag_embed(extra), right * used[..., None])
        return codes._replace(weights=solved[..., 0].mT.to(maps.dtype))

    def relative_error(
        self, maps: Float[Tensor, "*batch h w 3"], codes: CodeTensors
    ) -> Float[Tensor, "*batch"]:
        """``|x - decode(codes)| / |x|``, weighted by solid angle, over all colours."""
        weight = self.transform.solid_angles[..., None].to(maps.dtype)
        missed = (maps - self.decode(codes)).square() * weight
        return (missed.sum((-3, -2, -1)) / (maps.square() * weight).sum((-3, -2, -1))).sqrt()

    def decode(
        self, codes: CodeTensors | SparseCode, height: int | None = None
    ) -> Float[Tensor, "*batch h w c"]:
        """The coded maps at any number of rows; negative where weights of either sign make it so.

        Boxes of pixels are constant within their borders, at any height; a pixel that a border
        crosses gets its mean.

        Differentiable in weights, rotations and filters.
        """
        if isinstance(codes, SparseCode):
            self.check(codes)
            codes = codes.tensors().to(self.bank.unnormalised.device)
        if height is None or height == self.height:
            return self.decode_on(self.transform, codes)
        return self.decode_on(LatLongTransform(self.degree, height).to(codes.weights.device), codes)

    def decode_on(
        self, transform: LatLongTransform, codes: CodeTensors
    ) -> Float[Tensor, "*batch h w c"]:
        """:meth:`decode` on the rows of a transform of :attr:`degree`, which is made only once."""
        maps = transform.synthesise(self.coefficients(codes).mT).movedim(-3, -1)
        for part in self.parts:
            if isinstance(part, BoxDictionary):
                boxes = _sum_of_boxes(part, codes)
                if maps.shape[-3] != self.height:
                    boxes = averaged(boxes, maps.shape[-3])
                maps = maps + boxes.to(maps.dtype)
        return maps.to(codes.weights.dtype)

    def coefficients(self, codes: CodeTensors) -> Float[Tensor, "*batch k c"]:
        """``sum_j R_j d_j w_j`` about the zenith, pixels left out; differentiable."""
        atoms = rotated_atoms(self.parts, codes)
        return atoms.mT @ codes.weights.to(atoms.dtype)

    def _sampled_atoms(self, codes: CodeTensors) -> Float[Tensor, "*batch s h w"]:
        """The atoms on the pixels of the coder's maps."""
        atoms = self.transform.synthesise(rotated_atoms(self.parts, codes))
        for part in self.parts:
            if isinstance(part, BoxDictionary):
                down, across = part.sides(codes)
                atoms = torch.addcmul(atoms, down[..., None].to(atoms.dtype), across[..., None, :])
        return atoms

    def sparse_code(self, code: CodeTensors, relative_error: float) -> SparseCode:
        """One unbatched code with all that a file of it says."""
        n = int(code.count)
        rotations = code.rotations[:n].detach().cpu().double()
        return SparseCode(
            dictionary=self.bank.name,
            fingerprint=self.bank.fingerprint,
            height=self.height,
            banded=self.banded,
            filters=code.filters[:n].cpu(),
            directions=centres_of(rotations),
            twists_rad=rotations[:, 2],
            weights=code.weights[:n].detach().cpu().double(),
            relative_error=relative_error,
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
        for part in self.parts:
            if isinstance(part, BoxDictionary):
                mine = code.filters >= part.first  # it is the last part
                top, rows, _, _ = part.spans(code.filters[mine], code.rotations[mine]).unbind(1)
                if bool(((top < 0) | (top + rows > self.height)).any()):
                    raise InputError(
                        "the code has a box over a pole: it is damaged; code the map again"
                    )


def _sum_of_boxes(part: BoxDictionary, codes: CodeTensors) -> Float[Tensor, "*batch h w c"]:
    """The boxes of codes, each in its colour, at the coder's own height."""
    down, across = part.sides(codes)
    with full_precision(down):  # borders are told to the last digit
        coloured = across[..., None] * codes.weights.to(down)[..., None, :]  # (*batch, s, w, c)
        rows = down.mT @ coloured.flatten(-2)
        return rows.unflatten(-1, coloured.shape[-2:])


def pixel_of(
    directions: Float[Tensor, "*s 3"], layout: tuple[int, int] | None
) -> Int[Tensor, "*s"]:
    """The index of the pixel of a lat-long layout that each direction falls in."""
    assert layout is not None
    height, width = layout
    row, column = pixel_from_direction(directions, height, width)
    return row.round().long().clamp(0, height - 1) * width + column.round().long() % width


@contextmanager
def _one_thread_each(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Workers of one thread: a pursuit's steps are too short to share well."""
    before = torch.get_num_threads()
    try:
        with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield pool
    finally:
        torch.set_num_threads(before)


def coder_for(code: SparseCode, dictionary: str | Path | None = None) -> SphericalSparseCoder:
    """The coder that decodes ``code``; ``dictionary`` is the file of one that is not built in."""
    source = code.dictionary if dictionary is None else str(dictionary)
    return SphericalSparseCoder(source, height=code.height, banded=code.banded)
