"""Correlation of a spherical signal with rotated filters, for every rotation of a grid at once.

What every pursuit needs is ``<R d_i, r>`` for all filters d_i and all N T rotations of
:class:`~skylight.csc._positions.Positions`: minus the gradient of the squared loss
(thesis, Eq. 6.6). With complex coefficients r_lm, d_lm, and Wigner's functions, ::

    <R(alpha, beta, gamma) d, r>
        = sum_mn e^(i m alpha) e^(i n gamma) [ sum_l d^l_mn(beta) r_lm conj(d_ln) ]

so the bracket is one matrix product per n, over l and for all filters, rows and m together, and the
outer sum two FFTs (Kostelec and Rockmore 2008, "FFTs on the rotation group"; the thesis rotates the
residual instead). Orders that the grid does not tell apart are added up before the product: n that
are equal modulo the twists, m modulo the columns (:mod:`skylight.csc._correlation`).

Symmetric filters cost less, and equal rotations of them are evaluated once: a filter with an s-fold
axis has coefficients only for n = 0, s, 2s, ... and repeats after T / s twists; a mirror symmetric
one has real coefficients. Filters are grouped by the two. Isotropic filters, which no twist
changes, are products in the SH domain (:class:`ZonalCorrelation`).

:func:`rotated_filters` are single filters after any rotations, the atoms of a code.
"""

import math
from collections.abc import Iterator

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor, nn

from skylight._modes import full_precision, on_cpu, single
from skylight._module import Module
from skylight.csc._correlation import FilterGroup, signed_orders, spans_of
from skylight.csc._positions import Chunk, Positions, by_signal
from skylight.errors import check_shape
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._rotation import wigner_small

_ABSENT = 1e-12  # relative energy below which a coefficient is rounding
_CACHED = 2**18  # coefficients rotated together: of their pairs, 4 MB, most stay in caches


def complex_coefficients(coefficients: Float[Tensor, "*c k"]) -> Complex[Tensor, "*c l m"]:
    """``(c_lm - i s_lm) / sqrt 2`` for m > 0 and c_l0: those of ``e^(i m phi)``, m = 0 .. K.

    Zero where m > l; those of -m are the conjugates.
    """
    degree = harmonics.degree_of(coefficients.shape[-1])
    l = torch.arange(degree + 1, device=coefficients.device)[:, None]  # noqa: E741
    m = torch.arange(degree + 1, device=coefficients.device)[None]
    inside = (m <= l).to(coefficients.dtype)
    scale = inside * torch.full_like(inside, math.sqrt(0.5)).masked_fill(m == 0, 1)
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


