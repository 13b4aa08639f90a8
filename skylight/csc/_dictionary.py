"""Dictionaries of spherical filters (thesis, 6.6.1), as real SH coefficients about the zenith.

An unrotated filter is centred at the zenith, +Y; its long axis, if it has one, lies along phi = 0.
Coefficients belong to :func:`skylight.sphere._harmonics.evaluate_about_zenith`, an orthonormal
basis, so a filter of unit L2 norm is a unit vector.
"""

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from skylight._modes import constant, on_cpu
from skylight._module import Module
from skylight._names import BuiltinName
from skylight.errors import InputError, check_shape
from skylight.io._tensors import read_tensors, write_tensors
from skylight.sphere import _harmonics as harmonics, _lobes as lobes

PolarFunction = Callable[[Tensor, Tensor], Tensor]

DEGREE = 40
FORMAT, VERSION = "skylight filter bank", "1"
# Thesis, 6.6.1.1: the sharpest Gaussian that 40 bands hold without ringing (it undershoots by
# 1.8 % of its height).
SHARPEST_A = 14.33
# Half the height 80 degrees from the pole, nothing at the antipode: longer lobes meet themselves.
LONGEST_A = 0.5


class FilterBank(Module):
    """A dictionary: filters of unit norm, ``coefficients`` (m, (K+1)^2), and its ``name``.

    The one parameter, ``unnormalised``, is free; ``coefficients`` are its rows divided by their
    norms, so that they stay a dictionary after every step of an optimiser.

    Parameters
    ----------
    coefficients
        Of the filters, of any norm; they are kept in float64.
    learnable
        False makes a bank of constants: a buffer that is no part of a ``state_dict``.

    Raises
    ------
    InputError
        No filter, a number of columns that is no (K+1)^2, or a filter that is not finite or zero.
    """

    unnormalised: Tensor

    @on_cpu
    def __init__(
        self, coefficients: Float[Tensor, "m k"], name: str, *, learnable: bool = True
    ) -> None:
        super().__init__()
        count, columns = coefficients.shape
        if count == 0 or columns == 0:
            raise InputError(f"dictionary {name!r} has no filters: give at least one")
        if math.isqrt(columns) ** 2 != columns:
            raise InputError(
                f"dictionary {name!r}: filters need (K + 1)^2 coefficients (1, 4, 9, ...), "
                f"got {columns}"
            )
        values = coefficients.detach().to(torch.float64)
        norms = values.norm(dim=1, keepdim=True)
        bad = ~(norms[:, 0].isfinite() & (norms[:, 0] > 1e-12))
        if bad.any():
            listed = ", ".join(str(i) for i in bad.nonzero()[:8, 0].tolist())
            raise InputError(
                f"dictionary {name!r}: {int(bad.sum())} of {count} filters are zero or not finite "
                f"(number {listed}): leave them out"
            )
        values = unit_rows(values)
        if learnable:
            self.unnormalised = nn.Parameter(values)
        else:
            self.register_buffer("unnormalised", values, persistent=False)
        self.name = name

    @property
    def coefficients(self) -> Float[Tensor, "m k"]:
        """Real SH coefficients of the filters, of unit norm."""
        return unit_rows(self.unnormalised)

    def __len__(self) -> int:
        return self.unnormalised.shape[0]

    @property
    def degree(self) -> int:
        """K, the last band."""
        return harmonics.degree_of(self.unnormalised.shape[1])

    @property
    def constant(self) -> Bool[Tensor, " m"]:
        """Which filters are the constant function, which no rotation changes."""
        rows = self.coefficients.detach()
        return rows[:, 0].square() > 1 - max(1e-12, 4 * torch.finfo(rows.dtype).eps)

    @property
    def fingerprint(self) -> str:
        """Twelve hexadecimal digits that tell one dictionary from another, whatever its name.

        SHA-256 of the coefficients in steps of 2^-20: what is rounded further down differs between
        processors.
        """
        steps = torch.round(self.coefficients.detach().cpu().double() * 2**20)
        digest = hashlib.sha256(f"{len(self)} {self.degree} ".encode())
        digest.update(steps.numpy().astype("<i4").tobytes())
        return digest.hexdigest()[:12]

    @staticmethod
    def project(function: PolarFunction, degree: int, name: str) -> "FilterBank":
        """The bank of ``function(theta, phi)``: (m, t, p) values for (t, 1) and (p,).

        See :func:`project_about_pole`.
        """
        return FilterBank(project_about_pole(function, degree), name)

    def evaluate(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "m n"]:
        """The filters' values in these directions, unrotated."""
        check_shape(f"{type(self).__name__}'s directions", directions.shape, 3)
        basis = harmonics.evaluate_about_zenith(directions, self.degree)
        return self.coefficients.to(basis.dtype) @ basis.T

    def polar_values(
        self, filters: Int[Tensor, " s"], theta_rad: Float[Tensor, " t"], phi: Float[Tensor, " p"]
    ) -> Float[Tensor, "s t p"]:
        """Values of some filters, unrotated, on a grid of angles from the pole and longitudes."""
        legendre, fourier = _polar_basis(theta_rad, phi, self.degree)
        order = harmonics.orders(self.degree) + self.degree
        values = torch.zeros(len(filters), len(theta_rad), len(phi), dtype=torch.float64)
        for i, filter_ in enumerate(self.coefficients.detach().cpu().double()[filters.cpu()]):
            rows = torch.zeros(len(theta_rad), fourier.shape[1], dtype=torch.float64)
            values[i] = rows.index_add_(1, order, legendre * filter_) @ fourier.T
        return values

    def undershoot(self) -> Float[Tensor, " m"]:
        """-min / max of every filter, on a grid of 1 degree by 2: how much of it is ringing.

        0 or less for a filter that is positive everywhere.
        """
        theta = torch.linspace(0, math.pi, 181, dtype=torch.float64)
        phi = torch.arange(180, dtype=torch.float64) * (2 * math.pi / 180)
        least, most = (
            self.polar_values(torch.arange(len(self)), theta, phi).flatten(1).aminmax(dim=1)
        )
        return -least / most

    def cut(self, degree: int) -> "FilterBank":
        """Bands 0 .. ``degree`` of every filter, of unit norm again.

        A cut rings; ``isotropic`` and ``anisotropic`` of a lower degree have wider filters instead.
        """
        if not 0 <= degree <= self.degree:
            raise InputError(
                f"dictionary {self.name!r} ends at degree {self.degree}: it cannot be cut at "
                f"{degree}"
            )
        return FilterBank(self.coefficients[:, : (degree + 1) ** 2], self.name)

    @staticmethod
    def joined(name: str, *banks: "FilterBank") -> "FilterBank":
        """The filters of all banks, in order; a constant filter only where it comes first."""
        degrees = sorted({bank.degree for bank in banks})
        if len(degrees) != 1:
            raise InputError(
                f"dictionaries of one degree can be joined, got degrees {degrees}: cut them first"
            )
        rows = torch.cat([bank.coefficients for bank in banks])
        constant = torch.cat([bank.constant for bank in banks])
        repeated = constant & (constant.cumsum(0) > 1)
        return FilterBank(rows[~repeated], name)

    def save(self, path: str | Path) -> None:
        """Write a safetensors file, whole or not at all."""
        tensors = {"coefficients": self.coefficients.detach().cpu().double().contiguous()}
        metadata = {"format": FORMAT, "version": VERSION, "name": self.name}
        write_tensors(path, tensors, metadata)

    @staticmethod
    def load(path: str | Path) -> "FilterBank":
        """Read what :meth:`save` wrote.

        Raises
        ------
        InputError
            The file is missing, damaged, or something else.
        """
        try:
            tensors, metadata = read_tensors(Path(path))
        except (OSError, ValueError) as error:
            raise InputError(f"{path} cannot be read as a dictionary: {error}") from error
        if metadata.get("format") != FORMAT:
            raise InputError(f"{path} is no dictionary of filters: choose another file")
        if metadata.get("version") != VERSION:
            raise InputError(
                f"{path} has version {metadata.get('version')} of the format, this "
                f"skylight reads {VERSION}: build the dictionary again"
            )
        if "coefficients" not in tensors:
            raise InputError(f"{path} is damaged: it has no coefficients")
        coefficients = tensors["coefficients"]
        if coefficients.ndim != 2 or not coefficients.is_floating_point():
            raise InputError(f"{path} is damaged: its coefficients are no table of numbers")
        return FilterBank(coefficients, metadata.get("name", Path(path).stem))


