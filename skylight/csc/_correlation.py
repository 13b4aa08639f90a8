"""Filters of one symmetry: their tables, and the sums over bands and orders that turn them."""

from collections.abc import Iterator

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor

from skylight._module import Module
from skylight.csc._positions import Positions
from skylight.sphere._rotation import wigner_small

_ROWS_AT_ONCE = 8  # of Wigner functions, which take 8 (2 l + 1)^2 bytes for each row and band
_CACHED = 2**18  # complex numbers, 2 MB: what one core's FFTs go through stays in its cache
_ON_DEVICE = 2**27  # the same where kernels should be few and long: 1 GB


class FilterGroup(Module):
    """Filters that have coefficients at the orders ``orders`` only, all multiples of ``fold``.

    Twists repeat after ``t = twists / fold``, so order n counts as ``slot = n / fold mod t``; and
    orders m of a signal as ``m mod columns``, of which the half spectrum ``0 .. columns / 2`` is
    enough for real results. Both are folded before anything is multiplied: each slot is one matrix
    product over its pairs (l, n), j of them, for all filters, rows and m together.

    Parameters
    ----------
    spectrum : the members' coefficients, complex128.
    orders : positive and negative ones at which a member has energy.
    mirror : whether coefficients are real; their products are real then.
    """

    filters: Tensor
    wigner: Tensor
    band: Tensor
    order: Tensor

    def __init__(
        self,
        spectrum: Complex[Tensor, "f l m"],
        members: tuple[int, ...],
        positions: Positions,
        *,
        orders: tuple[int, ...],
        fold: int,
        mirror: bool,
        dtype: torch.dtype,
    ) -> None:
        super().__init__()
        device = spectrum.device
        self.members, self.positions, self.mirror = members, positions, mirror
        self.degree = spectrum.shape[-1] - 1
        self.twists = positions.twists // fold
        self.spans = spans_of(self.degree, positions.columns)
        slots: list[list[tuple[int, int]]] = [[] for _ in range(self.twists)]
        for n in orders:
            bands = range(abs(n), self.degree + 1)
            slots[n // fold % self.twists] += zip(bands, [n] * len(bands), strict=True)
        longest = max(len(pairs) for pairs in slots)
        # slots of fewer pairs are filled up; the filters' table is 0 there
        filled = torch.tensor([pairs + [(0, 0)] * (longest - len(pairs)) for pairs in slots])
        filled = filled.long().reshape(self.twists, longest, 2).to(device)  # of no pair too
        used = torch.arange(longest) < torch.tensor([[len(pairs)] for pairs in slots])
        used = used.to(device)
        band, order = filled.unbind(-1)
        table = spectrum[:, band, order.abs()]  # (f, t, j); those of -n are the conjugates
        table = torch.where(order < 0, table.conj(), table) * used
        table = table.real.to(dtype) if mirror else table.to(_complex(dtype))
        self.register_buffer("filters", table.movedim(0, 1).contiguous(), persistent=False)
        self.register_buffer("band", band, persistent=False)
        self.register_buffer("order", order, persistent=False)
        beta = positions.beta.to(device)
        wigner = torch.cat([self._wigner(rows) for rows in beta.split(_ROWS_AT_ONCE)], 2)
        # products of such small numbers are subnormal, and slow, and add nothing
        wigner = torch.where(wigner.abs() < 1e-5 * torch.finfo(dtype).eps, 0.0, wigner).to(dtype)
        # twice each, to scale real and imaginary parts alike
        self.register_buffer("wigner", wigner.repeat_interleave(2, -1), persistent=False)

    def _wigner(self, beta: Float[Tensor, " b"]) -> Float[Tensor, "t j b m"]:
        """d^l_mn(beta) for the pairs (l, n) of each slot and all m of the spans."""
        m = signed_orders(self.spans).to(beta.device)
        out = beta.new_zeros(*self.band.shape, len(beta), len(m))
        for l, table in enumerate(wigner_small(beta, self.degree)):  # noqa: E741
            slot, pair = torch.nonzero(self.band == l).unbind(1)
            inside = m.abs() <= l
            of_order = table[:, :, self.order[slot, pair] + l].permute(2, 0, 1)
            out[slot, pair] = of_order[..., (m + l).clamp(0, 2 * l)] * inside
        return out

    def in_chunks(
        self, signals: Complex[Tensor, "s l n"]
    ) -> Iterator[tuple[slice, slice, Float[Tensor, "_ f b t columns"]]]:
        """``sum_mn e^(i m alpha) e^(i n gamma) sum_l d^l_mn(beta) r_lm conj(d_ln)``.

        ``signals`` are ``conj(r_lm)`` at the m of the spans: conjugates are how a real inverse FFT
        wants its half spectrum. Some signals and rows at a time, and which.
        """
        p = self.positions
        budget = _CACHED if signals.device.type == "cpu" else _ON_DEVICE
        at_once = max(1, budget // (self.twists * len(self.members) * self._width))
        together = max(1, at_once // p.rows)
        chosen = torch.view_as_real(signals)[:, self.band].flatten(-2)  # (s, t, j, 2 m)
        chosen = chosen.movedim(0, 2).contiguous()
        for first in range(0, p.rows, at_once):
            rows = slice(first, min(first + at_once, p.rows))
            for start in range(0, len(signals), together):  # inside: the rows' tables stay cached
                some = slice(start, start + together)
                sums = self._sums(chosen[:, :, some], rows)
                # sum_n e^(-i n gamma_t), where twists differ
                spectrum = torch.fft.fft(sums, dim=0) if self.twists > 1 else sums
                values = torch.fft.irfft(spectrum, n=p.columns, norm="forward")
                yield some, rows, values.permute(2, 1, 3, 0, 4)

    @property
    def _width(self) -> int:
        """How many orders of the half spectrum there are."""
        return self.spans[0].stop

    def _sums(
        self, signals: Float[Tensor, "t j s m2"], rows: slice
    ) -> Complex[Tensor, "t f s b m"]:
        """The sums over l, n that count as one slot, and m that count as one column."""
        chosen, table = signals[:, :, :, None], self.wigner[:, :, None, rows]
        start = 2 * self._width
        turned = table[..., :start] * chosen[..., :start]
        for span in self.spans[1:]:
            here = slice(start, start + 2 * len(span))
            column = 2 * (span.start % self.positions.columns)
            counted = turned[..., column : column + 2 * len(span)]
            counted += table[..., here] * chosen[..., here]
            start = here.stop
        shape = (*turned.shape[2:4], self._width)
        if self.mirror:
            sums = torch.bmm(self.filters, turned.flatten(2))
            return torch.view_as_complex(sums.unflatten(-1, (*shape, 2)))
        complex_ = torch.view_as_complex(turned.unflatten(-1, (-1, 2)))
        return torch.bmm(self.filters, complex_.flatten(2)).unflatten(-1, shape)

    def spectra(self) -> Iterator[Complex[Tensor, "t f l m"]]:
        """Row by row, all filters rotated to longitude 0 of that row, at their twists."""
        bands, complex_ = self.degree + 1, _complex(self.filters.dtype)
        for row in range(self.positions.rows):
            sums = self.filters.new_zeros(
                self.twists, len(self.members), bands, self.wigner.shape[-1] // 2, dtype=complex_
            )
            table = self.wigner[:, None, :, row, ::2]
            for total, filters, turn, band in zip(
                sums, self.filters, table, self.band, strict=True
            ):
                total.index_add_(1, band, (filters[..., None] * turn).to(complex_))
            # sum_n e^(-i n gamma_t)
            yield self._positive(torch.fft.fft(sums, dim=0))

    def rotated(
        self, members: Int[Tensor, " s"], rows: Int[Tensor, " s"], gamma: Float[Tensor, " s"]
    ) -> Complex[Tensor, "s l m"]:
        """``sum_n d^l_mn(beta) e^(-i n gamma) f_ln``: members at longitude 0, complex128."""
        angle = -gamma[:, None, None] * self.order
        turn = torch.polar(torch.ones_like(angle), angle)
        weights = self.filters[:, members].movedim(1, 0) * turn
        tilt = self.wigner[:, :, rows, ::2].movedim(2, 0)
        out = weights.new_zeros(len(rows), self.degree + 1, tilt.shape[-1])
        out.index_add_(1, self.band.flatten(), (weights[..., None] * tilt).flatten(1, 2))
        return self._positive(out)

    def _positive(self, spectrum: Complex[Tensor, "*c m"]) -> Complex[Tensor, "*c _"]:
        """The orders 0 .. degree of real functions, from those of the spans."""
        m = signed_orders(self.spans).tolist()
        wanted = range(self.degree + 1)
        same = [m.index(k if k in m else -k) for k in wanted]
        negative = torch.tensor([k not in m for k in wanted], device=spectrum.device)
        return torch.where(negative, spectrum[..., same].conj(), spectrum[..., same])


def spans_of(degree: int, columns: int) -> list[range]:
    """Orders m, ``|m| <= degree``, whose residue modulo ``columns`` is at most half of it.

    Intervals, the first from 0 on. Each m or -m is among them, and no more is needed of a real
    signal: m counts as ``m mod columns`` where the columns are samples.
    """
    half, spans = columns // 2, []
    for wrap in sorted(range(-degree // columns - 1, degree // columns + 2), key=abs):
        low = wrap * columns
        spans.append(range(max(low, -degree), min(low + half, degree) + 1))
    return [span for span in spans if len(span)]


def signed_orders(spans: list[range]) -> Int[Tensor, " m"]:
    """The orders of all spans, in their order."""
    return torch.tensor([m for span in spans for m in span])


def _complex(dtype: torch.dtype) -> torch.dtype:
    return torch.promote_types(dtype, torch.complex64)
