"""The clear sky: radiative transfer through air, aerosol and ozone round a spherical Earth.

Single scattering is integrated along the view rays; all further orders follow from one small
table after Hillaire (2020), "A Scalable and Production Ready Sky and Atmosphere Rendering
Technique", which assumes that they are isotropic and that neighbouring points see the same
light. Three wavelengths stand for the three Rec.709 primaries (as in Bruneton & Neyret 2008);
against a spectral computation this costs some colour accuracy in twilight and little by day.

Unit: radiance and irradiance are relative to the extraterrestrial solar irradiance, whose
Rec.709 luminance is 1.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

EARTH_RADIUS_KM = 6360.0
TOP_RADIUS_KM = 6460.0

# Bruneton & Neyret (2008) and Hillaire (2020), table 1; per km at sea level, at 680/550/440 nm.
RAYLEIGH_PER_KM = (5.802e-3, 13.558e-3, 33.1e-3)
RAYLEIGH_HEIGHT_KM = 8.0
MIE_HEIGHT_KM = 1.2
WAVELENGTHS_NM = (680.0, 550.0, 440.0)
OZONE_ABSORPTION_PER_KM = (0.650e-3, 1.881e-3, 0.085e-3)
OZONE_CENTRE_KM, OZONE_HALF_WIDTH_KM = 25.0, 15.0

# Rec.709 colour (D65 white) of a black body at the sun's effective temperature, 5772 K, with
# luminance 1: CIE 1931 chromaticity (0.3264, 0.3360), colour matching by Wyman et al. (2013).
SUN_COLOUR = (1.1102, 0.9761, 0.9123)


@dataclass(frozen=True, kw_only=True)
class Atmosphere:
    """What differs from one clear day to the next.

    ``aerosol_optical_depth`` is the vertical one at 550 nm (0.05 very clean, 0.1 rural, 0.4
    hazy), scaled to other wavelengths by Angstrom's law (lambda / 550)^-alpha; ``ozone`` is a
    multiple of the standard column (300 Dobson units).
    """

    aerosol_optical_depth: float = 0.1
    angstrom_exponent: float = 1.3
    aerosol_albedo: float = 0.92
    aerosol_g: float = 0.76
    ozone: float = 1.0
    ground_albedo: float = 0.15
    observer_km: float = 0.2


class ClearSky:
    """Radiance of the clear sky and transmittance towards the sun for one atmosphere."""

    def __init__(self, atmosphere: Atmosphere, *, device: torch.device | str = "cpu") -> None:
        self.atmosphere = atmosphere
        self.device = torch.device(device)
        self._transmittance = self._transmittance_table(height=64, width=256)
        self._multiple = self._multiple_scattering_table(size=32)

    def sun_irradiance(self, sun_zenith_rad: Float[Tensor, " b"]) -> Float[Tensor, "b 3"]:
        """Irradiance of the sun on a plane facing it at the observer, after extinction."""
        radius = torch.full_like(sun_zenith_rad, self._observer_radius)
        return self._colour() * self.transmittance(radius, torch.cos(sun_zenith_rad))

    def radiance(
        self,
        directions: Float[Tensor, "n 3"],
        sun: Float[Tensor, "3"],
        *,
        steps: int = 32,
    ) -> Float[Tensor, "n 3"]:
        """Sky radiance, the sun's disc left out, towards ``directions`` above the horizon."""
        air = self.atmosphere
        radius0 = self._observer_radius
        mu = directions[:, 1]
        length = _distance_to_top(torch.full_like(mu, radius0), mu)
        # quadratic spacing: most of the air is close to the observer
        edges = torch.linspace(0, 1, steps + 1, device=self.device) ** 2
        t = length[:, None] * (edges[1:] + edges[:-1]) / 2
        dt = length[:, None] * torch.diff(edges)
        radius = torch.sqrt(radius0**2 + t**2 + 2 * radius0 * t * mu[:, None])
        cos_sun = ((radius0 * sun[1]) + t * (directions @ sun)[:, None]) / radius
        rayleigh, mie, extinction = self._coefficients(radius)
        sunlight = self.transmittance(radius, cos_sun) * _above_horizon(radius, cos_sun)[..., None]
        cos_angle = directions @ sun
        phase_r = (3 / (16 * math.pi)) * (1 + cos_angle**2)
        phase_m = henyey_greenstein(cos_angle, air.aerosol_g)
        source = sunlight * (rayleigh * phase_r[:, None, None] + mie * phase_m[:, None, None])
        source = source + self._look_up_multiple(radius, cos_sun) * (rayleigh + mie)
        return self._colour() * _integrate_along(source, extinction, dt)

    def transmittance(
        self, radius: Float[Tensor, "*s"], mu: Float[Tensor, "*s"]
    ) -> Float[Tensor, "*s 3"]:
        """exp(-optical depth) from radius to the top of the air along zenith cosine mu."""
        horizon = math.sqrt(TOP_RADIUS_KM**2 - EARTH_RADIUS_KM**2)
        rho = torch.sqrt((radius**2 - EARTH_RADIUS_KM**2).clamp(min=0))
        near, far = TOP_RADIUS_KM - radius, rho + horizon
        x = ((_distance_to_top(radius, mu) - near) / (far - near)).clamp(0, 1)
        return _table(self._transmittance, x, rho / horizon)

    @property
    def _observer_radius(self) -> float:
        return EARTH_RADIUS_KM + self.atmosphere.observer_km

    def _colour(self) -> Float[Tensor, "3"]:
        return torch.tensor(SUN_COLOUR, device=self.device)

    def _coefficients(
        self, radius: Float[Tensor, "*s"]
    ) -> tuple[Float[Tensor, "*s 3"], Float[Tensor, "*s 3"], Float[Tensor, "*s 3"]]:
        """Rayleigh scattering, Mie scattering and total extinction per km at a radius."""
        height = (radius - EARTH_RADIUS_KM).clamp(min=0)[..., None]
        rayleigh = torch.tensor(RAYLEIGH_PER_KM, device=self.device) * torch.exp(
            -height / RAYLEIGH_HEIGHT_KM
        )
        air = self.atmosphere
        sea_level = air.aerosol_optical_depth / MIE_HEIGHT_KM
        relative = torch.tensor(WAVELENGTHS_NM, device=self.device) / 550.0
        haze = sea_level * relative**-air.angstrom_exponent * torch.exp(-height / MIE_HEIGHT_KM)
        layer = (1 - (height - OZONE_CENTRE_KM).abs() / OZONE_HALF_WIDTH_KM).clamp(min=0)
        ozone = torch.tensor(OZONE_ABSORPTION_PER_KM, device=self.device) * layer
        extinction = rayleigh + haze + air.ozone * ozone
        return rayleigh, air.aerosol_albedo * haze, extinction

    def _transmittance_table(self, *, height: int, width: int) -> Float[Tensor, "h w 3"]:
        """Bruneton's parametrisation: x by distance to the top, y by distance to the horizon.

        The steps along the ray are longer than the haze is high: sunlight meets up to 7 % less
        haze than ``aerosol_optical_depth`` says. Air and ozone are within 0.3 %.
        """
        horizon = math.sqrt(TOP_RADIUS_KM**2 - EARTH_RADIUS_KM**2)
        rho = torch.linspace(0, 1, height, device=self.device)[:, None] * horizon
        radius = torch.sqrt(rho**2 + EARTH_RADIUS_KM**2)
        near, far = TOP_RADIUS_KM - radius, rho + horizon
        distance = near + torch.linspace(0, 1, width, device=self.device) * (far - near)
        mu = (horizon**2 - rho**2 - distance**2) / (2 * radius * distance).clamp(min=1e-6)
        mu = torch.where(distance > 0, mu, torch.ones_like(mu)).clamp(-1, 1)
        radius = radius.expand_as(mu)
        t = (torch.arange(64, device=self.device) + 0.5) / 64
        along = distance[..., None] * t
        r = torch.sqrt(radius[..., None] ** 2 + along**2 + 2 * (radius * mu)[..., None] * along)
        depth = self._coefficients(r)[2].mean(-2) * distance[..., None]
        return torch.exp(-depth)

    def _multiple_scattering_table(self, *, size: int) -> Float[Tensor, "s s 3"]:
        """Hillaire's Psi(cos sun zenith, height): all orders above the first, per unit sunlight.

        Psi = L2 / (1 - f), with L2 the second order seen by an isotropic scatterer and f the
        part of isotropic light that comes back after one more scattering.
        """
        cos_sun = torch.linspace(-1, 1, size, device=self.device)
        height = torch.linspace(0.01, 0.99, size, device=self.device) ** 2
        radius0 = EARTH_RADIUS_KM + height * (TOP_RADIUS_KM - EARTH_RADIUS_KM)
        radius0, cos_sun = torch.meshgrid(radius0, cos_sun, indexing="ij")
        shape = radius0.shape
        radius0, cos_sun = radius0.reshape(-1, 1), cos_sun.reshape(-1, 1)
        # 8 x 8 directions of equal solid angle
        m = (torch.arange(8, device=self.device) + 0.5) / 8
        mu, phi = torch.meshgrid(2 * m - 1, 2 * math.pi * m, indexing="ij")
        mu, phi = mu.reshape(1, -1), phi.reshape(1, -1)
        to_ground = _distance_to_ground(radius0, mu.expand(len(radius0), -1))
        hits = torch.isfinite(to_ground)
        length = torch.where(hits, to_ground, _distance_to_top(radius0, mu))
        steps = 20
        t = length[..., None] * (torch.arange(steps, device=self.device) + 0.5) / steps
        dt = (length / steps)[..., None].expand_as(t)
        r0 = radius0[..., None]
        radius = torch.sqrt(r0**2 + t**2 + 2 * r0 * t * mu[..., None])
        sin_sun = torch.sqrt((1 - cos_sun**2).clamp(min=0))
        cos_between = mu * cos_sun + torch.sqrt(1 - mu**2) * sin_sun * torch.cos(phi)
        cos_there = ((r0 * cos_sun[..., None]) + t * cos_between[..., None]) / radius
        rayleigh, mie, extinction = self._coefficients(radius)
        sunlight = self.transmittance(radius, cos_there)
        sunlight = sunlight * _above_horizon(radius, cos_there)[..., None]
        uniform = 1 / (4 * math.pi)
        scattering = rayleigh + mie
        second = _integrate_along(sunlight * scattering * uniform, extinction, dt)
        again = _integrate_along(scattering, extinction, dt)
        # sunlight off the Lambertian ground where the ray meets it
        through = torch.exp(-(extinction * dt[..., None]).sum(-2))
        lit = sunlight[..., -1, :] * cos_there[..., -1].clamp(min=0)[..., None]
        ground = through * lit * (self.atmosphere.ground_albedo / math.pi)
        second = second + torch.where(hits[..., None], ground, torch.zeros_like(ground))
        # the mean over directions equals the integral with the isotropic phase function
        psi = second.mean(1) / (1 - again.mean(1))
        return psi.reshape(*shape, 3)

    def _look_up_multiple(
        self, radius: Float[Tensor, "*s"], cos_sun: Float[Tensor, "*s"]
    ) -> Float[Tensor, "*s 3"]:
        height = (radius - EARTH_RADIUS_KM) / (TOP_RADIUS_KM - EARTH_RADIUS_KM)
        row = (torch.sqrt(height.clamp(0, 1)) - 0.01) / 0.98
        return _table(self._multiple, (cos_sun + 1) / 2, row)