def unit_rows(rows: Float[Tensor, "m k"]) -> Float[Tensor, "m k"]:
    """Rows divided by their norms; what is normalised already stays as it is, to the last bit."""
    scale = 1 / rows.norm(dim=1, keepdim=True)
    close = (scale - 1).abs() < 1e-12
    # exactly 1 there, with the derivative of 1 / norm
    return rows * (scale - (scale - 1).detach() * close)


def project_about_pole(
    function: PolarFunction,
    degree: int,
    *,
    cap_rad: float = math.pi,
    rows: int = 256,
    columns: int = 512,
) -> Float[Tensor, "m k"]:
    """Coefficients of functions of (theta, phi) about the zenith, not normalised.

    Gauss-Legendre in cos(theta) over the cap theta < ``cap_rad``, outside of which the functions
    are taken to be 0, times equal steps in phi: exact for a polynomial on the cap of degree
    ``min(2 rows - 1, columns - 1) - degree``. ``function`` gets theta (t, 1) and phi (p,) and
    returns (m, t, p).
    """
    theta, weights = polar_nodes(cap_rad, rows)
    values = function(theta[:, None], polar_longitudes(columns)).broadcast_to(-1, rows, columns)
    return project_samples(values, theta, weights, degree)


def project_samples(
    values: Float[Tensor, "m t p"],
    theta_rad: Float[Tensor, " t"],
    weights: Float[Tensor, " t"],
    degree: int,
) -> Float[Tensor, "m k"]:
    """Coefficients of samples at ``polar_nodes`` and ``polar_longitudes``, not normalised."""
    phi = polar_longitudes(values.shape[2])
    legendre, fourier = _polar_basis(theta_rad, phi, degree)
    table = legendre * (weights * 2 * math.pi / len(phi))[:, None]
    order = harmonics.orders(degree) + degree
    result = torch.zeros(len(values), table.shape[1], dtype=torch.float64)
    for i, value in enumerate(values):  # one at a time: (m, t, k) would be large
        result[i] = (table * (value @ fourier)[:, order]).sum(0)
    return result


