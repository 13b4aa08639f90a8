"""Correlation of a spherical signal with rotated filters, for every rotation of a grid at once.

What every pursuit needs is ``<R d_i, r>`` for all filters d_i and all N T rotations of
:class:`~skylight.csc.correlation.positions.Positions`: minus the gradient of the squared loss
(thesis, Eq. 6.6). With complex coefficients r_lm, d_lm, and Wigner's functions, ::

    <R(alpha, beta, gamma) d, r>
        = sum_mn e^(i m alpha) e^(i n gamma) [ sum_l d^l_mn(beta) r_lm conj(d_ln) ]

so the bracket is one matrix product per n, over l and for all filters, rows and m together, and the
outer sum two FFTs (Kostelec and Rockmore 2008, "FFTs on the rotation group"; the thesis rotates the
residual instead).

Symmetric filters cost less, and equal rotations of them are evaluated once: a filter with an s-fold
axis has coefficients only for n = 0, s, 2s, ... and repeats after T / s twists; a mirror symmetric
one has real coefficients. Filters are grouped by the two.
"""

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor, nn

from skylight.csc.correlation.positions import Positions
from skylight.sphere import harmonics
from skylight.sphere.rotation import wigner_small

_ROWS_AT_ONCE = 8  # of Wigner functions, which take 8 (2 l + 1)^2 bytes for each row and band
_CACHED = 2**20  # complex numbers
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


