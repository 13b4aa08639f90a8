"""Correlation of a spherical signal with rotated filters, for every rotation of a grid at once.

What every pursuit needs is ``<R d_i, r>`` for all filters d_i and all N T rotations of
:class:`~skylight.csc.correlation.positions.Positions`: minus the gradient of the squared loss
(thesis, Eq. 6.6). With complex coefficients r_lm, d_lm, and Wigner's functions, ::

    <R(alpha, beta, gamma) d, r>
        = sum_mn e^(i m alpha) e^(i n gamma) [ sum_l d^l_mn(beta) r_lm conj(d_ln) ]

so the bracket is one matrix product per n, over l and for all filters, rows and m together, and the
outer sum two FFTs (Kostelec and Rockmore 2008, "FFTs on the rotation group"; the thesis rotates the
residual instead). Orders that the grid does not tell apart are added up before the product: n that
are equal modulo the twists, m modulo the columns (:mod:`skylight.csc.correlation.filter_group`).

Symmetric filters cost less, and equal rotations of them are evaluated once: a filter with an s-fold
axis has coefficients only for n = 0, s, 2s, ... and repeats after T / s twists; a mirror symmetric
one has real coefficients. Filters are grouped by the two.
"""

import math
from collections.abc import Iterator

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor, nn

from skylight.csc.correlation.chunk import Chunk
from skylight.csc.correlation.filter_group import FilterGroup, signed_orders, spans_of
from skylight.csc.correlation.positions import Positions
from skylight.sphere import harmonics

_ABSENT = 1e-12  # relative energy below which a coefficient is rounding


def complex_coefficients(coefficients: Float[Tensor, "*c k"]) -> Complex[Tensor, "*c l m"]:
    """``(c_lm - i s_lm) / sqrt 2`` for m > 0 and c_l0: those of ``e^(i m phi)``, m = 0 .. K.

    Zero where m > l; those of -m are the conjugates.
    """
    degree = harmonics.degree_of(coefficients.shape[-1])
    l = torch.arange(degree + 1, device=coefficients.device)[:, None]  # noqa: E741
    m = torch.arange(degree + 1, device=coefficients.device)[None]
    inside = (m <= l).to(coefficients)
    root = coefficients.new_tensor(math.sqrt(0.5))
    scale = inside * torch.where(m == 0, torch.ones_like(root), root)
    cosine = coefficients[..., (l * (l + 1) + m).clamp(max=coefficients.shape[-1] - 1)] * scale
    sine = coefficients[..., (l * (l + 1) - m).clamp(min=0)] * scale * (m > 0)
    return torch.complex(cosine, -sine)


def real_coefficients(spectrum: Complex[Tensor, "*c l m"]) -> Float[Tensor, "*c k"]:
    """Inverse of :func:`complex_coefficients`."""
    degree = spectrum.shape[-1] - 1
    out = spectrum.real.new_empty(*spectrum.shape[:-2], (degree + 1) ** 2)
    m, l = torch.triu_indices(degree + 1, degree + 1, device=spectrum.device)  # noqa: E741
    pairs = spectrum[..., l, m] * math.sqrt(2)
    # m = 0 has no sine: its place is written by the cosine, which is last
    out[..., l * (l + 1) - m] = -pairs.imag
    out[..., l * (l + 1) + m] = torch.where(m > 0, pairs.real, spectrum[..., l, m].real)
    return out


def fold(spectrum: Complex[Tensor, "l m"], twists: int) -> int:
    """Largest s that divides ``twists`` with energy at orders 0, s, 2s, ... only."""
    energy = spectrum.abs().square().sum(0)
    present = torch.nonzero(energy > _ABSENT * energy.sum())[:, 0].tolist()
    return math.gcd(twists, *present)