def polar_nodes(cap_rad: float, rows: int) -> tuple[Float[Tensor, " t"], Float[Tensor, " t"]]:
    """theta within the cap and its weights in cos(theta), which sum to 1 - cos(cap)."""
    nodes, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(rows))
    half = math.sin(cap_rad / 2) ** 2  # half of 1 - cos(cap)
    # theta from its half angle: 1 - cos(theta) = half (1 - node), exact near the pole
    return 2 * torch.asin(torch.sqrt(half * (1 - nodes) / 2)), half * weights


def polar_longitudes(columns: int) -> Float[Tensor, " p"]:
    """Equal steps of phi, from 0."""
    return torch.arange(columns, dtype=torch.float64) * (2 * math.pi / columns)


def sharpest_a(degree: int) -> float:
    """14.33 degree / 40: the sharpest Gaussian of that degree.

    Band l of a Gaussian falls as exp(-l^2 / (4 a^2)), so the same share is cut where a ~ degree.
    """
    return SHARPEST_A * degree / 40


def isotropic(degree: int = DEGREE, count: int = 100) -> FilterBank:
    """The constant and ``count`` Gaussians by stereographic projection (thesis, 6.6.1.1).

    ``a`` lies on a log(1 + a) scale over [0, 14.33 degree / 40]; a = 0 is the constant. The widest
    few (a < 0.1) are a constant with a hole at the antipode, and that hole rings.
    """
    a = torch.linspace(0, math.log1p(sharpest_a(degree)), count + 1, dtype=torch.float64)[1:]
    a = torch.expm1(a)[:, None, None]
    rows = project_about_pole(lambda theta, phi: lobes.gaussian(theta, a), degree, columns=1)
    return _with_constant(_zonal(rows), "iso")