@dataclass(frozen=True, kw_only=True)
class _Group:
    """Filters of one symmetry, and the orders n at which they have coefficients."""

    members: tuple[int, ...]
    fold: int
    mirror: bool
    orders: tuple[int, ...]


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
        spectrum = complex_coefficients(filters.double())
        self._groups = _grouped(spectrum, positions.twists)
        self.index = {
            filter_: (group, place)
            for group, each in enumerate(self._groups)
            for place, filter_ in enumerate(each.members)
        }
        """Filter -> its group in :meth:`by_group`, and its place there."""
        complex_dtype = torch.promote_types(dtype, torch.complex64)
        for number, group in enumerate(self._groups):
            for n in group.orders:
                table = _order(spectrum[list(group.members)], n)
                table = table.real.to(dtype) if group.mirror else table.to(complex_dtype)
                self.register_buffer(_filter_name(number, n), table.contiguous(), persistent=False)
        for n, table in self._wigner_tables(dtype).items():
            self.register_buffer(_wigner_name(n), table, persistent=False)
        m = torch.arange(self.degree + 1, dtype=torch.float64)
        # longitudes start half a column before 0 and run backwards
        phase = torch.polar(torch.ones_like(m), -math.pi * m / positions.columns)
        self.register_buffer("phase", phase.to(complex_dtype), persistent=False)

    def _wigner_tables(self, dtype: torch.dtype) -> dict[int, Float[Tensor, "l b m"]]:
        """For each order n that a filter has: d^l_mn(beta) for l >= |n|, all rows, m >= 0."""
        k, beta, nothing = self.degree, self.positions.beta, 1e-5 * torch.finfo(dtype).eps
        orders = {n for group in self._groups for n in group.orders}
        tables = {n: torch.zeros(k + 1 - abs(n), len(beta), k + 1, dtype=dtype) for n in orders}
        for start in range(0, len(beta), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            for l, band in enumerate(wigner_small(beta[rows], k)):  # noqa: E741
                for n in orders:
                    if abs(n) <= l:
                        # products of such small numbers are subnormal, and slow, and add nothing
                        part = torch.where(band.abs() < nothing, 0.0, band)[:, l:, l + n]
                        tables[n][l - abs(n), rows, : l + 1] = part.to(dtype)
        return tables

    def by_group(self, residual: Float[Tensor, " k"]) -> list[Float[Tensor, "_ _ rows columns"]]:
        """The correlations per group of filters, at the twists that differ."""
        signal = (complex_coefficients(residual.to(self.dtype)) * self.phase).conj().resolve_conj()
        return [self._correlate(signal, number) for number in range(len(self._groups))]

    def members(self, group: int) -> tuple[int, ...]:
        """The filters of a group, in the order of :meth:`by_group`."""
        return self._groups[group].members

    def forward(self, residual: Float[Tensor, " k"]) -> Float[Tensor, "f rows columns t"]:
        p = self.positions
        out = self.phase.real.new_empty(self.count, p.rows, p.columns, p.twists)
        for group, values in zip(self._groups, self.by_group(residual), strict=True):
            repeats = p.twists // values.shape[0]
            out[list(group.members)] = values.permute(1, 2, 3, 0).repeat(1, 1, 1, repeats)
        return out

    def _correlate(
        self, signal: Complex[Tensor, "l m"], number: int
    ) -> Float[Tensor, "t f rows columns"]:
        """All in conjugates, which is how a real inverse FFT wants its half spectrum.

        Some rows at a time, so that what the FFTs go through stays in the processor's cache.
        """
        group, p = self._groups[number], self.positions
        twists, filters = p.twists // group.fold, len(group.members)
        out = self.phase.real.new_empty(twists, filters, p.rows, p.columns)
        at_once = max(1, _CACHED // (twists * filters * (self.degree + 1)))
        for start in range(0, p.rows, at_once):
            rows = slice(start, min(start + at_once, p.rows))
            sums = self._sums(signal, number, rows)
            # sum_n e^(-i n gamma_t), where twists differ
            spectrum = torch.fft.fft(sums, dim=0) if twists > 1 else sums
            out[:, :, rows] = self._over_columns(spectrum)
        return out

    def _sums(
        self, signal: Complex[Tensor, "l m"], number: int, rows: slice
    ) -> Complex[Tensor, "t f b m"]:
        """The bracket, for each order n modulo the twists."""
        group = self._groups[number]
        twists, filters = self.positions.twists // group.fold, len(group.members)
        sums = signal.new_empty(twists, filters, rows.stop - rows.start, self.degree + 1)
        written = set()
        for n in group.orders:
            wigner = self.get_buffer(_wigner_name(n))[:, rows]
            turned = (wigner * signal[abs(n) :, None]).flatten(1)
            table = self.get_buffer(_filter_name(number, n))
            slot = n // group.fold % twists
            target = sums[slot].view(filters, -1)
            if group.mirror:
                turned = torch.view_as_real(turned).flatten(1)
                target = torch.view_as_real(sums[slot]).view(filters, -1)
            if slot in written:
                target.addmm_(table, turned)
            else:
                torch.mm(table, turned, out=target)
                written.add(slot)
        for slot in set(range(twists)) - written:
            sums[slot] = 0
        return sums

    def _over_columns(self, spectrum: Complex[Tensor, "t f b m"]) -> Float[Tensor, "t f b columns"]:
        """``sum_m e^(-i m alpha)`` over m and -m; orders beyond the columns' Nyquist fold back."""
        columns = self.positions.columns
        half = columns // 2
        for m in range(half, self.degree + 1):
            near = (m + half) % columns - half  # -half .. half - 1
            order = spectrum[..., m]
            if near in (0, -half) and m > half:  # orders that are their own conjugates
                spectrum[..., -near] += 2 * order.real
            else:
                spectrum[..., abs(near)] += order if near > 0 else order.conj()
        return torch.fft.irfft(spectrum[..., : half + 1], n=columns, dim=3, norm="forward")

    def spectra(self) -> Iterator[Iterator[Complex[Tensor, "t f l m"]]]:
        """Per group, row by row: all its filters at that row and its twists, at longitude 0."""
        for number, group in enumerate(self._groups):
            yield (self._row_spectra(number, group, row) for row in range(self.positions.rows))

    def _row_spectra(self, number: int, group: _Group, row: int) -> Complex[Tensor, "t f l m"]:
        twists, size = self.positions.twists // group.fold, self.degree + 1
        sums = self.phase.new_zeros(twists, len(group.members), size, size)
        for n in group.orders:
            table = self.get_buffer(_filter_name(number, n))[:, :, None]
            turn = self.get_buffer(_wigner_name(n))[:, row]
            sums[n // group.fold % twists, :, abs(n) :] += table * turn
        # sum_n e^(-i n gamma_t)
        return torch.fft.fft(sums, dim=0)

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        """Coefficients of filter j rotated to (row, column, twist) j: the adjoint of correlating.

        ``f'_lm = e^(-i m alpha) sum_n d^l_mn(beta) e^(-i n gamma) f_ln`` from the same tables, in
        double precision; :func:`skylight.csc.correlation.rotated.rotated_filters` takes any angles.
        """
        alpha, _, gamma = self.positions.rotations(places).unbind(1)
        m = torch.arange(self.degree + 1, dtype=torch.float64)
        out = []
        for j, filter_ in enumerate(filters.tolist()):
            number, place = self.index[filter_]
            moved = self.phase.new_zeros(self.degree + 1, self.degree + 1, dtype=torch.complex128)
            for n in self._groups[number].orders:
                weight = self.get_buffer(_filter_name(number, n))[place].to(moved)
                weight = weight * cmath.exp(-1j * n * float(gamma[j]))
                turn = self.get_buffer(_wigner_name(n))[:, places[j, 0]]
                moved[abs(n) :] += turn * weight[:, None]
            moved *= torch.polar(torch.ones_like(m), -alpha[j] * m).to(moved)
            out.append(real_coefficients(moved))
        if not out:
            return self.phase.real.new_zeros(0, (self.degree + 1) ** 2, dtype=torch.float64)
        return torch.stack(out)


def _order(spectrum: Complex[Tensor, "f l m"], n: int) -> Complex[Tensor, "f i"]:
    """The coefficients of order n, l = |n| .. K; those of -n are the conjugates of those of n."""
    table = spectrum[:, abs(n) :, abs(n)]
    return (table.conj() if n < 0 else table).resolve_conj()


def _filter_name(group: int, n: int) -> str:
    return f"filters_{group}_{n}".replace("-", "minus")


def _wigner_name(n: int) -> str:
    return f"wigner_{n}".replace("-", "minus")


def _grouped(spectrum: Complex[Tensor, "f l m"], twists: int) -> list[_Group]:
    """Filters of the same symmetry together, the most symmetric first."""
    kinds: dict[tuple[int, bool], list[int]] = {}
    for i, one in enumerate(spectrum):
        mirror = bool(one.imag.square().sum() <= _ABSENT * one.abs().square().sum())
        kinds.setdefault((fold(one, twists), mirror), []).append(i)
    groups = []
    for (symmetry, mirror), members in sorted(kinds.items(), reverse=True):
        energy = spectrum[members].abs().square().sum((0, 1))
        positive = torch.nonzero(energy > _ABSENT * energy.sum())[:, 0].tolist()
        orders = (*positive, *(-n for n in positive if n > 0))
        groups.append(_Group(members=tuple(members), fold=symmetry, mirror=mirror, orders=orders))
    return groups
