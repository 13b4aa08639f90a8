"""The light of a sky on the surfaces of a scene before it."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.skies.surroundings.view import PARTS, View
from skylight.sphere.envmap import luminance
from skylight.sphere.grid import DirectionGrid

BEAM_OVER_MEAN = 10.0  # what is brighter than so many times the mean casts shadows
SUN_MARGIN_RAD = math.radians(3)  # about a pixel of 32 rows


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
