"""A layer of a scene: what it covers of a sky map, and the light that it sends.

Layers are painted over the sky with the farthest first. Here stands what all kinds of them use:
random numbers of a batch of scenes from one generator, random fields of a given roughness, the
light of a sky on surfaces before it, and the map's pixels, each column in parts.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid

Range = tuple[float | int, float | int]
Colour = tuple[float, float, float]
MOST_ALBEDO = 0.9  # about that of fresh snow
PARTS = 4  # of a column; rows are integrated exactly
TEXTURE_ROWS = 64  # from the horizon to the zenith: a texture's finest detail is 1.4 degrees
BEAM_OVER_MEAN = 10.0  # what is brighter than so many times the mean casts shadows
SUN_MARGIN_RAD = math.radians(3)  # about a pixel of 32 rows
EYE_M = 1.6  # above the ground
SNOW = 0.8  # albedo
NOWHERE = 9.0  # an elevation above all: what begins there is not seen
# The share of things before the sun that stay there: whoever takes a panorama for its light
# seldom stands in the shade.
SUN_HIDDEN = 0.2


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Draws for ``count`` scenes, which are the first axis of all that is drawn."""

    count: int
    generator: torch.Generator

    def uniform(self, between: Range, *shape: int) -> Float[Tensor, "b *s"]:
        low, high = between
        return low + (high - low) * torch.rand(self.count, *shape, generator=self.generator)

    def scale(self, between: Range, *shape: int) -> Float[Tensor, "b *s"]:
        """Positive numbers whose logarithm is uniform."""
        low, high = between
        return torch.exp(self.uniform((math.log(low), math.log(high)), *shape))

    def normal(self, *shape: int) -> Float[Tensor, "b *s"]:
        return torch.randn(self.count, *shape, generator=self.generator)

    def chance(self, share: float, *shape: int) -> Bool[Tensor, "b *s"]:
        return self.uniform((0.0, 1.0), *shape) < share

    def some(self, count: int) -> Bool[Tensor, "b n"]:
        """Which of ``count`` things are there: in each scene another share, up to all."""
        return self.uniform((0.0, 1.0), count) < self.uniform((0.3, 1.2), 1)

    def choice(self, weights: list[float], *shape: int) -> Int[Tensor, "b *s"]:
        """Indices with probabilities proportional to ``weights``."""
        edges = torch.tensor(weights).cumsum(0)
        return torch.bucketize(self.uniform((0.0, float(edges[-1])), *shape), edges[:-1])

    def azimuth(self, *shape: int) -> Float[Tensor, "b *s"]:
        return self.uniform((-math.pi, math.pi), *shape)

    def colour(self, table: tuple[Colour, ...], *shape: int) -> Float[Tensor, "b *s 3"]:
        """An albedo of the table, lighter or darker by 0.2 (of the logarithm)."""
        which = self.choice([1.0] * len(table), *shape)
        lighter = torch.exp(0.2 * self.normal(*shape))
        return (torch.tensor(table)[which] * lighter[..., None]).clamp(max=MOST_ALBEDO)


def rough_noise(
    draws: Draws, rows: int, columns: int, roughness: float
) -> Float[Tensor, "b rows columns"]:
    """Periodic noise of mean 0 and variance 1, amplitude ~ frequency^-roughness.

    One row is a profile. Frequencies are counted per ``columns`` in both directions.
    """
    along = torch.fft.rfftfreq(columns, 1 / columns)
    down = torch.fft.fftfreq(rows, 1 / columns)[:, None]
    gain = torch.hypot(along, down).clamp(min=1) ** -roughness
    gain[0, 0] = 0
    twice = torch.full((len(along),), 2.0)  # the other half of the spectrum mirrors this one
    twice[0] = twice[-1] = 1.0
    gain = gain / (gain.square() * twice).sum().div(rows * columns).sqrt()
    white = torch.fft.rfft2(draws.normal(rows, columns))
    return torch.fft.irfft2(white * gain, s=(rows, columns))


