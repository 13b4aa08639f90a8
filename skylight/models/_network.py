"""What the networks that code skies have in common.

Skies are 32 x 128 upper hemispheres of relative radiance (mean luminance 1) with the sun in the
centre column. A network works on *coded* radiance, its logarithm: a clear sky spans five orders of
magnitude, and in linear values the L1 loss of the thesis leaves the sun to one pixel's gradient.

Where ``sun_head`` is set, the last five latents are the sun's own coordinates
(:mod:`sun_head`): the rest codes the sky without its sun, knowing where and how strong it is, and
decoding adds the sun's lobe. Its height, energy and sharpness then vary smoothly and
independently of the sky, whereas a network that paints the sun on pixels has to see every height
that a sun may have in training.
"""

import math
from abc import ABC, abstractmethod
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import transformed
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.models._sun_head import COORDINATES, NEAR_RAD, SunHead
from skylight.sphere._envmap import luminance, shift_columns
from skylight.sphere._frame import cosines

HEIGHT, WIDTH = 32, 128
COARSE_HEIGHTS = (4, 8, 16)  # on which skies can be had as well
# The middle of column 64, where training skies have their sun.
CENTRE_AZIMUTH_RAD = math.pi / WIDTH
# of coded radiance; exp(13) is 20 times the brightest pixel of 440 simulated days
CODE_LIMIT = 13.0


Coding = Literal["log", "linear"]


