"""The clear sky: radiative transfer through air, aerosol and ozone round a spherical Earth.

Single scattering is integrated along the view rays; all higher orders follow from one small
table after Hillaire (2020), "A Scalable and Production Ready Sky and Atmosphere Rendering
Technique", which assumes that they are isotropic and that neighbouring points see the same
light. Aerosol scatters mostly forward: for multiply scattered light the fraction g of its
scattering is treated as transmission ("scaled" below; the similarity relation of
van de Hulst 1980, used with the unscaled phase function for the first order as by Nakajima &
Tanaka 1988). Diffuse irradiance is within 4 % of Monte Carlo (sun 0 to 75
degrees from the zenith, aerosol optical depth 0 to 0.4).

Three wavelengths stand for the three Rec.709 primaries (as in Bruneton & Neyret 2008); against a
spectral computation this costs some colour accuracy in twilight and little by day.

Unit: radiance and irradiance are relative to the extraterrestrial solar irradiance, whose
Rec.709 luminance is 1.
"""

import math
from collections.abc import Callable
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
        self._transmittance = self._transmittance_table(height=128, width=512)
        self._multiple = self._multiple_scattering_table(size=32)

    def sun_irradiance(
        self, sun_zenith_rad: Float[Tensor, " b"], *, height_km: float | None = None
    ) -> Float[Tensor, "b 3"]:
        """Irradiance of the sun on a plane facing it, after extinction.

        At the observer, or at a height above sea level.
        """
        zenith = sun_zenith_rad.double()  # float32 has the radius to half a metre only
        level = self.atmosphere.observer_km if height_km is None else height_km
        radius = torch.full_like(zenith, EARTH_RADIUS_KM + level)
        through = self.transmittance(radius, zenith.cos())
        return self._colour() * through.to(sun_zenith_rad)

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
        # cubic spacing: the haze is close to the observer
        edges = torch.linspace(0, 1, steps + 1, device=self.device) ** 3
        t = length[:, None] * (edges[1:] + edges[:-1]) / 2
        dt = length[:, None] * torch.diff(edges)
        radius = torch.sqrt(radius0**2 + t**2 + 2 * radius0 * t * mu[:, None])
        cos_sun = ((radius0 * sun[1]) + t * (directions @ sun)[:, None]) / radius
        rayleigh, mie, extinction = self._coefficients(radius)
        sunlight = self._sunlight(radius, cos_sun)
        cos_angle = directions @ sun
        phase_r = (3 / (16 * math.pi)) * (1 + cos_angle**2)
        phase_m = self._haze_phase(cos_angle, sun[1])
        source = sunlight * (rayleigh * phase_r[:, None, None] + mie * phase_m[:, None])
        around = rayleigh + (1 - air.aerosol_g) * mie
        source = source + self._look_up_multiple(radius, cos_sun) * around
        return self._colour() * _integrate_along(source, extinction, dt)

    def transmittance(
        self, radius: Float[Tensor, "*s"], mu: Float[Tensor, "*s"]
    ) -> Float[Tensor, "*s 3"]:
        """exp(-optical depth) from radius (km) to the top of the air along zenith cosine mu.

        Without tables, in float64, cast to radius' type: relative error below 1e-4 down to the
        horizon. A ray that meets the ground is taken for the one that grazes it.
        """
        columns = self._columns(radius.double(), mu.double())
        return torch.exp(-columns @ self._extinction_per_km().to(columns)).to(radius)

    def _columns(
        self, radius: Float[Tensor, "*s"], mu: Float[Tensor, "*s"]
    ) -> Float[Tensor, "*s 3"]:
        """Air, haze and ozone along the rays up to the top, as km of their densest."""
        horizon = -torch.sqrt((1 - (EARTH_RADIUS_KM / radius) ** 2).clamp(min=0))
        mu = torch.maximum(mu, horizon)
        return torch.stack(
            [
                _column(radius, mu, lambda r, m: _exponential_column(r, m, RAYLEIGH_HEIGHT_KM)),
                _column(radius, mu, lambda r, m: _exponential_column(r, m, MIE_HEIGHT_KM)),
                _column(radius, mu, _ozone_column),
            ],
            -1,
        )

    def _haze_phase(
        self, cos_angle: Float[Tensor, " n"], cos_sun: Float[Tensor, ""]
    ) -> Float[Tensor, "n 3"]:
        """Henyey & Greenstein's function, its forward peak lowered to conserve energy.

        With x the optical depth of forward scattering on the sun's path, the peak shall hold
        exp(-tau') (1 - exp(-x)) of the sunlight; single scattering puts exp(-tau') x there.
        """
        air = self.atmosphere
        column = self._columns(
            torch.tensor([self._observer_radius], dtype=torch.float64, device=self.device),
            cos_sun[None].double(),
        )[:, 1]
        forward = self._extinction_per_km()[1] * air.aerosol_albedo * air.aerosol_g
        x = (column.to(cos_angle) * forward).clamp(min=1e-6)
        kept = -torch.expm1(-x) / x
        phase = henyey_greenstein(cos_angle, air.aerosol_g)[:, None]
        return kept * phase + (1 - kept) * (1 - air.aerosol_g) / (4 * math.pi)

    @property
    def _observer_radius(self) -> float:
        return EARTH_RADIUS_KM + self.atmosphere.observer_km

    def _colour(self) -> Float[Tensor, "3"]:
        return torch.tensor(SUN_COLOUR, device=self.device)

    def _coefficients(
        self, radius: Float[Tensor, "*s"]
    ) -> tuple[Float[Tensor, "*s 3"], Float[Tensor, "*s 3"], Float[Tensor, "*s 3"]]:
        """Rayleigh scattering, haze scattering and scaled total extinction per km at a radius."""
        height = (radius - EARTH_RADIUS_KM).clamp(min=0)[..., None]
        per_km = self._extinction_per_km()
        rayleigh = per_km[0] * torch.exp(-height / RAYLEIGH_HEIGHT_KM)
        thinning = torch.exp(-height / MIE_HEIGHT_KM)
        layer = (1 - (height - OZONE_CENTRE_KM).abs() / OZONE_HALF_WIDTH_KM).clamp(min=0)
        scaled = self._extinction_per_km(scaled=True)[1]
        extinction = rayleigh + scaled * thinning + per_km[2] * layer
        return rayleigh, self.atmosphere.aerosol_albedo * per_km[1] * thinning, extinction

    def _extinction_per_km(self, *, scaled: bool = False) -> Float[Tensor, "3 3"]:
        """Rows: air and haze at sea level, ozone at the middle of its layer; columns: colours.

        ``scaled``: the fraction g of the aerosol's scattering is transmission (see the module).
        """
        air = self.atmosphere
        relative = torch.tensor(WAVELENGTHS_NM, device=self.device) / 550.0
        haze = air.aerosol_optical_depth / MIE_HEIGHT_KM * relative**-air.angstrom_exponent
        if scaled:
            haze = haze * (1 - air.aerosol_albedo * air.aerosol_g)
        ozone = air.ozone * torch.tensor(OZONE_ABSORPTION_PER_KM, device=self.device)
        return torch.stack([torch.tensor(RAYLEIGH_PER_KM, device=self.device), haze, ozone])

    def _transmittance_table(self, *, height: int, width: int) -> Float[Tensor, "h w 3"]:
        """exp(-scaled optical depth) to the top, as :meth:`_sunlight` looks it up.

        Bruneton's parametrisation: x by distance to the top, y by distance to the horizon.
        """
        horizon = math.sqrt(TOP_RADIUS_KM**2 - EARTH_RADIUS_KM**2)
        cells = {"dtype": torch.float64, "device": self.device}
        rho = torch.linspace(0, 1, height, **cells)[:, None] * horizon
        radius = torch.sqrt(rho**2 + EARTH_RADIUS_KM**2)
        near, far = TOP_RADIUS_KM - radius, rho + horizon
        distance = near + torch.linspace(0, 1, width, **cells) * (far - near)
        mu = (horizon**2 - rho**2 - distance**2) / (2 * radius * distance).clamp(min=1e-6)
        mu = torch.where(distance > 0, mu, torch.ones_like(mu)).clamp(-1, 1)
        columns = self._columns(radius.expand_as(mu), mu)
        return torch.exp(-columns @ self._extinction_per_km(scaled=True).to(columns)).float()

    def _sunlight(
        self, radius: Float[Tensor, "*s"], cos_sun: Float[Tensor, "*s"]
    ) -> Float[Tensor, "*s 3"]:
        """Scaled transmittance towards the sun by the table, 0 where the Earth hides it.

        Quicker than :meth:`transmittance`, and good enough for light that is scattered.
        """
        horizon = math.sqrt(TOP_RADIUS_KM**2 - EARTH_RADIUS_KM**2)
        rho = torch.sqrt((radius**2 - EARTH_RADIUS_KM**2).clamp(min=0))
        near, far = TOP_RADIUS_KM - radius, rho + horizon
        x = ((_distance_to_top(radius, cos_sun) - near) / (far - near)).clamp(0, 1)
        lit = _above_horizon(radius, cos_sun)[..., None]
        return _table(self._transmittance, x, rho / horizon) * lit

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
        # 12 x 8 directions, closest together at the horizon, whence thin air gets most light; the
        # half of them on the other side of the sun's meridian would see the same
        ring = (torch.arange(12, device=self.device) + 0.5) / 6 - 1
        around = math.pi * (torch.arange(4, device=self.device) + 0.5) / 4
        mu, phi = torch.meshgrid(ring * ring.abs(), around, indexing="ij")
        mu, phi = mu.reshape(1, -1), phi.reshape(1, -1)
        weight = torch.sqrt(mu.abs())[..., None] / torch.sqrt(mu.abs()).sum()
        to_ground = _distance_to_ground(radius0, mu.expand(len(radius0), -1))
        hits = torch.isfinite(to_ground)
        length = torch.where(hits, to_ground, _distance_to_top(radius0, mu))
        edges = torch.linspace(0, 1, 21, device=self.device) ** 2
        t = length[..., None] * (edges[1:] + edges[:-1]) / 2
        dt = length[..., None] * torch.diff(edges)
        r0 = radius0[..., None]
        radius = torch.sqrt(r0**2 + t**2 + 2 * r0 * t * mu[..., None])
        sin_sun = torch.sqrt((1 - cos_sun**2).clamp(min=0))
        cos_between = mu * cos_sun + torch.sqrt(1 - mu**2) * sin_sun * torch.cos(phi)
        cos_there = ((r0 * cos_sun[..., None]) + t * cos_between[..., None]) / radius
        rayleigh, mie, extinction = self._coefficients(radius)
        scattering = rayleigh + (1 - self.atmosphere.aerosol_g) * mie
        sunlight = self._sunlight(radius, cos_there)
        second = _integrate_along(sunlight * scattering / (4 * math.pi), extinction, dt)
        again = _integrate_along(scattering, extinction, dt)
        # the Lambertian ground where the ray meets it, under the sun and under isotropic light
        through = torch.exp(-(extinction * dt[..., None]).sum(-2)) * hits[..., None]
        through = through * self.atmosphere.ground_albedo
        cos_ground = ((radius0 * cos_sun) + length * cos_between) / EARTH_RADIUS_KM
        sun_on_ground = self._sunlight(torch.full_like(cos_ground, EARTH_RADIUS_KM), cos_ground)
        second = second + through * sun_on_ground * cos_ground.clamp(min=0)[..., None] / math.pi
        again = again + through
        # the mean over directions equals the integral with the isotropic phase function
        psi = (weight * second).sum(1) / (1 - (weight * again).sum(1))
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