def anisotropic(degree: int = DEGREE, count: int = 100) -> FilterBank:
    """The constant, ``count`` anisotropic Gaussians, and ``isotropic`` (thesis, 6.6.1.2).

    A square of logarithmic steps: a1 over [0.5, a_max / 2], and for each a1, a2 over
    (a1, b(a1)]. The lobe's half-width at a distance of 4 a1 from the antipode, where it still
    has 1 / e of its height, is about 4 a1^2 / a2; ``b = a_max / sqrt(1 + 1 / (9 a1^4))`` keeps it,
    and the lobe's centre, wide enough not to ring.

    Raises
    ------
    InputError
        ``count`` is no square, or ``degree`` is below 3, which holds no such lobe.
    """
    side, sharpest = math.isqrt(count), sharpest_a(degree)
    if side < 1 or side**2 != count:
        raise InputError(f"{count} anisotropic filters make no square: ask for 81, 100, 121, ...")
    if degree < 3:
        raise InputError(f"anisotropic filters need degree 3 or more, got {degree}")
    a1 = torch.from_numpy(np.geomspace(LONGEST_A, sharpest / 2, side))
    limit = sharpest / torch.sqrt(1 + 1 / (9 * a1**4))
    steps = torch.arange(1, side + 1, dtype=torch.float64) / side
    a2 = a1[:, None] * (limit / a1)[:, None] ** steps
    first, second = a1.repeat_interleave(side)[:, None, None], a2.reshape(-1, 1, 1)
    rows = torch.cat(
        [
            project_about_pole(
                lambda theta, phi, p=p, q=q: lobes.anisotropic_gaussian(theta, phi, p, q), degree
            )
            for p, q in zip(first.split(10), second.split(10), strict=True)  # bounds the memory
        ]
    )
    return FilterBank.joined("ani", _with_constant(_mirrored(rows), "ani"), isotropic(degree))


def finer_isotropic(rows: int, count: int = 24) -> FilterBank:
    """Gaussians for maps of ``rows``: from half the sharpness of degree 40 up to a = rows / 5.

    The sharpest has a standard deviation of 1.1 pixels. Its degree, 3 / 4 of the rows, cuts 3 % of
    its spectrum's height, so that no ripples show round a lamp; what is sharper is for single
    pixels. (Up to ``sharpest_a`` the errors are larger too: 0.173 for 0.141 on a studio with small
    lamps, 64 activations.)
    """
    a = torch.from_numpy(np.geomspace(sharpest_a(DEGREE) / 2, rows / 5, count))
    projected = project_about_pole(
        lambda theta, phi: lobes.gaussian(theta, a[:, None, None]), 3 * rows // 4, columns=1
    )
    return FilterBank(_zonal(projected), "finer iso", learnable=False)


def finer_anisotropic(degree: int = 60) -> FilterBank:
    """Nine anisotropic Gaussians: as sharp as ``degree`` allows across, 2, 4, 8 times as long."""
    across = [sharpest_a(degree) / 2 ** (0.5 * step) for step in range(3)]
    pairs = torch.tensor([[a / ratio, a] for a in across for ratio in (2, 4, 8)]).double()
    a1, a2 = pairs[:, 0, None, None], pairs[:, 1, None, None]
    rows = project_about_pole(
        lambda theta, phi: lobes.anisotropic_gaussian(theta, phi, a1, a2), degree
    )
    return FilterBank(_mirrored(rows), "finer ani", learnable=False)


