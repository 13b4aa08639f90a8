"""Convolutional sparse coding of a lat-long map as if it were a picture, to compare with.

An atom is a filter as it looks on the map where it stands on the equator, shifted by whole pixels;
what leaves the map at one border comes in at the opposite one, at the poles as well. On the sphere
that is a filter that becomes narrower towards the poles.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor
from torch.fft import irfft2, rfft2

from skylight.csc._dictionary import FilterBank
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import direction_from_angles
from skylight.sphere._latlong_transform import LatLongTransform

Map = Float[Tensor, "h w 3"]


@dataclass(frozen=True, kw_only=True)
class Atom:
    """A filter of a :class:`PlanarDictionary`, and the pixel its centre is shifted to."""

    filter: int
    row: int
    column: int


class PlanarDictionary:
    """The filters of a bank on a lat-long grid, those without symmetry at ``twists`` angles.

    ``filters`` (m, height, 2 height), float32, of unit norm over pixels, centred on pixel (0, 0),
    the constant left out. Twists are equal steps of half a turn: Gaussians have no more.
    """

    def __init__(self, bank: FilterBank, height: int, *, twists: int) -> None:
        self.height = height
        zonal = harmonics.orders(bank.degree) == 0
        isotropic = (bank.coefficients.detach()[:, ~zonal] == 0).all(1)
        isotropic, anisotropic = isotropic & ~bank.constant, ~isotropic
        drawn = []
        for twist in range(twists):
            wanted = isotropic | anisotropic if twist == 0 else anisotropic
            rows = FilterBank(bank.coefficients.detach()[wanted], bank.name)
            drawn.append(rows.evaluate(_about_equator(height, math.pi * twist / twists)).detach())
        filters = torch.cat(drawn).reshape(-1, height, 2 * height)
        self.filters = (filters / filters.flatten(1).norm(dim=1)[:, None, None]).float()

    def __len__(self) -> int:
        return len(self.filters)

    @cached_property
    def spectra(self) -> Tensor:
        return rfft2(self.filters)

    @cached_property
    def squared_spectra(self) -> Tensor:
        return rfft2(self.filters.square())

    def correlation(self, grey: Float[Tensor, "h w"]) -> Float[Tensor, "m h w"]:
        """<grey, atom> of every filter at every pixel."""
        return irfft2(self.spectra.conj() * rfft2(grey.float()), s=grey.shape)

    def norms(self, weight: Float[Tensor, "h w"]) -> Float[Tensor, "m h w"]:
        """Every atom's norm where squares are weighted."""
        square = irfft2(self.squared_spectra.conj() * rfft2(weight.float()), s=weight.shape)
        return square.clamp(min=1e-12).sqrt()

    def drawn(self, atoms: list[Atom]) -> Float[Tensor, "k h w"]:
        return torch.stack(
            [self.filters[a.filter].roll((a.row, a.column), (0, 1)).double() for a in atoms]
        )


def solid_angles(height: int) -> Float[Tensor, "h w"]:
    """Of every pixel of a lat-long map, in sr."""
    return LatLongTransform(0, height).solid_angles.expand(height, 2 * height)


def refitted(truth: Map, dictionary: PlanarDictionary, atoms: list[Atom]) -> Map:
    """The least-squares sum of a constant and atoms, squares weighted by solid angle."""
    basis = torch.ones(1, *truth.shape[:2], dtype=torch.float64)
    if atoms:
        basis = torch.cat([basis, dictionary.drawn(atoms)])
    columns = basis.flatten(1).T
    scale = solid_angles(dictionary.height).reshape(-1, 1).sqrt()
    target = truth.double().flatten(0, 1)
    weights = torch.linalg.lstsq(columns * scale, target * scale, driver="gelsy").solution
    return (columns @ weights).reshape(truth.shape)


def pursued(
    truth: Map, dictionary: PlanarDictionary, counts: list[int], weight: Float[Tensor, "h w"]
) -> list[Map]:
    """Fits of several sizes, ascending, by orthogonal matching pursuit.

    The constant is the first activation; every further one has the largest correlation with the
    residual's principal colour for its norm, squares weighted by ``weight``.
    """
    norms, atoms, fits = dictionary.norms(weight), [], []
    for count in counts:
        while True:
            fit = refitted(truth, dictionary, atoms)
            if len(atoms) + 1 == count:
                break
            left = (truth.double() - fit) * weight[..., None]
            _, _, colours = torch.linalg.svd(left.flatten(0, 1), full_matrices=False)
            found = (dictionary.correlation(left @ colours[0]).abs() / norms).argmax()
            atoms.append(_atom(int(found), dictionary.height))
        fits.append(fit)
    return fits


def strongest(
    activations: Float[Tensor, "h w m"], counts: list[int], height: int
) -> list[list[Atom]]:
    """The largest activations, one less than each count for the constant, those at 0 left out."""
    flat = activations.permute(2, 0, 1).flatten()
    largest, place = flat.topk(max(counts))
    places = place[largest > 0].tolist()
    return [[_atom(p, height) for p in places[: count - 1]] for count in counts]


def _atom(place: int, height: int) -> Atom:
    filter_, pixel = divmod(place, 2 * height * height)
    row, column = divmod(pixel, 2 * height)
    return Atom(filter=filter_, row=row, column=column)


def _about_equator(height: int, twist_rad: float) -> Float[Tensor, "n 3"]:
    """The map's directions for a filter about the zenith that is to stand on the equator.

    Pixel (0, 0) is the filter's centre; offsets to the left and up are those beyond half the map.
    """
    step = math.pi / height
    down = _offsets(height) * step
    right = _offsets(2 * height) * step
    down, right = torch.meshgrid(down, right, indexing="ij")
    seen = direction_from_angles(right, math.pi / 2 + down).reshape(-1, 3)
    # columns: where the filter's x, its pole (y) and its z stand
    cosine, sine = math.cos(twist_rad), math.sin(twist_rad)
    frame = torch.tensor([[cosine, 0, -sine], [sine, 0, cosine], [0, -1, 0]], dtype=torch.float64)
    return seen @ frame


def _offsets(count: int) -> Float[Tensor, " n"]:
    """0, 1, ..., and then what is left of 0, as of a Fourier transform."""
    return torch.fft.fftfreq(count, 1 / count, dtype=torch.float64)