class RotationCorrelation(Module):
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

    @on_cpu
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
        m = torch.arange(self.degree + 1, dtype=torch.float64, device=filters.device)
        # longitudes start half a column before 0 and run backwards
        phase = torch.polar(torch.ones_like(m), -math.pi * m / positions.columns)
        phase = phase.to(torch.promote_types(dtype, torch.complex64))
        self.register_buffer("phase", phase, persistent=False)
        signed = signed_orders(spans_of(self.degree, positions.columns)).to(filters.device)
        self.register_buffer("signed", signed, persistent=False)

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
            flat.new_empty(
                len(flat),
                each.twists,
                len(each.members),
                p.rows,
                p.columns,
                dtype=self.phase.real.dtype,
            )
            for each in self.groups
        ]
        with full_precision(flat):  # complex numbers have no eight bits
            for chunk in self.in_chunks(flat):
                out[chunk.group][chunk.signals, :, :, chunk.rows] = chunk.values.movedim(3, 1)
        return [values.view(*residual.shape[:-1], *values.shape[1:]) for values in out]

    def in_chunks(self, residuals: Float[Tensor, "s k"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        check_shape("residuals", residuals.shape, (self.degree + 1) ** 2)
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
        out = found[0].new_empty(*residual.shape[:-1], twists, self.count, p.rows, p.columns)
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
        double precision; :func:`skylight.csc._wigner.rotated_filters` takes any angles.
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


def atom_norms(
    correlation: RotationCorrelation, transform: LatLongTransform
) -> list[Float[Tensor, "_ _ rows 1"]]:
    """``sqrt(sum_w dw |(R d)(w)|^2)`` over a map's pixels, per group of the correlation.

    Filters have unit norm over the sphere. Sampled on 32 rows, those of degree 40 have norms from
    0.99 to 1.09, according to how their centres lie between the pixels'. The columns of positions
    and map must be the same, so that the longitude does not matter.
    """
    device = correlation.phase.device
    m = torch.arange(correlation.degree + 1, dtype=torch.float64, device=device)
    # the longitude of column 0
    phase = torch.polar(torch.ones_like(m), -float(correlation.positions.alpha[0]) * m)
    phase = phase.to(correlation.phase.dtype)
    norms = []
    for spectra in correlation.spectra():
        rows = []
        for row in spectra:  # (t, f, l, m) of one row
            maps = transform.synthesise(real_coefficients(row * phase))
            weighted = maps.square() * transform.solid_angles.to(maps)
            rows.append(weighted.sum((-2, -1)).sqrt())
        norms.append(torch.stack(rows, -1)[..., None])
    return norms


def is_zonal(filters: Float[Tensor, "f k"]) -> bool:
    """Whether all filters are isotropic: nothing but rounding at orders other than 0."""
    squares = filters.double().square()
    orders = harmonics.orders(harmonics.degree_of(filters.shape[1])).to(filters.device)
    other = squares[:, orders != 0].sum(1)
    allowed = max(1e-12, torch.finfo(filters.dtype).eps ** 2)
    return bool((other <= allowed * squares.sum(1)).all())


class ZonalCorrelation(Module):
    """``<R d_i, r>`` for isotropic d_i at every direction of ``positions`` (thesis, 6.4.3).

    ``B diag(Pi d_i) r`` with ``Pi = sqrt(4 pi / (2 l + 1))`` (Eq. 6.8, C.2): each filter scales the
    bands of the residual, and one transform per filter evaluates it at the directions. The same
    interface as :class:`~skylight.csc._wigner.RotationCorrelation`, at a fraction of its
    memory where the degree is high: K^2 rows numbers instead of K^3 rows.
    """

    bands: Tensor
    band_of: Tensor

    @on_cpu
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
        self.index = {i: (0, i) for i in range(self.count)}
        if not is_zonal(filters):
            raise ValueError("only isotropic filters have a zonal correlation")
        self.register_buffer(
            "bands", harmonics.zonal_factors(filters.double()).to(dtype), persistent=False
        )
        bands = harmonics.bands(self.degree).to(filters.device)
        self.register_buffer("band_of", bands, persistent=False)
        self.transform = LatLongTransform(self.degree, positions.rows).to(filters.device, dtype)

    def members(self, group: int) -> tuple[int, ...]:
        return tuple(range(self.count))

    def by_group(
        self, residual: Float[Tensor, "*batch k"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]:
        """One group, one twist."""
        check_shape("residuals", residual.shape, len(self.band_of))
        weighted = self.bands[:, self.band_of] * residual.to(self.bands.dtype)[..., None, :]
        return [self.transform.synthesise(weighted)[..., None, :, :, :]]

    def in_chunks(self, residuals: Float[Tensor, "s k"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        return by_signal(residuals, lambda some: self.by_group(some)[0])

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        """``sqrt(4 pi / (2l + 1)) d_l Y_lm(direction)``: the addition theorem."""
        row, column, _ = places.to(self.bands.device).unbind(1)
        basis = self.transform.basis_at(row, column).double()
        return basis * self.bands.double()[filters.to(self.bands.device)][:, self.band_of]


class FilterRotation(Module):
    """``R_j d_j`` of filters about the zenith, each with its own rotation (thesis, Eq. 6.9).

    With the Euler angles (alpha, beta, gamma) and a quarter turn Q = Ry(pi / 2), ::

        R = Rz(alpha - pi / 2) Q^T Rz(beta) Q Rz(gamma + pi / 2)

    (Risbo 1996, "Fourier transform summation of Legendre series and D-functions"): turns about the
    axis mix cosine and sine of each order, and Q is one table of each band, which keeps cosines
    and sines apart. So nothing depends on which angles there are, and all is differentiable.

    ``zonal`` says that no filter has orders other than 0, which halves the work.
    """

    quarter: Tensor
    place: Tensor
    back: Tensor

    @on_cpu
    def __init__(self, degree: int, *, zonal: bool = False) -> None:
        super().__init__()
        self.zonal = zonal
        size = degree + 1
        m, l = torch.arange(size), torch.arange(size)[:, None]  # noqa: E741
        # coefficients of cosines and of sines; where m > l the quarter turn is 0, any place does
        place = l * (l + 1) + torch.stack([m.expand(size, -1), -m.expand(size, -1)])
        self.register_buffer("place", place.clamp(0, size**2 - 1), persistent=False)
        bands, orders = harmonics.bands(degree), harmonics.orders(degree)
        back = ((orders < 0) * size + bands) * size + orders.abs()
        self.register_buffer("back", back, persistent=False)
        quarter = torch.zeros(2, size, size, size, dtype=torch.float64)
        turn = torch.tensor([math.pi / 2], dtype=torch.float64)
        for l, (d,) in enumerate(wigner_small(turn, degree)):  # noqa: E741
            plus, minus = d[l:, l:], d[l:, : l + 1].flip(1)
            scale = torch.ones(l + 1, dtype=torch.float64)
            scale[0] = math.sqrt(0.5)
            quarter[0, l, : l + 1, : l + 1] = (plus + minus) * scale[:, None] * scale
            quarter[1, l, 1 : l + 1, 1 : l + 1] = (plus - minus)[1:, 1:]
        self.register_buffer("quarter", quarter.flatten(0, 1), persistent=False)

    def forward(
        self, filters: Float[Tensor, "s k"], rotations: Float[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        """The filters' coefficients, rotated."""
        with full_precision(filters):  # of eight bits no sharp filter is left
            filters, rotations = single(filters), rotations.to(single(filters))
            if torch.compiler.is_compiling():  # which must not depend on how many there are
                return self._rotated(filters, rotations)
            some = max(16, _CACHED // filters.shape[1])
            parts = zip(filters.split(some), rotations.split(some), strict=True)
            return torch.cat([self._rotated(*part) for part in parts])

    def _rotated(
        self, filters: Float[Tensor, "s k"], rotations: Float[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        alpha, beta, gamma = rotations.unbind(1)
        quarter = self.quarter.to(filters)
        if self.zonal:
            pairs = quarter.chunk(2)[0][..., :1] * filters.T[self.place[0, :, 0]][:, None]
            pairs = self._turned((pairs,), beta)
        else:
            pairs = self._turned(filters.T[self.place].unbind(), gamma + math.pi / 2)
            pairs = self._turned((quarter @ pairs).chunk(2), beta)
        pairs = self._turned((quarter.mT @ pairs).chunk(2), alpha - math.pi / 2)
        return pairs.flatten(0, 1)[self.back].T

    def _turned(
        self, pairs: tuple[Float[Tensor, "l m s"], ...], angle_rad: Float[Tensor, " s"]
    ) -> Float[Tensor, "l2 m s"]:
        """Coefficients of cosines and, if any, of sines of order m, turned by m times the angle."""
        cosine, *sines = pairs
        m = torch.arange(cosine.shape[1], device=cosine.device)
        angle = m[:, None] * angle_rad
        across, along = torch.sin(angle), torch.cos(angle)
        turned = along * cosine, across * cosine
        for sine in sines:
            turned = turned[0].addcmul(across, sine, value=-1), turned[1].addcmul(along, sine)
        return torch.cat(turned)


def rotated_filters(
    filters: Float[Tensor, "s k"], rotations: Float[Tensor, "s 3"]
) -> Float[Tensor, "s k"]:
    """:class:`FilterRotation` of filters (s, (K+1)^2) by Euler angles (s, 3), differentiable."""
    degree = harmonics.degree_of(filters.shape[1])
    return FilterRotation(degree).to(filters.device)(filters, rotations)