class SkyNetwork(Module, ABC):
    """Latents (b, ``latents``) <-> radiance (b, 32, 128, 3): the base of networks, yours too.

    A class of your own is made by the number of latents alone, ``MyNetwork(latents)``, which it
    hands on to this constructor, and has

    ``encode_coded(sun, coded)``
        latents (b, z) of coded skies (b, 3, 32, 128); the last five are ``sun`` (b, 5) as it was
        given, the sun's own coordinates, which no layer learns (there are none with
        ``sun=False``);
    ``decode_coded(z)``
        the coded skies (b, 3, 32, 128) of latents, without that sun; differentiable in them.

    All else has a default here that it may replace: :meth:`code` and :meth:`uncode`, which are
    fixed before training and depend on no weight, and :meth:`decode_at_azimuth`, which resamples
    columns where a network of coordinates turns exactly. Training tries these members on two
    skies and refuses in a line what does not fit.

    Parameters
    ----------
    latents
        Their number, the sun's five included.
    coding
        Of :meth:`code`: "log" radiance, or "linear".
    sun
        Whether the sun has coordinates of its own (:class:`SunHead`).
    """

    def __init__(self, latents: int, *, coding: Coding = "log", sun: bool = True) -> None:
        super().__init__()
        self.latents = latents
        self.coding: Coding = coding
        self.sun_head = SunHead(HEIGHT, CENTRE_AZIMUTH_RAD) if sun else None

    @property
    def sun(self) -> bool:
        """Whether the sun has coordinates of its own."""
        return self.sun_head is not None

    def code(self, radiance: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b 3 h w"]:
        """Radiance as the network sees it: log(1 + L), or L itself for ``coding="linear"``."""
        planes = radiance.permute(0, 3, 1, 2)
        return torch.log1p(planes) if self.coding == "log" else planes

    def uncode(self, coded: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b h w 3"]:
        """The inverse of :meth:`code`, negative radiance cut to zero."""
        planes = coded.clamp(min=0)
        if self.coding == "log":
            planes = torch.expm1(planes.clamp(max=CODE_LIMIT))
        return planes.permute(0, 2, 3, 1)

    @abstractmethod
    def encode_coded(
        self, sun: Float[Tensor, "b s"], coded: Float[Tensor, "b 3 h w"]
    ) -> Float[Tensor, "b z"]:
        """Latents of the two parts that :meth:`split` gives, the second one coded."""

    @abstractmethod
    def decode_coded(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        """Coded radiance, without the sun where it has its own head."""

    def decode_at_azimuth(
        self,
        z: Float[Tensor, "b z"],
        azimuth_rad: Float[Tensor, " t"],
        sun_spread_rad: float,
        height: int = HEIGHT,
    ) -> Float[Tensor, "b h w 3"]:
        """:meth:`decode` in evaluation mode, the skies rotated so that suns are at those azimuths.

        Differentiable in both; one azimuth serves any number of skies. ``sun_spread_rad`` widens
        the sun's lobe: see :meth:`~skylight.models._sun_head.SunHead.lobe`. ``height`` is
        the number of rows, one of :data:`COARSE_HEIGHTS`, :data:`HEIGHT` or a multiple of it.

        Here columns are resampled; on more rows pixels are repeated, on fewer those of the mean.
        With a spread the sun's lobe is evaluated at its azimuth and only the rest is resampled: a
        sun much sharper than a pixel jumps from one to the next, and a turn by part of a pixel
        blurs it.
        """
        self.check_latents(z)
        z, azimuth_rad = (self._in_own_precision(x) for x in (z, azimuth_rad))
        sky = self.uncode(self._decode_in_evaluation(z))
        turn = (azimuth_rad - CENTRE_AZIMUTH_RAD).expand(z.shape[0])
        if self.sun_head is not None and sun_spread_rad == 0 and height == HEIGHT:
            return shift_columns(sky + self.sun_head.lobe(z[:, -COORDINATES:]), turn)
        sky = shift_columns(sky, turn)
        if height < HEIGHT:
            sky = sky.unflatten(1, (height, -1)).unflatten(3, (4 * height, -1)).mean((2, 4))
        elif height > HEIGHT:
            times = height // HEIGHT
            sky = sky.repeat_interleave(times, 1).repeat_interleave(times, 2)
        if self.sun_head is None:
            return sky
        rows = None if height == HEIGHT else height
        return sky + self.sun_head.lobe(z[:, -COORDINATES:], azimuth_rad, sun_spread_rad, rows)

    def _decode_in_evaluation(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        """:meth:`decode_coded` as :meth:`decode_at_azimuth` wants it."""
        return self.decode_coded(z)

    def check_latents(self, z: Float[Tensor, "b z"]) -> None:
        """:class:`InputError` for latents of another number than the network's."""
        check_shape(f"{type(self).__name__}'s latents", z.shape, self.latents)

    def _in_own_precision(self, x: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
        """That of the weights, which is a part of what they learnt."""
        return x.to(next(self.parameters(), x).dtype)

    def split(
        self, radiance: Float[Tensor, "b h w 3"]
    ) -> tuple[Float[Tensor, "b s"], Float[Tensor, "b h w 3"]]:
        """(coordinates of the sun, none without a sun head; the sky without it)."""
        if self.sun_head is None:
            return radiance.new_zeros(len(radiance), 0), radiance
        return self.sun_head.split(radiance)

    def encode(self, radiance: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b z"]:
        """Latents of skies with the sun in the centre column and mean luminance 1.

        Raises
        ------
        InputError
            Skies of another size, or a sun elsewhere: networks know it in the centre only, and
            take it for a bright cloud. A light model turns skies back by its azimuth.
        """
        check_shape(f"{type(self).__name__}'s skies", radiance.shape, HEIGHT, WIDTH, 3)
        _check_centred(radiance, self.sun_head)
        sun, rest = self.split(self._in_own_precision(radiance))
        return self.encode_coded(sun, self.code(rest))

    def decode(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b h w 3"]:
        """Relative radiance, >= 0."""
        z = self._in_own_precision(z)
        sky = self.uncode(self.decode_coded(z))
        if self.sun_head is None:
            return sky
        return sky + self.sun_head.lobe(z[:, -COORDINATES:])


_SUN_SHARE = 0.1  # of all light, within six degrees: a bright cloud has a third of that
_ASIDE_RAD = math.radians(7.0)  # two columns and a half at the horizon


def _check_centred(skies: Float[Tensor, "b h w 3"], head: SunHead | None) -> None:
    """:class:`InputError` for skies whose sun is not in the centre column."""
    if torch.compiler.is_compiling() or transformed() or skies.is_meta or len(skies) == 0:
        return  # values cannot be looked at
    head = head or SunHead(HEIGHT, CENTRE_AZIMUTH_RAD).to(skies.device)
    directions = head.directions.double()
    radiance = luminance(skies.detach().flatten(1, 2).double())
    light = radiance * head.solid_angles
    peak = radiance.argmax(1)
    near = cosines(directions[peak], directions) > math.cos(NEAR_RAD)
    is_sun = (light * near).sum(1) > _SUN_SHARE * light.sum(1)
    columns = peak % WIDTH - WIDTH // 2
    # from the half circle from the zenith through the centre, near which all columns are near
    turn = (2 * math.pi / WIDTH * columns.double()).clamp(-math.pi / 2, math.pi / 2)
    aside = (1 - directions[peak, 1].square()).sqrt() * turn.sin().abs()
    for sky in torch.nonzero(is_sun & (aside > math.sin(_ASIDE_RAD)))[:1, 0].tolist():
        off = int(columns[sky])
        raise InputError(
            f"the sun of sky {sky} stands {abs(off)} columns {'right' if off > 0 else 'left'} of "
            f"the centre: turn the sky by {-off * 2 * math.pi / WIDTH:.3f} rad first "
            "(skylight.sphere.shift_columns)"
        )
