"""The background of a photograph as a term of the objective: a window into the light.

Of block b and channel c, e_bc = log(predicted + f) - log(seen + f), with a floor f below which all
is black. A background is not at infinity, as maps are, nor in focus, so e has errors of several
frequencies: of its mean a over the channels, ::

    cov(a) = level^2 1 1^T + shape^2 (x x^T + y y^T) + detail^2 I,

with x and y where blocks are in the view, from -1 to 1, and of its colour, the two coordinates
orthogonal to a::

    cov = colour^2 1 1^T + hue^2 I.

Whitened by these, rows r are normal beforehand. Blocks that are clipped come after all others,
given which they are lower bounds of a; they tell nothing of colour. What a row costs is quadratic
up to :data:`BEND` and then linear. The background as a whole may be something else than the light:
a screen, a backdrop, a crowd. So the sum S over m rows counts as ::

    m log(1 + S / m),

whose slope, the :meth:`BackgroundTerm.trust`, falls where more is wrong than rows may be.
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.imaging._edits import PixelSlopes
from skylight.inverse._gauss_newton import CHARBONNIER_EPSILON, charbonnier
from skylight.sphere._envmap import luminance
from skylight.transport._background import Background
from skylight.transport._reflection import SkyTransport

FLOOR = 0.02  # of the face's mean luminance: below are glare, noise and black point
BEND = 1.5  # standard deviations
# sqrt(x^2 + 1e-6) of rows times this, counted so often, is BEND^2 sqrt(1 + (r / BEND)^2)
_SCALE = math.sqrt(CHARBONNIER_EPSILON) / BEND
ROW_WEIGHT = BEND**2 / math.sqrt(CHARBONNIER_EPSILON)


@dataclass(frozen=True, kw_only=True)
class BackgroundSpreads:
    """Standard deviations of the module's text, in natural logarithms.

    True maps of simulated places, seen behind rendered people at finite depth and out of focus, are
    off by 0.05, 0.05, 0.07, 0.02 and 0.03; but cameras are tilted, their tone curves unknown, and
    smooth models of light off by more. Twice as wide left more of the level's error on four of
    those people (0.09 for 0.05, medians), two thirds as wide took none of it. On 19 of them, in the
    light of one lamp, that error is 0.29, without the background 0.47; of colour 0.15 and 0.21.

    ``backdrop`` is added to ``level`` and half of it to ``colour`` where the background's contrast
    is far below ``lively``: what is even may be a backdrop.
    """

    level: float = 0.15
    shape: float = 0.25
    detail: float = 0.35
    colour: float = 0.06
    hue: float = 0.08
    backdrop: float = 0.7
    lively: float = 0.2


@dataclass(frozen=True, kw_only=True)
class BackgroundTerm:
    """The background of one photograph as the objective sees it, r rows of k blocks.

    ``light`` averages maps over blocks; ``radiance`` (k,3) is what was seen, in the units of the
    targets; ``whitened`` (k,k) are rows of the mean over channels, of which those that are
    ``bounds`` count where they are negative; ``colours`` (j,k) rows of colour.
    """

    light: SkyTransport
    radiance: Float[Tensor, "k 3"]
    whitened: Float[Tensor, "k k"]
    bounds: Bool[Tensor, " k"]
    colours: Float[Tensor, "j k"]
    grey: bool

    @staticmethod
    def of(
        background: Background,
        *,
        grey: bool = False,
        sphere: bool = False,
        spreads: BackgroundSpreads | None = None,
    ) -> "BackgroundTerm":
        """For light of the whole ``sphere``, or of skies above grounds."""
        spreads, averages = spreads or BackgroundSpreads(), background.averages
        towards = averages.matrix.double() @ averages.grid.directions.to(averages.matrix.device)
        places = towards[:, :2] / -towards[:, 2:].clamp(max=-1e-3)
        places = places - (places.amax(0) + places.amin(0)) / 2
        places = places / places.abs().amax(0).clamp(min=1e-6)
        plain = math.exp(-((background.contrast / spreads.lively) ** 2))
        one, eye = torch.ones_like(places[:, :1]), torch.eye(len(places)).to(places)
        level = spreads.level**2 + plain * spreads.backdrop**2
        colour = spreads.colour**2 + plain * (spreads.backdrop / 2) ** 2
        mean = level * one @ one.T + spreads.shape**2 * places @ places.T + spreads.detail**2 * eye
        exact = ~background.clipped
        order = torch.cat([exact.nonzero()[:, 0], background.clipped.nonzero()[:, 0]])
        count = int(exact.sum())
        whitened = _whitening(mean[order][:, order], count)[:, order.argsort()]
        colours = torch.zeros_like(mean)[:0] if grey else eye[exact]
        if len(colours):
            hues = colour * one @ one.T + spreads.hue**2 * eye
            colours = _whitening(hues[exact][:, exact], count) @ colours
        return BackgroundTerm(
            light=SkyTransport.of(averages, sphere=sphere),
            radiance=background.radiance,
            whitened=whitened.to(background.radiance),
            bounds=torch.arange(len(exact), device=exact.device) >= count,
            colours=colours.to(background.radiance),
            grey=grey,
        )

    def scaled(self, factor: float) -> "BackgroundTerm":
        """The same in other units."""
        return replace(self, radiance=self.radiance * factor)

    def seen(
        self, sky: Float[Tensor, "b n 3"], ground: Float[Tensor, "b 3"]
    ) -> Float[Tensor, "b k 3"]:
        """The blocks' radiance in lights, for an exposure of 1."""
        return self.light.white(sky, ground)

    def deviation(self, seen: Float[Tensor, "*b k 3"]) -> Float[Tensor, "*b r"]:
        """Rows of which each counts its :func:`charbonnier` :data:`ROW_WEIGHT` times."""
        if self.grey:
            seen = luminance(seen)[..., None].expand_as(seen)
        off = (seen.clamp(min=0) + FLOOR).log() - (self.radiance + FLOOR).log()
        mean = off.mean(-1) @ self.whitened.T
        mean = torch.where(self.bounds, mean.clamp(max=0), mean)
        colours = (self.colours @ off) @ _OPPONENTS.to(off)
        return _SCALE * torch.cat([mean, colours.flatten(-2)], -1)

    def deviation_changes(
        self,
        seen: Float[Tensor, "b k 3"],
        slopes: PixelSlopes,
        changes: Float[Tensor, "b s k 3"],
    ) -> Float[Tensor, "b s r"]:
        """The :meth:`deviation`'s derivatives along ``changes``, given the slopes of what is
        ``seen`` by them."""
        if self.grey:
            seen, slopes = luminance(seen)[..., None].expand_as(seen), slopes.grey()
        shown = seen.clamp(min=0) + FLOOR
        off = slopes.then((seen >= 0) / shown)(changes)
        kept = self.bounds & (
            (shown / (self.radiance + FLOOR)).log().mean(-1) @ self.whitened.T > 0
        )
        mean = (off.mean(-1) @ self.whitened.T) * ~kept[:, None]
        colours = (self.colours @ off) @ _OPPONENTS.to(off)
        return _SCALE * torch.cat([mean, colours.flatten(-2)], -1)

    def cost(self, deviation: Float[Tensor, "*b r"]) -> Float[Tensor, "*b"]:
        """How unlikely the background is, in nats."""
        rows = deviation.shape[-1]
        return rows * torch.log1p(_excess(deviation) / rows)

    def trust(self, deviation: Float[Tensor, "*b r"]) -> Float[Tensor, "*b"]:
        """How much the rows count, from 1 to 0."""
        return 1 / (1 + _excess(deviation) / deviation.shape[-1])


_OPPONENTS = torch.tensor([[1.0, -1.0, 0.0], [1.0, 1.0, -2.0]]).T / torch.tensor([2.0, 6.0]).sqrt()


def _excess(deviation: Float[Tensor, "*b r"]) -> Float[Tensor, "*b"]:
    return (ROW_WEIGHT * charbonnier(deviation) - BEND**2).sum(-1)


def _whitening(covariance: Float[Tensor, "k k"], count: int) -> Float[Tensor, "k k"]:
    """W with W C W^T = 1 over the first ``count``; each other row whitens one given the first."""
    first, other = covariance[:count, :count], covariance[count:, :count]
    root = torch.linalg.cholesky(first)
    whitening = torch.zeros_like(covariance)
    inverse = torch.linalg.solve_triangular(root, torch.eye(count).to(root), upper=False)
    whitening[:count, :count] = inverse
    told = other @ inverse.T  # what the first tell of the others, in standard deviations
    left = (covariance.diagonal()[count:] - told.square().sum(1)).sqrt()
    whitening[count:, :count] = -(told @ inverse) / left[:, None]
    whitening[count:, count:] = torch.diag_embed(1 / left)
    return whitening