@dataclass(frozen=True)
class View:
    """The upper hemisphere seen through ``height`` rows and 4 ``height`` columns of pixels.

    Of the rows only those from the horizon up to number ``rows`` are looked at; 0 is all. All of
    a scene is said as intervals of elevation along the ``c`` = 16 ``height`` parts of
    columns; a pixel's rows are covered as far as intervals reach into them.
    """

    height: int
    rows: int = 0

    def up_to(self, elevation: float) -> "View":
        """The view of the rows that reach down to the horizon from an elevation (rad)."""
        rows = math.ceil(elevation / (math.pi / 2) * self.height)
        return View(self.height, min(max(rows, 1), self.height))

    @property
    def parts(self) -> int:
        return 4 * self.height * PARTS

    @cached_property
    def azimuth(self) -> Float[Tensor, " c"]:
        """Of the middle of each part."""
        return 2 * math.pi * ((torch.arange(self.parts) + 0.5) / self.parts - 0.5)

    @cached_property
    def elevation(self) -> Float[Tensor, "h 1"]:
        """Of the middle of each row that is looked at, the highest first."""
        down = (torch.arange(self.height) + 0.5) / self.height
        return (math.pi / 2 * (1 - down))[-self.rows :, None]

    @cached_property
    def frame(self) -> tuple[Float[Tensor, "c 3"], Float[Tensor, "c 3"]]:
        """(level unit vectors away from the observer, those to the right of them)."""
        sin, cos = torch.sin(self.azimuth), torch.cos(self.azimuth)
        zero = torch.zeros_like(sin)
        return torch.stack([sin, zero, -cos], -1), torch.stack([cos, zero, sin], -1)

    def between(
        self, low: Float[Tensor, "b c"], high: Float[Tensor, "b c"]
    ) -> Float[Tensor, "b h c"]:
        """The share of each row, in elevation, that lies from ``low`` to ``high`` (rad)."""
        step = math.pi / 2 / self.height
        bottom = self.elevation - step / 2
        reach = torch.minimum(high[:, None], bottom + step) - torch.maximum(low[:, None], bottom)
        return reach.clamp(min=0) / step

    def across(
        self, azimuth: Float[Tensor, "b n"], half_rad: Float[Tensor, "b n"]
    ) -> Float[Tensor, "b n c"]:
        """The share of each part that upright strips of a width of 2 ``half_rad`` cover."""
        step = 2 * math.pi / self.parts
        away = torch.remainder(self.azimuth - azimuth[..., None] + math.pi, 2 * math.pi) - math.pi
        half = half_rad[..., None]
        reach = torch.minimum(away + step / 2, half) - torch.maximum(away - step / 2, -half)
        return reach.clamp(min=0) / step

    def texture(self, draws: Draws, roughness: float) -> Float[Tensor, "b h c"]:
        """Rough noise over the hemisphere, drawn on one lattice for maps of all heights.

        A larger map so shows the same scene.
        """
        noise = rough_noise(draws, TEXTURE_ROWS, 4 * TEXTURE_ROWS, roughness)
        return _resized(noise, self.height, self.parts)[:, -self.rows :]

    def profile(self, draws: Draws, roughness: float) -> Float[Tensor, "b c"]:
        """Rough noise along the horizon."""
        noise = rough_noise(draws, 1, 4 * TEXTURE_ROWS, roughness)
        return _resized(noise, 1, self.parts)[:, 0]

    def pixels(self, fine: Float[Tensor, "b h c k"]) -> Float[Tensor, "b h w k"]:
        """The mean of each pixel's parts."""
        return fine.unflatten(2, (-1, PARTS)).mean(3)


def _resized(noise: Float[Tensor, "b r k"], height: int, columns: int) -> Float[Tensor, "b h c"]:
    """Averaged where it shrinks and interpolated where it grows, round the horizon."""
    rim = 4  # columns repeated beyond either end
    padded = torch.cat([noise[..., -rim:], noise, noise[..., :rim]], -1)[:, None]
    beyond = rim * columns // noise.shape[-1]
    size = (height, columns + 2 * beyond)
    wide = functional.interpolate(padded, size, mode="bilinear", antialias=height < noise.shape[1])
    return wide[:, 0, :, beyond : beyond + columns]


@dataclass(frozen=True, kw_only=True)
class Light:
    """Irradiance from the sky, the sun and the ground on a surface of any normal ``n``.

    ::

        E(n) = open (M0 / 4 + n . M1 / 2)+  +  lit beam (n . s)+  +  ground (1 - n_y) / 2

    The first term is the irradiance by the sky without its beam to the first order of spherical
    harmonics, M0 its integral over the hemisphere and M1 its first moment: exact for a uniform
    sky. ``open`` is how much of the sky other things leave free, ``lit`` of the sun.
    """

    integral: Float[Tensor, "b 3"]  # M0
    moment: Float[Tensor, "b 3 3"]  # M1: axis, channel
    beam: Float[Tensor, "b 3"]  # irradiance by the sun on a surface that faces it
    sun: Float[Tensor, "b 3"]  # s; the zenith where there is no beam
    ground: Float[Tensor, "b 3"]  # irradiance by the lower hemisphere on a surface that faces it
    horizon: Float[Tensor, "b c 3"]  # radiance of the sky above the horizon

    def of(self, which: Int[Tensor, " k"]) -> "Light":
        return Light(**{name: value[which] for name, value in vars(self).items()})

    @property
    def has_sun(self) -> Bool[Tensor, " b"]:
        return self.beam.sum(-1) > 0

    def diffuse(self, normal: Float[Tensor, "b *s 3"]) -> Float[Tensor, "b *s 3"]:
        """(M0 / 4 + n . M1 / 2)+."""
        along = sum(
            normal[..., axis : axis + 1] * spread(self.moment[:, axis], normal) for axis in range(3)
        )
        return (spread(self.integral / 4, normal) + along / 2).clamp(min=0)

    def towards_sun(self, normal: Float[Tensor, "b *s 3"]) -> Float[Tensor, "b *s 1"]:
        """n . s."""
        return (normal * spread(self.sun, normal)).sum(-1, keepdim=True)

    def from_ground(self, normal: Float[Tensor, "b *s 3"]) -> Float[Tensor, "b *s 3"]:
        return (1 - normal[..., 1:2]) / 2 * spread(self.ground, normal)

    def irradiance(
        self, normal: Float[Tensor, "b *s 3"], open_: Tensor, lit: Tensor
    ) -> Float[Tensor, "b *t 3"]:
        """E(n); ``open_`` and ``lit`` broadcast against ``(b, *s, 1)``."""
        beam = self.towards_sun(normal).clamp(min=0) * spread(self.beam, normal)
        return open_ * self.diffuse(normal) + lit * beam + self.from_ground(normal)

    def before_sun(
        self, low: Float[Tensor, "b n c"], high: Float[Tensor, "b n c"]
    ) -> Bool[Tensor, "b n"]:
        """Whether intervals of elevation cover the sun, if there is one, or come near it."""
        parts = low.shape[-1]
        aside = math.ceil(SUN_MARGIN_RAD / (2 * math.pi) * parts)
        azimuth = torch.atan2(self.sun[:, 0], -self.sun[:, 2])
        middle = ((azimuth / (2 * math.pi) + 0.5) * parts).long()
        near = (middle[:, None] + torch.arange(-aside, aside + 1)) % parts
        index = near[:, None].expand(-1, low.shape[1], -1)
        elevation = torch.asin(self.sun[:, 1].clamp(-1, 1))[:, None, None]
        under = low.gather(2, index) < elevation + SUN_MARGIN_RAD
        over = high.gather(2, index) > elevation - SUN_MARGIN_RAD
        return (under & over).any(-1) & self.has_sun[:, None]


