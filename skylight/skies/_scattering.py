"""Scattering of sunlight: its wavelengths and their colours, phase functions, and flat layers.

Light is known at seven wavelengths and taken as linear between them; weighted by the sun's
spectrum and the CIE 1931 colour matching functions, each of the seven has a colour. Before what
Rec.709 cannot say is cut off, light that has passed air and haze in equal parts, and up to a fifth
of ozone, is thus within 0.003 in x and y and 1 % in luminance of steps of 1 nm up to an optical
depth of 2 at 550 nm; at a depth of 5 within 0.01 and 5 %, at 10 within 0.014 and 25 %.

Light scattered more than once between layers of air and haze over level ground is computed by
discrete ordinates (Chandrasekhar 1960), order by order: the radiance L(mu, phi) of each order is
known at the cosines mu of Gauss' quadrature, at cosines m phi in azimuth, and as the mean of each
layer. mu > 0 looks up; the cosine of an angle of scattering is that between the direction from
which light comes and the one in which it is then seen.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

STREAMS = 8  # cosines a hemisphere
MODES = 8  # terms in azimuth; of light scattered twice by haze, 0.76^16 = 1 % is left beyond
ORDERS = 12  # one by one; later ones, in bright haze 0.8 of the one before, as a geometric series
BANDS_NM = (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0)
# The sun's spectrum outside the air, W/m2/nm: ASTM G173, means of 20 nm about every 20th nm.
SUNLIGHT_NM = np.arange(360.0, 781.0, 20.0)
SUNLIGHT = (
    *(1.052, 1.078, 1.436, 1.706, 1.773, 2.026, 1.979, 1.936, 1.849, 1.872, 1.842),
    *(1.823, 1.767, 1.688, 1.624, 1.539, 1.492, 1.428, 1.354, 1.298, 1.251, 1.197),
)
# m2 a molecule at 233 K: Gorshelev et al. and Serdyuchenko et al. (2014), "High spectral
# resolution ozone absorption cross-sections", parts 1 and 2. Means about each wavelength, weights
# falling linearly to nothing at the next ones.
OZONE_CROSS_SECTION = (2.34e-27, 2.55e-26, 1.28e-25, 3.33e-25, 4.38e-25, 2.56e-25, 9.99e-26)
XYZ_FROM_RGB = np.array(  # IEC 61966-2-1
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


class LayeredScattering:
    """Layers from the ground upwards, for the light of k wavelengths.

    ``air`` and ``haze`` are the layers' optical depths by scattering alone, ``depth`` those by
    all extinction; ``views`` the cosines to which light is scattered at last.
    """

    def __init__(
        self,
        air: Float[Tensor, "k l"],
        haze: Float[Tensor, "k l"],
        depth: Float[Tensor, "k l"],
        *,
        haze_g: float,
        ground_albedo: float,
        views: Float[Tensor, " v"],
    ) -> None:
        node, weight = np.polynomial.legendre.leggauss(STREAMS)
        up = torch.tensor((node + 1) / 2).to(depth)
        self._cosines = torch.cat([up, -up])
        self._weights = torch.tensor(weight / 2).to(depth).repeat(2)
        self._haze_g, self._ground_albedo = haze_g, ground_albedo
        self._shares = (air / depth)[..., None], (haze / depth)[..., None]
        self._between = self._weighted_phases(self._cosines)
        self._to_views = self._weighted_phases(views)
        self._build_paths(depth)

    def towards_views(
        self,
        cos_sun: Float[Tensor, ""],
        sunlight: Float[Tensor, "k l"],
        sun_on_ground: Float[Tensor, " k"],
    ) -> Float[Tensor, "m k l v"]:
        """Radiance that each layer adds for a unit of optical depth, scattered at least twice.

        Factors of cos(m phi), with phi from the sun. ``sunlight`` is the sun's irradiance of
        surfaces facing it, the mean in each layer, ``sun_on_ground`` that of level ground. Light
        from the ground counts as scattered there.
        """
        sun = cos_sun[None].to(self._cosines)
        phases = (phase[:, :, 0][:, None, None] for phase in self._phases(self._cosines, sun))
        source = sunlight[..., None] * self._mixed(*phases)
        light = self._light(source, sun_on_ground + self._onto_ground(source))
        total = before = light
        for _ in range(ORDERS):
            before = light
            source = self._mixed(*(light @ phase for phase in self._between))
            light = self._light(source, self._onto_ground(source))
            total = total + light
        total = total + light * _beyond(before, light)
        return self._mixed(*(total @ phase for phase in self._to_views))

    def _mixed(
        self, air: Float[Tensor, "m #k #l s"], haze: Float[Tensor, "m #k #l s"]
    ) -> Float[Tensor, "m k l s"]:
        return self._shares[0] * air + self._shares[1] * haze

    def _phases(
        self, cosines: Float[Tensor, " i"], others: Float[Tensor, " j"]
    ) -> tuple[Float[Tensor, "m i j"], Float[Tensor, "m i j"]]:
        """Air's and haze's phase functions between cosines, of cos(m phi)."""
        return (
            _modes(cosines, others, rayleigh),
            _modes(cosines, others, lambda c: henyey_greenstein(c, self._haze_g)),
        )

    def _weighted_phases(
        self, targets: Float[Tensor, " j"]
    ) -> tuple[Float[Tensor, "m 1 s j"], Float[Tensor, "m 1 s j"]]:
        """What turns radiance at our cosines into scattered light at others, by matrix product.

        The integral of cos(m (phi - phi')) cos(m phi') over phi' is pi cos(m phi), 2 pi at m = 0.
        Scaled by what the cosines miss of haze's peak (up to 1 %), so that no energy is lost.
        """
        around = torch.full((MODES, 1, 1), math.pi).to(targets)
        around[0] *= 2
        scale = around * self._weights[:, None]
        air, haze = ((scale * phase)[:, None] for phase in self._phases(self._cosines, targets))
        return air / air[:1].sum(2, keepdim=True), haze / haze[:1].sum(2, keepdim=True)

    def _build_paths(self, depth: Float[Tensor, "k l"]) -> None:
        """How sources and the ground light the layers: matrices for every cosine.

        A layer of slant depth t, lit evenly from within by J, has the mean radiance J (1 - h)
        with h = (1 - exp(-t)) / t, of light that enters it h times that, and lets J (1 - exp(-t))
        out.
        """
        slant = (depth[:, None] / self._cosines.abs()[:, None]).clamp(min=1e-9)  # k s l
        out = -torch.expm1(-slant)
        mean = out / slant
        top = torch.cumsum(slant, -1)
        bottom = top - slant
        layers = torch.arange(depth.shape[-1], device=depth.device)
        here, there = layers[:, None], layers[None]
        looks_up = (self._cosines > 0)[:, None, None]
        gap = torch.where(
            looks_up,
            bottom[..., None, :] - top[..., :, None],
            bottom[..., :, None] - top[..., None, :],
        )
        seen = torch.where(looks_up, there > here, there < here)
        path = mean[..., :, None] * torch.exp(-gap.clamp(min=0)) * out[..., None, :] * seen
        self._paths = path + torch.diag_embed(1 - mean)
        self._from_ground = (mean * torch.exp(-bottom) * ~looks_up[..., 0]).transpose(1, 2)
        falling = 2 * math.pi * (self._weights * self._cosines.clamp(min=0))[:, None]
        self._down = (falling * torch.exp(-bottom) * out).transpose(1, 2)

    def _light(
        self, source: Float[Tensor, "m k l s"], on_ground: Float[Tensor, " k"]
    ) -> Float[Tensor, "m k l s"]:
        """Mean radiance in the layers from sources there and from the lit ground."""
        light = (self._paths @ source.permute(1, 3, 2, 0)).permute(3, 0, 2, 1).contiguous()
        ground = self._ground_albedo / math.pi * on_ground[:, None, None]
        light[0] += ground * self._from_ground
        return light

    def _onto_ground(self, source: Float[Tensor, "m k l s"]) -> Float[Tensor, " k"]:
        """Irradiance of level ground by the layers' light."""
        return (source[0] * self._down).sum((-2, -1))


def _beyond(
    before: Float[Tensor, "m k l s"], last: Float[Tensor, "m k l s"]
) -> Float[Tensor, "m k 1 1"]:
    """All later orders over the last: q / (1 - q), q = last / before in each mode and colour."""
    strong, weak = (light.abs().sum((2, 3), keepdim=True) for light in (before, last))
    ratio = (weak / strong.clamp(min=1e-30)).clamp(max=0.99)
    return ratio / (1 - ratio)


def rayleigh(cos_angle: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """3 / (16 pi) (1 + cos^2)."""
    return 3 / (16 * math.pi) * (1 + cos_angle**2)


def henyey_greenstein(cos_angle: Float[Tensor, "*s"], g: float) -> Float[Tensor, "*s"]:
    """(1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5); integrates to 1 over the sphere."""
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cos_angle) ** 1.5)