def von_mises_fisher(degree: int = DEGREE, kappa: float = 80.0) -> FilterBank:
    """The constant and one von Mises-Fisher lobe (thesis, 6.6.1.4; Kholgade et al. 2014)."""
    sharpness = torch.tensor(kappa, dtype=torch.float64)[None, None, None]
    rows = project_about_pole(
        lambda theta, phi: lobes.von_mises_fisher(theta, sharpness), degree, columns=1
    )
    return _with_constant(_zonal(rows), "vmf")


def builtin(name: BuiltinName, degree: int = DEGREE) -> FilterBank:
    """A hand-made dictionary, of the thesis but for "box"; computed once a process.

    A coder of "box" has boxes of its map's pixels besides these filters, which are those of "ani".
    """
    if name not in get_args(BuiltinName):
        raise InputError(
            f"unknown dictionary {name!r}: choose one of {', '.join(get_args(BuiltinName))}"
        )
    # "box" adds to the filters of "ani" what has no coefficients: boxes of a map's own pixels
    filters = _builtin_coefficients("ani" if name == "box" else name, degree)
    return FilterBank(filters.clone(), name)  # the caller's own: a module can be moved and changed


def load_dictionary(name_or_path: str, degree: int = DEGREE) -> FilterBank:
    """A built-in dictionary by name, or one from a file, cut at ``degree``."""
    if name_or_path in get_args(BuiltinName):
        return builtin(name_or_path, degree)  # type: ignore[arg-type]
    if not Path(name_or_path).exists():
        raise InputError(
            f"no dictionary {name_or_path!r}: choose {', '.join(get_args(BuiltinName))} or a file "
            "that a dictionary was saved to"
        )
    bank = FilterBank.load(name_or_path)
    return bank.cut(min(degree, bank.degree))


@constant()
def _builtin_coefficients(name: BuiltinName, degree: int) -> Float[Tensor, "m k"]:
    builders = {"iso": isotropic, "ani": anisotropic, "vmf": von_mises_fisher}
    return builders[name](degree).coefficients.detach()


def _polar_basis(
    theta: Float[Tensor, " t"], phi: Float[Tensor, " p"], degree: int
) -> tuple[Float[Tensor, "t k"], Float[Tensor, "p orders"]]:
    """Y_lm(theta, phi) = legendre[theta, lm] fourier[phi, m + degree]."""
    zero = torch.zeros_like(theta)
    meridian = torch.stack([zero, torch.cos(theta), torch.sin(theta)], dim=-1)  # phi = 0 is +Z
    l, order = harmonics.bands(degree), harmonics.orders(degree)  # noqa: E741
    # the sine of m phi is 0 there, so its partner of the same l stands in for it
    legendre = harmonics.evaluate_about_zenith(meridian, degree)[:, l * (l + 1) + order.abs()]
    angle = phi[:, None] * torch.arange(degree + 1, dtype=phi.dtype)
    return legendre, torch.cat([torch.sin(angle[:, 1:]).flip(1), torch.cos(angle)], dim=1)


def _with_constant(rows: Float[Tensor, "m k"], name: str) -> FilterBank:
    constant = torch.zeros_like(rows[:1])
    constant[0, 0] = 1
    return FilterBank(torch.cat([constant, rows]), name)


def _zonal(rows: Float[Tensor, "m k"]) -> Float[Tensor, "m k"]:
    """Only m = 0: one column of phi says nothing about the others."""
    return rows * (harmonics.orders(harmonics.degree_of(rows.shape[1])) == 0)


def _mirrored(rows: Float[Tensor, "m k"]) -> Float[Tensor, "m k"]:
    """Only cos(m phi) of even m: the rest is rounding, in functions of two mirror planes."""
    order = harmonics.orders(harmonics.degree_of(rows.shape[1]))
    kept = (order >= 0) & (order % 2 == 0)
    assert (rows * ~kept).abs().max() < 1e-9 * rows.norm(dim=1).min()
    return rows * kept
