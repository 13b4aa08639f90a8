"""The faces under one light as their solver needs them, and the data term of each.

A face is held as pixels and transport on each level of its pyramid (:class:`FaceTerm`), the faces
of one light as :class:`LitFaces`; :class:`ObjectiveWeights` says how much the parts of the
objective count, :class:`Unpacked` what its free parameters mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from skylight.imaging._edits import PixelSlopes
from skylight.inverse._background import BackgroundTerm
from skylight.inverse._gauss_newton import charbonnier
from skylight.inverse._scan import SCAN_HEIGHT
from skylight.inverse._sun_prior import SunPrior
from skylight.sphere._envmap import luminance
from skylight.transport._normal_modes import SkyNormalModes
from skylight.transport._observation import Observation
from skylight.transport._reflection import SkyTransport, of_scene

# Automatic white balance misses the light's colour by 2 to 5 degrees in the mean, as the angle
# between colours (Gijsenij, Gevers & van de Weijer 2011, "Computational color constancy: survey and
# experiments", IEEE Trans. Image Processing 20(9); Cheng, Prasad & Brown 2014, JOSA A 31(5)). White
# turns by 2/3 of this spread, rms: 3.8 degrees.
WHITE_BALANCE_SPREAD = 0.1
# Of the log of what a camera's style and an editor make of a picture's saturation. Cameras bend
# each channel by a curve of their own and map colours into their gamut (Kim et al. 2012, "A new
# in-camera imaging model for color computer vision and its application", IEEE Trans. PAMI 34(12));
# styles and sliders make it more or less. By hand: with 0.2, the colour of the light on rendered
# faces that were not edited was a tenth further off.
SATURATION_SPREAD = 0.1


@dataclass(frozen=True, kw_only=True)
class Unpacked:
    """The physical meaning of a batch of free parameters: n photographs of f faces in all.

    ``balance`` is the log of each photograph's red and blue gain against green, ``edits`` that of
    its saturation and contrast; ``pigments`` what each face has of either pigment along k modes, in
    log green; ``turns`` by how much each face's normals are wrong along j modes, in their standard
    deviations.
    """

    light: Float[Tensor, "b p"]
    exposure: Float[Tensor, "b n"]
    balance: Float[Tensor, "b n 2"]
    edits: Float[Tensor, "b n 2"]
    specular_scale: Float[Tensor, "b f"]
    albedo: Float[Tensor, "b f 3"]
    ground_albedo: Float[Tensor, "b g"]
    pigments: Float[Tensor, "b f 2 k"]
    turns: Float[Tensor, "b f j"]


@dataclass(frozen=True, kw_only=True)
class ObjectiveWeights:
    """How much the parts count. All parts are negative log-likelihoods, in nats.

    ``noise`` is the expected mean deviation of a pixel from the model, relative to the face's
    mean radiance: not sensor noise, but freckles, specular reflection and wrong geometry.
    Neighbouring pixels deviate together, so a face's pixels count as ``independent`` observations,
    whatever their number; those of several faces add up. With ``noise_of_face`` that is the least:
    a face that deviates by more, as heads of real people do, is worth less. Its mean deviation m
    then costs ``independent (1 + log(m / noise))`` nats where m is more than ``noise``, the
    likeliest scale of Laplace's density being m itself.

    ``white_balance_spread`` is the standard deviation of the log of red and of blue against green
    that a camera leaves in a picture of something grey; 0 trusts its white balance.
    ``saturation_spread`` and ``contrast_spread`` are those of the log of what was done to a picture
    after it was taken (:mod:`skylight.imaging._edits`); 0 says nothing was. Contrast is left out by
    default: a face does not tell it from light that is stronger on one side. With a spread of 0.15,
    faces that were not edited had 1.1 to 1.4, and those whose contrast was 0.85 had 1.1 to 1.2.
    ``pigment_spread`` multiplies :data:`skylight.faces._skin.PIGMENT_SPREADS`, by which skin
    varies over a face; 0 gives a face one albedo.

    ``normal_spread`` multiplies the standard deviations of a head's normal errors
    (:mod:`skylight.faces._normal_errors`); 0 trusts the fitted head. It is less than 1 for the
    reason that follows: against data that count for too much, priors must too.

    ``sun_prior`` weighs what clock and place tell of the sun against the face as the posterior
    does, whose temperature (:class:`~skylight.inverse._posterior.PosteriorConstants`) was fitted to
    known suns: ``independent / noise`` times that. Heads are fitted wrongly all over, so what a
    face says of the sun's place is not as sure as so many independent pixels would make it.

    ``background`` multiplies the nats of what the photographs show beside the people; 0 leaves it
    out. Against data that count for too much, it must too: with 4 for 1, the median errors of the
    lower half were 0.19 for 0.25 in level and 0.08 for 0.10 in colour over 30 rendered people in
    simulated places (24 others, before backgrounds sharp and at infinity: 0.24 for 0.30 and 0.09
    for 0.12), and shading from it as good as before.
    """

    noise: float = 0.06
    independent: float = 250.0
    noise_of_face: bool = False
    light_prior: float = 1.0
    albedo_prior: float = 1.0
    ground_prior: float = 1.0
    white_balance_spread: float = WHITE_BALANCE_SPREAD
    saturation_spread: float = SATURATION_SPREAD
    contrast_spread: float = 0.0
    pigment_spread: float = 0.0
    normal_spread: float = 0.7
    sun_prior: float = 112.0
    background: float = 4.0


@dataclass(frozen=True, kw_only=True)
class Transported:
    """A face in lights, for an exposure, albedo and specular scale of 1.

    ``diffuse`` T l, what wrong normals add to it (``turned``; None where they are known), and what
    its surface reflects (``specular``; None where it is diffuse).
    """

    diffuse: Float[Tensor, "b m 3"]
    turned: Float[Tensor, "b m 3"] | None = None
    specular: Float[Tensor, "b m 3"] | None = None

    @property
    def diffuse_shading(self) -> Float[Tensor, "b m 3"]:
        """Never negative, whatever the normals."""
        return self.diffuse if self.turned is None else (self.diffuse + self.turned).clamp(min=0)


@dataclass(frozen=True, kw_only=True)
class FaceTerm:
    """One face of each of p problems as the objective sees it.

    ``target`` (p,m,3) the pixels; ``share`` (p,m,1) each pixel's weight over all pixels and
    channels, with sum 1/3 (0 beyond a face's own pixels, where others have more); ``photo`` counts
    a problem's photographs from 0: faces of one share its exposure. ``level`` (p,) is the face's
    mean luminance in the target's units, which deviations are relative to: a dark face in the shade
    says as much about light as a bright one. ``modes`` (p,m,k) are those of
    :mod:`skylight.faces._skin`, None for things of one albedo; ``normals`` how normals may be
    wrong, None where they are known. Where ``clipped``, the target is
    a lower bound: what is brighter deviates by nothing. Of a ``grey`` picture luminance alone is
    compared. ``background`` is that of the face's photograph, None where it is not used.

    Batches of shading have the ``problem`` of each row, in ascending order; None where there is
    but one.
    """

    target: Float[Tensor, "p m 3"]
    share: Float[Tensor, "p m 1"]
    transport: SkyTransport
    specular: SkyTransport | None
    level: Float[Tensor, " p"]
    photo: int = 0
    clipped: Bool[Tensor, "p m"] | None = None
    grey: bool = False
    modes: Float[Tensor, "p m k"] | None = None
    normals: SkyNormalModes | None = None
    background: BackgroundTerm | None = None

    @staticmethod
    def of(observation: Observation, *, sphere: bool = False) -> "FaceTerm":
        """The only face of a photograph whose mean luminance is 1, in one problem.

        For light of the whole ``sphere``, or of skies above grounds.
        """
        specular, clipped = observation.specular, observation.clipped
        normals, background = observation.normal_modes, observation.background
        return FaceTerm(
            target=observation.pixels[None],
            share=(observation.weights / observation.weights.sum())[None, :, None] / 3,
            transport=SkyTransport.of(observation.transport, sphere=sphere),
            specular=None if specular is None else SkyTransport.of(specular, sphere=sphere),
            level=observation.pixels.new_ones(1),
            clipped=None if clipped is None else clipped[None],
            grey=observation.grey,
            modes=None if observation.modes is None else observation.modes[None],
            normals=None if normals is None else SkyNormalModes.of(normals, sphere=sphere),
            background=None
            if background is None
            else BackgroundTerm.of(background, grey=observation.grey, sphere=sphere),
        )

    @staticmethod
    def together(terms: "Sequence[FaceTerm]") -> "FaceTerm":
        """The faces of as many problems of one :attr:`LitFaces.shape`; of one, without a copy."""
        first, *others = terms
        if not others:
            return first
        assert all(term.background is None for term in terms)  # their numbers of blocks differ
        specular = [term.specular for term in terms if term.specular is not None]
        modes = [term.modes for term in terms if term.modes is not None]
        normals = [term.normals for term in terms if term.normals is not None]
        clipped = [
            torch.zeros_like(term.share[..., 0], dtype=torch.bool)
            if term.clipped is None
            else term.clipped
            for term in terms
        ]
        return FaceTerm(
            target=_padded([term.target for term in terms]),
            share=_padded([term.share for term in terms]),
            transport=_scenes([term.transport for term in terms]),
            specular=_scenes(specular) if specular else None,
            level=torch.cat([term.level for term in terms]),
            photo=first.photo,
            clipped=_padded(clipped) if any(bool(one.any()) for one in clipped) else None,
            grey=first.grey,
            modes=_padded(modes) if modes else None,
            normals=None
            if not normals
            else SkyNormalModes(
                _padded([one.modes for one in normals]),
                _padded([one.visible for one in normals]),
                _padded([one.ground for one in normals]),
                normals[0].rows,
            ),
        )

    def transported(
        self,
        sky: Float[Tensor, "b n 3"],
        ground: Float[Tensor, "b 3"],
        turns: Float[Tensor, "b k"] | None,
        problem: Int[Tensor, " b"] | None = None,
    ) -> Transported:
        """This face in lights; its normals turned by so much, None where they are trusted."""
        turned, specular = None, None
        if self.normals is not None and turns is not None:
            turned = self.normals(sky, ground, turns, problem)
        if self.specular is not None:
            specular = self.specular.white(sky, ground, problem)
        return Transported(
            diffuse=self.transport.white(sky, ground, problem), turned=turned, specular=specular
        )

    @property
    def exact_share(self) -> Float[Tensor, "p m 1"]:
        """``share`` where the target is more than a bound."""
        return self.share if self.clipped is None else self.share * ~self.clipped[..., None]

    def seen(self, shading: Float[Tensor, "*b m 3"]) -> Float[Tensor, "*b m 3"]:
        """What the picture shows of a shading: of a grey one, luminance in all channels."""
        return luminance(shading)[..., None].expand_as(shading) if self.grey else shading

    def deviation(
        self, shading: Float[Tensor, "b m 3"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b m 3"]:
        """How far the face is from this shading, in its own level."""
        level = of_problem(self.level, problem)[:, None, None]
        deviation = (self.seen(shading) - of_problem(self.target, problem)) / level
        if self.clipped is None:
            return deviation
        clipped = of_problem(self.clipped, problem)[..., None]
        return torch.where(clipped, deviation.clamp(max=0), deviation)

    def deviation_slopes(
        self,
        shading: Float[Tensor, "b m 3"],
        slopes: PixelSlopes,
        problem: Int[Tensor, " b"] | None = None,
    ) -> PixelSlopes:
        """The :meth:`deviation`'s slopes, given those of the shading."""
        scale = 1 / of_problem(self.level, problem)[:, None, None]
        if self.clipped is not None:
            brighter = self.seen(shading) > of_problem(self.target, problem)
            kept = of_problem(self.clipped, problem)[..., None] & brighter
            scale = scale * ~kept
        return (slopes.grey() if self.grey else slopes).then(scale)

    def data_term(
        self,
        shading: Float[Tensor, "b m 3"],
        weights: ObjectiveWeights,
        problem: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, " b"]:
        """How unlikely the face is under this shading, in nats."""
        return data_term(self.deviation(shading, problem), of_problem(self.share, problem), weights)


def of_problem(
    x: Shaped[Tensor, "p *s"], problem: Int[Tensor, " b"] | None
) -> Shaped[Tensor, "_ *s"]:
    """Each row's own; what there is but one of is left to broadcast."""
    assert problem is not None or len(x) == 1
    return of_scene(x, problem)


def _padded(parts: Sequence[Shaped[Tensor, "1 _ *s"]]) -> Shaped[Tensor, "p m *s"]:
    """With zeros after the end of the shorter ones."""
    return pad_sequence([part[0] for part in parts], batch_first=True)


def _scenes(each: Sequence[SkyTransport]) -> SkyTransport:
    """The transport of as many scenes, all of one kind of light."""
    return SkyTransport(_padded([one.folded for one in each]), sphere=each[0].sphere)


def data_term(
    residual: Float[Tensor, "*b m 3"], share: Float[Tensor, "*#b m 1"], weights: ObjectiveWeights
) -> Float[Tensor, "*b"]:
    """How unlikely a residual is, in nats: its mean Charbonnier over the expected deviation.

    ``share`` holds each pixel's weight over all pixels and channels; it sums to 1/3.
    """
    off = (charbonnier(residual) * share).sum((-2, -1)) / weights.noise
    if weights.noise_of_face:
        off = torch.where(off > 1, 1 + off.clamp(min=1).log(), off)
    return weights.independent * off


class Level(NamedTuple):
    """Of the pyramid: 1 / 2^``pixels`` of the picture's resolution, 1 / 2^``light`` of the sky's.

    A sky on half as many rows takes a quarter of the time.
    """

    pixels: int
    light: int = 0


@dataclass(frozen=True, kw_only=True)
class ScannedFace:
    """What a solver needs of an observation: the pyramid's levels, and what the scan reads.

    Both are scaled to a mean luminance of 1 from ``mean``, in the photograph's units.
    """

    photo: int
    pyramid: dict[Level, FaceTerm]
    scanned: Observation
    mean: float

    @staticmethod
    def of(
        observation: Observation,
        photo: int,
        levels: Sequence[Level],
        device: torch.device,
        *,
        sphere: bool = False,
    ) -> "ScannedFace":
        """With those ``levels`` of the pyramid, on that device; for skies or the whole sphere."""
        mean = observation.mean_luminance
        pyramid = [observation.to(device).scaled(1 / mean)]
        while len(pyramid) <= max(level.pixels for level in levels):
            pyramid.append(pyramid[-1].coarser(1))
        assert observation.transport.grid.layout is not None
        rows = observation.transport.grid.layout[0]

        def term(level: Level) -> FaceTerm:
            coarse = pyramid[level.pixels].on_rows(rows >> level.light)
            return FaceTerm.of(coarse, sphere=sphere)

        return ScannedFace(
            photo=photo,
            pyramid={level: term(level) for level in levels},
            scanned=pyramid[0].on_rows(SCAN_HEIGHT),
            mean=mean,
        )


class LitFaces(list[ScannedFace]):
    """The faces under one sky, in the order in which they were added.

    ``sun_prior`` is what clock and place tell of their sun, or None.
    """

    def __init__(self, sun_prior: SunPrior | None = None) -> None:
        super().__init__()
        self.sun_prior = sun_prior

    @property
    def shape(self) -> tuple[tuple[int, bool, bool, bool, bool], ...]:
        """What problems have in common that can be solved together."""
        return tuple(
            (
                one.photo,
                one.scanned.specular is None,
                one.scanned.modes is None,
                one.scanned.normal_modes is None,
                one.scanned.grey,
            )
            for one in self
        )

    def scales(self) -> list[float]:
        """The mean luminance of each photograph's faces."""
        count = 1 + max(face.photo for face in self)
        return [fmean(face.mean for face in self if face.photo == k) for k in range(count)]

    def terms(self, level: Level) -> list[FaceTerm]:
        """Of one problem: each face at a level of the pyramid, in units of its photograph's scale.

        So are the exposures that explain it.
        """
        scales, terms = self.scales(), []
        for face in self:
            term, relative = face.pyramid[level], face.mean / scales[face.photo]
            terms.append(
                replace(
                    term,
                    target=term.target * relative,
                    photo=face.photo,
                    level=term.level * relative,
                    background=None
                    if term.background is None
                    else term.background.scaled(relative),
                )
            )
        return terms
