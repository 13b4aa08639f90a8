"""Real spherical harmonics: basis, projection, windows, zonal convolution.

Convention (the only place it is written): orthonormal over the sphere, real, index
``l (l + 1) + m``, no Condon-Shortley sign, and the polar axis is *our +Z*, with no permutation of
axes: the formulas of Ramamoorthi & Hanrahan 2001 and Sloan 2008 ("Stupid SH Tricks") hold with our
world x, y, z put in as they stand, +Y up. Shaders and three.js' ``SphericalHarmonics3``, which is
+Y up too, read our coefficients unchanged. The first nine:

=====  =====  =========================
index  l, m   Y_lm(x, y, z)
=====  =====  =========================
0      0, 0   0.282095
1      1,-1   0.488603 y     (up)
2      1, 0   0.488603 z     (backward)
3      1, 1   0.488603 x     (right)
4      2,-2   1.092548 x y
5      2,-1   1.092548 y z
6      2, 0   0.315392 (3 z^2 - 1)
7      2, 1   1.092548 x z
8      2, 2   0.546274 (x^2 - y^2)
=====  =====  =========================

Other programs' nine coefficients (:func:`to_convention`) differ in sign, in what the numbers stand
for, and in their order:

========  ==========  ==========================  =============================================
name      stand for   minus before                order
========  ==========  ==========================  =============================================
skylight  radiance                                coefficient by coefficient, R G B of each
threejs   radiance                                the same: ``LightProbe.sh``
arcore    radiance    odd m (Condon-Shortley)     the same: AmbientSphericalHarmonics
arkit     radiance                                nine of red, nine of green, nine of blue
gltf      irradiance  negative m                  coefficient by coefficient, R G B of each
========  ==========  ==========================  =============================================

Sources: three.js, src/math/SphericalHarmonics3.js and its shader chunk lights_pars_begin. Google's
sample hello_ar_java: sphericalHarmonicFactors are A_l / pi times the basis' constants, with a minus
for odd m. Babylon.js, whose authors wrote EXT_lights_image_based: its basis has a minus for odd m
(Maths/sphericalPolynomial), and its world is glTF's with x turned round, which leaves one for
negative m; the extension's text names no sign. Apple documents ARKit's three planes, but neither
basis nor signs: "arkit" is our basis in Apple's order.
"""

import math
from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

from skylight._modes import constant, single, transformed
from skylight._names import HarmonicConvention
from skylight.errors import InputError
from skylight.sphere._frame import DirectionGrid

ProjectionMethod = Literal["solid_angle", "quadrature", "least_squares"]
WindowKind = Literal["hann", "lanczos"]

_CACHED = 2**18  # numbers of the basis at a time: three bands of them stay in a core's cache