def _modes(
    cosines: Float[Tensor, " i"], others: Float[Tensor, " j"], phase: Callable[[Tensor], Tensor]
) -> Float[Tensor, "m i j"]:
    """P_m with P(cos angle) = sum_m P_m cos(m phi), for directions phi apart in azimuth."""
    phi = math.pi * (torch.arange(32).to(cosines) + 0.5) / 32
    a, b = cosines[:, None, None], others[None, :, None]
    level = torch.sqrt(((1 - a**2) * (1 - b**2)).clamp(min=0))
    values = phase(a * b + level * torch.cos(phi))
    order = torch.arange(MODES).to(cosines)[:, None]
    basis = torch.cos(order * phi) * torch.where(order > 0, 2.0, 1.0) / 32
    return torch.einsum("ijp,mp->mij", values, basis)


def rayleigh_depth(nm: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s"]:
    """Optical depth of all the air above the sea: Bodhaine et al. (1999), eq. 30.

    "On Rayleigh optical depth calculations"; 1013.25 mbar, 45 degrees of latitude.
    """
    square = (nm / 1000) ** 2
    above = 1.0455996 - 341.29061 / square - 0.90230850 * square
    return 0.0021520 * above / (1 + 0.0027059889 / square - 85.968563 * square)


def colour_matching(nm: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """CIE 1931 2-degree functions, fitted by lobes (Wyman, Sloan & Shirley 2013)."""

    def lobe(middle: float, left: float, right: float) -> np.ndarray:
        t = (nm - middle) * np.where(nm < middle, left, right)
        return np.exp(-0.5 * t * t)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323)
    x = x - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z], -1)


def sunlight_colours() -> Float[np.ndarray, "k 3"]:
    """Rec.709 colours of the sun's light about each wavelength; their sum has luminance 1."""
    nm = np.arange(360.0, 781.0)
    shares = np.stack([np.interp(nm, BANDS_NM, one) for one in np.eye(len(BANDS_NM))])
    xyz = (shares * np.interp(nm, SUNLIGHT_NM, SUNLIGHT)) @ colour_matching(nm)
    return xyz @ np.linalg.inv(XYZ_FROM_RGB).T / xyz[:, 1].sum()
