"""Nine spherical harmonic coefficients in the conventions of other programs.

Ours are :mod:`skylight.sphere.harmonics`: radiance, orthonormal, no sign, +Y up. The others differ
in sign, in what the numbers stand for, and in their order:

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

from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere.harmonics import bands, cosine_coefficients, orders

HarmonicConvention = Literal["skylight", "threejs", "arcore", "arkit", "gltf"]


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