class RotationCorrelation(nn.Module):
    """``<R d_i, r>`` for all filters d_i and all rotations R of ``positions``.

    For one signal about ``rows K^3`` products per filter and ``N T log(N T)`` for the transforms;
    4 N T M bytes of result, where T counts the twists that differ, and some 20 MB on the way: 52 MB
    for 200 filters without symmetry at 32 x 64 x 32.

    Parameters
    ----------
    filters : coefficients about the zenith, at the zenith.
    dtype : of the arithmetic; residuals are converted to it.
    """

    phase: Tensor
    signed: Tensor

    def __init__(
        self,
        filters: Float[Tensor, "f k"],
        positions: Positions,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.positions, self.dtype = positions, dtype
        self.degree = harmonics.degree_of(filters.shape[1])
        self.count = len(filters)
        self._groups = nn.ModuleList(
            _grouped(complex_coefficients(filters.double()), positions, dtype)
        )
        self.index = {
            filter_: (group, place)
            for group, each in enumerate(self.groups)
            for place, filter_ in enumerate(each.members)
        }
        """Filter -> its group in :meth:`by_group`, and its place there."""
        m = torch.arange(self.degree + 1, dtype=torch.float64)
        # longitudes start half a column before 0 and run backwards
        phase = torch.polar(torch.ones_like(m), -math.pi * m / positions.columns)
        phase = phase.to(torch.promote_types(dtype, torch.complex64))
        self.register_buffer("phase", phase, persistent=False)
        self.register_buffer(
            "signed", signed_orders(spans_of(self.degree, positions.columns)), persistent=False
        )

    @property
    def groups(self) -> list[FilterGroup]:
        """Filters of one symmetry each, the most symmetric first."""
        return [each for each in self._groups if isinstance(each, FilterGroup)]

    def members(self, group: int) -> tuple[int, ...]:
        """The filters of a group, in the order of :meth:`by_group`."""
        return self.groups[group].members

    def by_group(
        self, residual: Float[Tensor, "*batch k"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]:
        """The correlations per group of filters, at the twists that differ."""
        flat = residual.reshape(-1, residual.shape[-1])
        p = self.positions
        out = [
            self.phase.real.new_empty(len(flat), each.twists, len(each.members), p.rows, p.columns)
            for each in self.groups
        ]
        for chunk in self.in_chunks(flat):
            out[chunk.group][chunk.signals, :, :, chunk.rows] = chunk.values.movedim(3, 1)
        return [values.view(*residual.shape[:-1], *values.shape[1:]) for values in out]

    def in_chunks(self, residuals: Float[Tensor, "s k"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        r = complex_coefficients(residuals.to(self.dtype)) * self.phase
        chosen = r[..., self.signed.abs()]
        signals = torch.where(self.signed < 0, chosen, chosen.conj())
        for number, group in enumerate(self.groups):
            for some, rows, values in group.in_chunks(signals):
                yield Chunk(number, some, rows, values)

    def forward(
        self, residual: Float[Tensor, "*batch k"]
    ) -> Float[Tensor, "*batch f rows columns t"]:
        """All of them, twists that repeat repeated; twists vary slowest in memory."""
        twists, found = self.positions.twists, self.by_group(residual)
        if len(found) == 1 and found[0].shape[-4] == twists:
            return found[0].movedim(-4, -1)
        p = self.positions
        out = self.phase.real.new_empty(*residual.shape[:-1], twists, self.count, p.rows, p.columns)
        for group, values in zip(self.groups, found, strict=True):
            repeats = twists // values.shape[-4]
            out[..., list(group.members), :, :] = torch.cat([values] * repeats, -4)
        return out.movedim(-4, -1)

    def spectra(self) -> Iterator[Iterator[Complex[Tensor, "t f l m"]]]:
        """Per group, row by row: all its filters at that row and its twists, at longitude 0."""
        return (group.spectra() for group in self.groups)

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        """Coefficients of filter j rotated to (row, column, twist) j: the adjoint of correlating.

        ``f'_lm = e^(-i m alpha) sum_n d^l_mn(beta) e^(-i n gamma) f_ln`` from the same tables, in
        double precision; :func:`skylight.csc.correlation.rotated.rotated_filters` takes any angles.
        """
        device = self.phase.device
        alpha, _, gamma = self.positions.rotations(places).to(device).unbind(1)
        where = [self.index[filter_] for filter_ in filters.tolist()]
        m = torch.arange(self.degree + 1, device=device)
        out = torch.empty(
            len(where), self.degree + 1, self.degree + 1, dtype=torch.complex128, device=device
        )
        for number, group in enumerate(self.groups):
            mine = [j for j, (of, _) in enumerate(where) if of == number]
            members = torch.tensor([where[j][1] for j in mine], device=device)
            if mine:
                out[mine] = group.rotated(members, places[mine, 0].to(device), gamma[mine])
        angle = -alpha[:, None] * m
        return real_coefficients(out * torch.polar(torch.ones_like(angle), angle)[:, None])


def _grouped(
    spectrum: Complex[Tensor, "f l m"], positions: Positions, dtype: torch.dtype
) -> list[FilterGroup]:
    """Filters of the same symmetry together, the most symmetric first."""
    kinds: dict[tuple[int, bool], list[int]] = {}
    for i, one in enumerate(spectrum):
        mirror = bool(one.imag.square().sum() <= _ABSENT * one.abs().square().sum())
        kinds.setdefault((fold(one, positions.twists), mirror), []).append(i)
    groups = []
    for (symmetry, mirror), members in sorted(kinds.items(), reverse=True):
        energy = spectrum[members].abs().square().sum((0, 1))
        positive = torch.nonzero(energy > _ABSENT * energy.sum())[:, 0].tolist()
        groups.append(
            FilterGroup(
                spectrum[members],
                tuple(members),
                positions,
                orders=(*positive, *(-n for n in positive if n > 0)),
                fold=symmetry,
                mirror=mirror,
                dtype=dtype,
            )
        )
    return groups