def spread(each: Float[Tensor, "b 3"], like: Float[Tensor, "b *s _"]) -> Float[Tensor, "b *t 3"]:
    """One value per scene, to be multiplied with many."""
    return each.reshape(len(each), *[1] * (like.dim() - 2), 3)


def light_of(
    skies: Float[Tensor, "b h w 3"], view: View, ground_albedo: Float[Tensor, "b 3"]
) -> Light:
    """The light of sky maps over a level ground of the given albedo."""
    grid = DirectionGrid.sky(view.height)
    weight = grid.solid_angles.to(skies)[:, None]
    directions = grid.directions.to(skies)
    flat = skies.flatten(1, 2)
    mean = (luminance(flat) * weight[:, 0]).sum(1) / (2 * math.pi)
    bright = luminance(flat)[..., None]
    excess = (1 - BEAM_OVER_MEAN * mean[:, None, None] / bright.clamp(min=1e-9)).clamp(min=0)
    beam = flat * excess * weight
    rest = flat * (1 - excess)
    sun = luminance(beam) @ directions + 1e-9 * directions.new_tensor([0.0, 1.0, 0.0])
    up = torch.einsum("n,bnc->bc", grid.directions[:, 1].to(skies), flat * weight)
    low = (
        rest.reshape(skies.shape)[:, -max(1, view.height // 16) :]
        .mean(1)
        .repeat_interleave(PARTS, 1)
    )
    return Light(
        integral=(rest * weight).sum(1),
        moment=torch.einsum("nk,bnc->bkc", directions, rest * weight),
        beam=beam.sum(1),
        sun=sun / sun.norm(dim=-1, keepdim=True),
        ground=ground_albedo * up,
        horizon=low,
    )


@dataclass(frozen=True, kw_only=True)
class Site:
    """Where scenes are: their light, air and season. ``open`` is how free the sky is to all."""

    view: View
    light: Light
    open: Float[Tensor, " b"]
    visibility_m: Float[Tensor, " b"]
    snow: Float[Tensor, " b"]  # 1 where snow lies

    def up_to(self, elevation: float) -> "Site":
        """The same site, of which only what is below an elevation (rad) is looked at."""
        return replace(self, view=self.view.up_to(elevation))

    def of(self, which: Int[Tensor, " k"]) -> "Site":
        return Site(
            view=self.view,
            light=self.light.of(which),
            open=self.open[which],
            visibility_m=self.visibility_m[which],
            snow=self.snow[which],
        )


@dataclass(frozen=True, kw_only=True)
class Layer:
    """``cover`` in [0, 1] and the ``radiance`` of what covers, ``distance_m`` away.

    Of the lowest ``h`` rows of a map; it covers nothing above them.
    """

    cover: Float[Tensor, "b h c"]
    radiance: Float[Tensor, "b h c 3"]
    distance_m: Float[Tensor, "b c"]


def in_air(layer: Layer, site: Site) -> Float[Tensor, "b h c 3"]:
    """Radiance after the air before it: L T + (1 - T) horizon, T = exp(-3.9 d / visibility).

    Koschmieder's law; at the visibility's distance a contrast of 2 % is left.
    """
    depth = 3.9 * layer.distance_m / site.visibility_m[:, None]
    passed = torch.exp(-depth)[:, None, :, None]
    return layer.radiance * passed + (1 - passed) * site.light.horizon[:, None]