def evaluate(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n k"]:
    """All Y_lm up to ``degree`` at unit vectors: (n, (degree + 1)^2), in the input's precision.

    ``Y_lm = Q_l|m|(z) Re or Im (x + i y)^|m|``, where Q follows the three-term recursion upwards in
    l, which is stable (Numerical Recipes, 3rd ed., 6.7). There is no division by sin(theta), so
    values and gradients are finite at the poles. Errors are below 1e-12 at degree 100 in float64.
    Of half precision the recursion is in single.

    In memory each coefficient's values are contiguous: the result is the transpose of (k, n).
    """
    given, directions = directions.dtype, single(directions)
    scales = _recursion(degree, directions.dtype, directions.device)[1]
    if not _plain(directions):
        bands = zip(_monic_bands(directions, degree), scales, strict=True)
        return torch.cat([band * scale for band, scale in bands]).T.to(given)
    # numpy asks the system for huge pages, without which new memory takes as long as the rest
    empty = np.empty(((degree + 1) ** 2, len(directions)), directions.new_empty(0).numpy().dtype)
    out = torch.from_numpy(empty)
    sizes = [2 * l + 1 for l in range(degree + 1)]  # noqa: E741
    at_once = max(1024, _CACHED // len(out))
    for some, columns in zip(directions.split(at_once), out.split(at_once, 1), strict=True):
        bands = zip(_monic_bands(some, degree), scales, columns.split(sizes), strict=True)
        for band, scale, place in bands:
            torch.mul(band, scale, out=place)
    return out.T.to(given)


def _plain(directions: Tensor) -> bool:
    """Whether values may be written where they belong: on a CPU, and nobody derives or traces."""
    tracked = torch.is_grad_enabled() and directions.requires_grad
    return (
        directions.device.type == "cpu"
        and directions.dtype in (torch.float32, torch.float64)
        and not (tracked or transformed() or torch.compiler.is_compiling())
        and unpack_dual(directions).tangent is None
    )


def _monic_bands(directions: Float[Tensor, "n 3"], degree: int) -> Iterator[Float[Tensor, "m n"]]:
    """Y_lm over its scale, m = -l .. l, band by band: ``p_lm = 2 z p_l-1,m - b_lm p_l-2,m``.

    ``p_mm = (x + i y)^m``; the recursion is the same for either sign of m.
    """
    x, y, z = directions.T.contiguous()
    double, minus_y = 2 * z, torch.stack([y, -y])
    power = torch.stack([torch.zeros_like(z), torch.ones_like(z)])  # Im, Re (x + i y)^l
    older, band = power[:0], power[1:]
    yield band
    for inner in _recursion(degree, directions.dtype, directions.device)[0][1:]:
        power = x * power + minus_y * power.flip(0)
        larger = torch.cat([power[:1], double * band, power[1:]])
        larger[2:-2].sub_(inner * older)
        older, band = band, larger
        yield band


@constant()
def _recursion(
    degree: int, dtype: torch.dtype, device: torch.device
) -> tuple[list[Float[Tensor, "i 1"]], list[Float[Tensor, "m 1"]]]:
    """b_lm for ``|m| < l - 1`` and the scales ``Y_lm / p_lm``, of each band.

    Normalised, ``Y_lm = a_lm z Y_l-1,m - ...`` with ``a_lm = sqrt((4 l^2 - 1) / (l^2 - m^2))``, so
    a scale is a_lm / 2 times that of l - 1. Powers of two keep p_lm of the size of Y_lm:
    1e-9 of it at degree 100, 1e-18 at 200, so that no number of single precision underflows.
    """
    inner, scales = [], []
    scale = torch.full((1,), math.sqrt(1 / (4 * math.pi)), dtype=torch.float64)
    for l in range(degree + 1):  # noqa: E741
        m = torch.arange(-l, l + 1, dtype=torch.float64)
        if l > 0:
            # the sqrt 2 of the real basis comes in once, with m = 1
            rim = scale[:1] * math.sqrt((2 * l + 1) / (2 * l)) * (math.sqrt(2) if l == 1 else 1)
            a = torch.sqrt((4 * l * l - 1) / (l * l - m[1:-1] ** 2))
            scale = torch.cat([rim, scale * a / 2, rim])
        b = 4 * ((l - 1) ** 2 - m[2:-2] ** 2) / (4 * (l - 1) ** 2 - 1)
        inner.append(b[:, None].to(device, dtype))
        scales.append(scale[:, None].to(device, dtype))
    return inner, scales


def evaluate_about_zenith(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n k"]:
    """:func:`evaluate` with the zenith (+Y) as polar axis: (z, x, y) takes the place of (x, y, z).

    About this axis a lat-long map is a product of rows and columns, so it is what transforms of
    whole maps use. Longitude counts from +Z towards +X: pi minus the azimuth.
    """
    return evaluate(directions.roll(1, 1), degree)


def bands(degree: int, device: torch.device | str = "cpu") -> Int[Tensor, " k"]:
    """The l of every coefficient: 0, 1, 1, 1, 2, ... up to ``degree``."""
    # roots of squares are exact, and need no look at the numbers as repeating them does
    return torch.arange((degree + 1) ** 2, device=device).double().sqrt().long()


def orders(degree: int, device: torch.device | str = "cpu") -> Int[Tensor, " k"]:
    """The m of every coefficient: 0, -1, 0, 1, -2, ..."""
    l = bands(degree, device)  # noqa: E741
    return torch.arange(len(l), device=device) - l * (l + 1)


def zonal_factors(coefficients: Float[Tensor, "*c k"]) -> Float[Tensor, "*c bands"]:
    """``sqrt(4 pi / (2 l + 1)) c_l0``: what a zonal function's convolution does to each band.

    Funk-Hecke; the same factors times Y_lm(w) are the function turned to w (thesis, C.2).
    """
    l = torch.arange(degree_of(coefficients.shape[-1]) + 1, device=coefficients.device)  # noqa: E741
    scale = torch.sqrt(4 * math.pi / (2 * l + 1).to(coefficients))
    return coefficients[..., l * (l + 1)] * scale


def degree_of(count: int) -> int:
    """Degree of an expansion of ``count`` coefficients; ValueError where it is no square."""
    degree = math.isqrt(count) - 1
    if (degree + 1) ** 2 != count or count == 0:
        raise ValueError(f"expected (degree + 1)^2 coefficients (1, 4, 9, 16, ...), got {count}")
    return degree


def project(
    radiance: Float[Tensor, "n c"],
    grid: DirectionGrid,
    degree: int,
    *,
    method: ProjectionMethod = "solid_angle",
) -> Float[Tensor, "k c"]:
    """Coefficients of radiance sampled on a grid; computed in float64, returned in its dtype.

    ``solid_angle``
        ``sum_w L(w) Y(w) dw``: takes the map as pixels, as transport does. Energy is exact;
        a band-limited map comes back to within O((degree / rows)^2).
    ``quadrature``
        Fejer's first rule over the rows of a full lat-long map: takes the map as point samples.
        Exact for band-limited maps of more than ``2 degree`` rows, an error for fewer. The polar
        rows weigh 13 % less than their solid angle.
    ``least_squares``
        ``argmin sum_w dw |Y c - L|^2``: exact for band-limited maps on any grid of more than
        ``degree`` rows of the full sphere; n (degree + 1)^4 operations.
    """
    if method not in get_args(ProjectionMethod):
        raise ValueError(
            f"method {method!r}: choose one of {', '.join(get_args(ProjectionMethod))}"
        )
    if len(grid) != radiance.shape[0]:
        raise ValueError(f"radiance has {radiance.shape[0]} rows, its grid {len(grid)} directions")
    values = radiance.to(torch.float64)
    basis = evaluate(grid.directions.to(values.device), degree)
    weights = grid.solid_angles if method != "quadrature" else _fejer_weights(grid, degree)
    weights = weights.to(values.device)[:, None]
    if method == "least_squares":
        if len(grid) < basis.shape[1]:
            raise ValueError(f"{basis.shape[1]} coefficients from {len(grid)} directions")
        root = weights.sqrt()
        return torch.linalg.lstsq(root * basis, root * values).solution.to(radiance.dtype)
    return (basis.T @ (weights * values)).to(radiance.dtype)


def cosine_coefficients(degree: int) -> Float[Tensor, " bands"]:
    """A_l of the clamped cosine, l = 0 .. degree: irradiance is ``E_lm = A_l L_lm``.

    A_0 = pi, A_1 = 2 pi / 3, A_l = 0 for other odd l, and for even l
    ``2 pi (-1)^(l/2-1) / ((l+2)(l-1)) l! / (2^l (l/2)!^2)``
    (Ramamoorthi & Hanrahan 2001, eq. 19; Basri & Jacobs 2003).
    """
    table = [math.pi, 2 * math.pi / 3]
    for l in range(2, degree + 1):  # noqa: E741
        sign = -1 if l // 2 % 2 == 0 else 1
        value = 2 * math.pi * sign * math.comb(l, l // 2) / 2**l / ((l + 2) * (l - 1))
        table.append(value if l % 2 == 0 else 0.0)
    return torch.tensor(table[: degree + 1], dtype=torch.float64)


def convolve_zonal(
    coefficients: Float[Tensor, "k c"], kernel: Float[Tensor, " bands"]
) -> Float[Tensor, "k c"]:
    """Multiply every band l by ``kernel[l]``: a convolution with a function of the angle only.

    For a kernel with zonal coefficients k_l the factor is ``sqrt(4 pi / (2 l + 1)) k_l``
    (Funk-Hecke); :func:`cosine_coefficients` and :func:`window` give such factors.
    """
    degree = degree_of(coefficients.shape[0])
    if kernel.shape[0] != degree + 1:
        raise ValueError(f"kernel must have {degree + 1} bands, got {kernel.shape[0]}")
    return kernel.to(coefficients)[bands(degree)][:, None] * coefficients


def window(degree: int, kind: WindowKind) -> Float[Tensor, " bands"]:
    """Factors for each band that tame the ringing of a cut expansion (Sloan 2008).

    ``hann``: ``(1 + cos(pi l / (degree + 1))) / 2``; ``lanczos``: ``sinc(l / (degree + 1))``.
    """
    t = torch.arange(degree + 1, dtype=torch.float64) / (degree + 1)
    if kind == "hann":
        return (1 + torch.cos(math.pi * t)) / 2
    if kind == "lanczos":
        return torch.sinc(t)
    raise ValueError(f"window {kind!r}: choose one of {', '.join(get_args(WindowKind))}")


def _fejer_weights(grid: DirectionGrid, degree: int) -> Float[Tensor, " n"]:
    """Fejer's first rule in cos(zenith) at the pixel rows, times the width of a pixel.

    ``w_i = 2/h (1 - 2 sum_j cos(2 j t_i) / (4 j^2 - 1))``, j = 1 .. h/2: exact for polynomials in
    cos(zenith) of degree < h (Davis & Rabinowitz 1984, 2.5.5).
    """
    if grid.layout is None or grid.layout[1] != 2 * grid.layout[0]:
        raise ValueError("quadrature needs a full lat-long grid: choose method='least_squares'")
    height, width = grid.layout
    if height <= 2 * degree:
        raise ValueError(
            f"quadrature of degree {degree} needs more than {2 * degree} rows, got {height}: "
            "choose method='least_squares' or a finer map"
        )
    zenith = (torch.arange(height, dtype=torch.float64) + 0.5) * math.pi / height
    j = torch.arange(1, height // 2 + 1, dtype=torch.float64)
    series = (torch.cos(2 * j * zenith[:, None]) / (4 * j**2 - 1)).sum(1)
    row = 2 / height * (1 - 2 * series) * 2 * math.pi / width
    return row.repeat_interleave(width)


def to_convention(
    coefficients: Float[Tensor, "9 3"], convention: HarmonicConvention
) -> Float[Tensor, " 27"]:
    """27 numbers from skylight's nine coefficients of radiance.

    ``gltf`` is E_lm = A_l L_lm, so that irradiance is sum_lm E_lm Y_lm(n); the others are L_lm.

    Raises
    ------
    InputError
        A convention that does not exist.
    """
    if convention not in get_args(HarmonicConvention):
        known = ", ".join(get_args(HarmonicConvention))
        raise InputError(f"unknown convention of harmonics {convention!r}: choose one of {known}")
    values = coefficients * _factors(convention).to(coefficients)
    return (values.T if convention == "arkit" else values).reshape(-1)


def _factors(convention: HarmonicConvention) -> Float[Tensor, "9 1"]:
    order = orders(2)
    negative = torch.zeros(9, dtype=torch.bool)
    if convention == "arcore":
        negative = order % 2 == 1
    elif convention == "gltf":
        negative = order < 0
    factors = torch.where(negative, -1.0, 1.0).double()
    if convention == "gltf":
        factors = factors * cosine_coefficients(2)[bands(2)]
    return factors[:, None]