def henyey_greenstein(cos_angle: Float[Tensor, "*s"], g: float) -> Float[Tensor, "*s"]:
    """(1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5); integrates to 1 over the sphere."""
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cos_angle) ** 1.5)


def _integrate_along(
    source: Float[Tensor, "*s k 3"], extinction: Float[Tensor, "*s k 3"], dt: Float[Tensor, "*s k"]
) -> Float[Tensor, "*s 3"]:
    """sum_i S_i T_i (1 - exp(-e_i dt_i)) / e_i: exact for coefficients constant per segment."""
    depth = extinction * dt[..., None]
    before = torch.exp(-(torch.cumsum(depth, -2) - depth))
    return (source * before * -torch.expm1(-depth) / extinction.clamp(min=1e-12)).sum(-2)


def _distance_to_top(radius: Float[Tensor, "*#s"], mu: Float[Tensor, "*#s"]) -> Float[Tensor, "*s"]:
    inside = (radius * mu) ** 2 + (TOP_RADIUS_KM - radius) * (TOP_RADIUS_KM + radius)
    return (-radius * mu + torch.sqrt(inside.clamp(min=0))).clamp(min=0)


def _distance_to_ground(
    radius: Float[Tensor, "*#s"], mu: Float[Tensor, "*s"]
) -> Float[Tensor, "*s"]:
    inside = (radius * mu) ** 2 - (radius - EARTH_RADIUS_KM) * (radius + EARTH_RADIUS_KM)
    distance = -radius * mu - torch.sqrt(inside.clamp(min=0))
    return torch.where((inside >= 0) & (mu < 0), distance, torch.inf)


def _above_horizon(radius: Float[Tensor, "*s"], cos_sun: Float[Tensor, "*s"]) -> Tensor:
    """1 where the Earth does not hide the sun, 0 where it does."""
    sin_horizon = EARTH_RADIUS_KM / radius
    return (cos_sun > -torch.sqrt((1 - sin_horizon**2).clamp(min=0))).to(radius)


def _table(
    table: Float[Tensor, "h w 3"], x: Float[Tensor, "*s"], y: Float[Tensor, "*s"]
) -> Float[Tensor, "*s 3"]:
    """Bilinear look-up; x along columns and y along rows, both in [0, 1] over cell centres."""
    grid = torch.stack([2 * x - 1, 2 * y - 1], -1).reshape(1, 1, -1, 2).to(table)
    image = table.permute(2, 0, 1)[None]
    value = torch.nn.functional.grid_sample(
        image, grid, mode="bilinear", padding_mode="border", align_corners=True
    )
    return value[0, :, 0].T.reshape(*x.shape, 3)