def _column(
    radius: Float[Tensor, "*s"],
    mu: Float[Tensor, "*s"],
    rising: Callable[[Tensor, Tensor], Tensor],
) -> Float[Tensor, "*s"]:
    """km of sea-level density from radius outwards, given those of rays that rise (mu >= 0).

    A falling ray is the whole ray through its lowest point less the part behind it.
    """
    lowest = radius * torch.sqrt(1 - mu**2)
    ahead = rising(radius, mu.abs())
    return torch.where(mu < 0, 2 * rising(lowest, torch.zeros_like(mu)) - ahead, ahead)


def _exponential_column(
    radius: Float[Tensor, "*s"], mu: Float[Tensor, "*s"], scale_km: float
) -> Float[Tensor, "*s"]:
    """Integral of exp(-height / scale) along a rising ray (Chapman's function), in km.

    With y the height above the start, s the sine of the zenith angle, a = r (1 - s) and
    b = r (1 + s) it is the integral of exp(-y / H) (r + y) / sqrt((y + a) (y + b)) dy; with
    (r + y) / sqrt(y + b) taken as linear in y both parts have closed forms. Relative error of
    the order (H / r)^2.
    """
    sine = torch.sqrt(1 - mu**2)
    a = radius * mu**2 / (1 + sine)  # r (1 - s) without its cancellation
    b = radius * (1 + sine)
    constant = math.sqrt(math.pi * scale_km) * torch.special.erfcx(torch.sqrt(a / scale_km))
    linear = scale_km * torch.sqrt(a) + (scale_km / 2 - a) * constant
    start = torch.exp(-(radius - EARTH_RADIUS_KM) / scale_km)
    return start * radius / torch.sqrt(b) * (constant + (1 / radius - 0.5 / b) * linear)


def _ozone_column(radius: Float[Tensor, "*s"], mu: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Integral of the tent 1 - |height - centre| / half width along a rising ray, in km.

    In closed form: with p the least radius and w = sqrt(r^2 - p^2), dt = r dr / w and
    integral (r - e) dt = (r w + p^2 log(r + w)) / 2 - e w.
    """
    least = radius * torch.sqrt(1 - mu**2)

    def slope(edge: float, low: Tensor, high: Tensor) -> Tensor:
        def primitive(r: Tensor) -> Tensor:
            w = torch.sqrt((r**2 - least**2).clamp(min=0))
            return (r * w + least**2 * torch.log(r + w)) / 2 - edge * w

        return (primitive(high) - primitive(low)) / OZONE_HALF_WIDTH_KM

    centre = EARTH_RADIUS_KM + OZONE_CENTRE_KM
    bottom, top = centre - OZONE_HALF_WIDTH_KM, centre + OZONE_HALF_WIDTH_KM
    edges = [radius.clamp(min=edge) for edge in (bottom, centre, top)]
    return slope(bottom, edges[0], edges[1]) - slope(top, edges[1], edges[2])


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
