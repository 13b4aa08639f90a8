"""The objective of inverse lighting (thesis, Eq. 5.8) as a function of free parameters.

One light, seen on one face or more: every face adds its own data term and priors. Problems of one
shape (as many faces in the same photographs, all with gloss or none) share one objective, so that
points of all of them are evaluated as one batch.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils.rnn import pad_sequence

from skylight.faces.skin import PIGMENT_COLOURS, PIGMENT_SPREADS
from skylight.inverse.scale import GLOSS_SPREAD, bayes_scale, gloss_nll, scale_nll, tone_prior
from skylight.inverse.sun_prior import SunPrior
from skylight.models.base import LightModel, Prior, without_azimuth
from skylight.models.ground import LambertianGround, ground_prior
from skylight.models.prior import GaussianMixture
from skylight.sphere.envmap import luminance
from skylight.transport.diffuse import SkyTransport, shade_scenes
from skylight.transport.normal_modes import SkyNormalModes
from skylight.transport.observation import Observation

CHARBONNIER_EPSILON = 1e-6
# Automatic white balance misses the light's colour by 2 to 5 degrees in the mean, as the angle
# between colours (Gijsenij, Gevers & van de Weijer 2011, "Computational color constancy: survey and
# experiments", IEEE Trans. Image Processing 20(9); Cheng, Prasad & Brown 2014, JOSA A 31(5)). White
# turns by 2/3 of this spread, rms: 3.8 degrees.
WHITE_BALANCE_SPREAD = 0.1


# A free parameter of 1 is so many standard deviations of a turn: without, a turn's slope is so much
# less than those of light and exposure that quasi-Newton steps do not reach it.
TURN_STEP = 10.0


@dataclass(frozen=True, kw_only=True)
class ObjectiveWeights:
    """How much the parts count. All parts are negative log-likelihoods, in nats.

    ``noise`` is the expected mean deviation of a pixel from the model, relative to the face's
    mean radiance: not sensor noise, but freckles, gloss and wrong geometry. Neighbouring pixels
    deviate together, so a face's pixels count as ``independent`` observations, whatever their
    number; those of several faces add up.

    ``white_balance_spread`` is the standard deviation of the log of red and of blue against green
    that a camera leaves in a picture of something grey; 0 trusts its white balance.
    ``pigment_spread`` multiplies :data:`skylight.faces.skin.PIGMENT_SPREADS`, by which skin
    varies over a face; 0 gives a face one albedo.

    ``normal_spread`` multiplies the standard deviations of a head's normal errors
    (:mod:`skylight.faces.normal_errors`); 0 trusts the fitted head. It is less than 1 for the
    reason that follows: against data that count for too much, priors must too.

    ``sun_prior`` weighs what clock and place tell of the sun against the face as the posterior
    does, whose temperature (:class:`~skylight.inverse.posterior.PosteriorConstants`) was fitted to
    known suns: ``independent / noise`` times that. Heads are fitted wrongly all over, so what a
    face says of the sun's place is not as sure as so many independent pixels would make it.
    """

    noise: float = 0.06
    independent: float = 250.0
    light_prior: float = 1.0
    albedo_prior: float = 1.0
    ground_prior: float = 1.0
    white_balance_spread: float = WHITE_BALANCE_SPREAD
    pigment_spread: float = 0.0
    normal_spread: float = 0.7
    sun_prior: float = 112.0


@dataclass(frozen=True, kw_only=True)
class FaceTerm:
    """One face of each of p problems as the objective sees it.

    ``target`` (p,m,3) the pixels; ``share`` (p,m,1) each pixel's weight over all pixels and
    channels, with sum 1/3 (0 beyond a face's own pixels, where others have more); ``photo`` counts
    a problem's photographs from 0: faces of one share its exposure. ``level`` (p,) is the face's
    mean luminance in the target's units, which deviations are relative to: a dark face in the shade
    says as much about light as a bright one. ``modes`` (p,m,k) are those of
    :mod:`skylight.faces.skin`, None for things of one albedo; ``normals`` how normals may be wrong,
    None where they are known. Where ``clipped``, the target is
    a lower bound: what is brighter deviates by nothing. Of a ``grey`` picture luminance alone is
    compared.

    Batches of shading have the ``problem`` of each row, in ascending order; None where there is
    but one.
    """

    target: Float[Tensor, "p m 3"]
    share: Float[Tensor, "p m 1"]
    transport: SkyTransport
    gloss: SkyTransport | None
    level: Float[Tensor, " p"]
    photo: int = 0
    clipped: Bool[Tensor, "p m"] | None = None
    grey: bool = False
    modes: Float[Tensor, "p m k"] | None = None
    normals: SkyNormalModes | None = None

    @staticmethod
    def of(observation: Observation) -> "FaceTerm":
        """The only face of a photograph whose mean luminance is 1, in one problem."""
        gloss, clipped = observation.gloss, observation.clipped
        normals = observation.normal_modes
        return FaceTerm(
            target=observation.pixels[None],
            share=(observation.weights / observation.weights.sum())[None, :, None] / 3,
            transport=SkyTransport.of(observation.transport),
            gloss=None if gloss is None else SkyTransport.of(gloss),
            level=observation.pixels.new_ones(1),
            clipped=None if clipped is None else clipped[None],
            grey=observation.grey,
            modes=None if observation.modes is None else observation.modes[None],
            normals=None if normals is None else SkyNormalModes.of(normals),
        )

    @staticmethod
    def together(terms: "Sequence[FaceTerm]") -> "FaceTerm":
        """The faces of as many problems; of one, without a copy."""
        first, *others = terms
        if not others:
            return first
        glosses = [term.gloss for term in terms if term.gloss is not None]
        modes = [term.modes for term in terms if term.modes is not None]
        normals = [term.normals for term in terms if term.normals is not None]
        if any(len(each) not in (0, len(terms)) for each in (glosses, modes, normals)) or any(
            (term.photo, term.grey) != (first.photo, first.grey) for term in others
        ):
            raise ValueError(
                "faces of several problems must all have gloss or none, all modes or none, all "
                "normals' errors or none, all colour or none, and one photo"
            )
        clipped = [
            torch.zeros_like(term.share[..., 0], dtype=torch.bool)
            if term.clipped is None
            else term.clipped
            for term in terms
        ]
        return FaceTerm(
            target=_padded([term.target for term in terms]),
            share=_padded([term.share for term in terms]),
            transport=SkyTransport(_padded([term.transport.folded for term in terms])),
            gloss=SkyTransport(_padded([one.folded for one in glosses])) if glosses else None,
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
        level = _of(self.level, problem)[:, None, None]
        deviation = (self.seen(shading) - _of(self.target, problem)) / level
        if self.clipped is None:
            return deviation
        clipped = _of(self.clipped, problem)[..., None]
        return torch.where(clipped, deviation.clamp(max=0), deviation)

    def data_term(
        self,
        shading: Float[Tensor, "b m 3"],
        weights: ObjectiveWeights,
        problem: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, " b"]:
        """How unlikely the face is under this shading, in nats."""
        return data_term(self.deviation(shading, problem), _of(self.share, problem), weights)


def _of(x: Shaped[Tensor, "p *s"], problem: Int[Tensor, " b"] | None) -> Shaped[Tensor, "_ *s"]:
    """Each row's own; what there is but one of is left to broadcast."""
    assert problem is not None or len(x) == 1
    return x if len(x) == 1 else x[problem]


def _padded(parts: Sequence[Shaped[Tensor, "1 _ *s"]]) -> Shaped[Tensor, "p m *s"]:
    """With zeros after the end of the shorter ones."""
    return pad_sequence([part[0] for part in parts], batch_first=True)


@dataclass(frozen=True, kw_only=True)
class Unpacked:
    """The physical meaning of a batch of free parameters: n photographs of f faces in all.

    ``balance`` is the log of each photograph's red and blue gain against green, ``pigments`` what
    each face has of either pigment along k modes, in log green; ``turns`` by how much each face's
    normals are wrong along j modes, in their standard deviations.
    """

    light: Float[Tensor, "b p"]
    exposure: Float[Tensor, "b n"]
    balance: Float[Tensor, "b n 2"]
    gloss: Float[Tensor, "b f"]
    albedo: Float[Tensor, "b f 3"]
    ground_albedo: Float[Tensor, "b 3"]
    pigments: Float[Tensor, "b f 2 k"]
    turns: Float[Tensor, "b f j"]


def charbonnier(x: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """``sqrt(x^2 + 1e-6)``: smooth, convex, close to ``|x|``."""
    return torch.sqrt(x * x + CHARBONNIER_EPSILON)


class SkyObjective:
    """Eq. 5.8 for a model of the sky over a Lambertian ground, summed over the faces it lights.

    Beyond the thesis, a share of surface reflection: shading is rho T l + gloss G l, with one
    unknown strength for each face (1 is what the index of refraction of skin says). On dark skin
    highlights are as bright as the diffuse part, and taken for diffuse they pull the sun aside.

    Beyond it too, every photograph has gains of its channels, diag(g) (rho T l + gloss G l) with
    sum_c log g_c = 0, which are what its camera's white balance is wrong by. Cameras take away
    part of what colours the light: without gains a low sun has to be warm, so skin turns blue.

    And the albedo of a face varies with its melanin and blood, as smooth fields that
    :mod:`skylight.faces.skin` has: rho of pixel p is a prod_i exp(-d_i sum_k Phi_pk u_ik), with
    u_ik normal. Of one albedo, redder cheeks and a darker jaw would be shading.

    And the head is not known: its normals may be turned along the modes that
    :mod:`skylight.faces.normal_errors` has, by normal amounts. Trusted, flat cheeks of a fitted
    head turn the sun, and more than one direction looks certain.

    ``albedo_prior`` is a density over *log* albedo: over albedo itself it would be the same
    distribution, but its maximum would lean towards dark skin.

    Free parameters of one problem: those of the light model, for each photograph a log exposure
    and its two log gains against green, for each face log gloss, the logits of skin albedo,
    its turns and its pigments, then the logits of ground albedo, so that 0 < albedo < 1 always
    holds. Targets are scaled beforehand to a mean luminance of 1 in each photograph, which makes
    the loss's epsilon mean the same for every picture.
    """

    def __init__(
        self,
        faces: Sequence[FaceTerm],
        model: LightModel,
        light_prior: Prior,
        albedo_prior: GaussianMixture,
        weights: ObjectiveWeights,
        sun_priors: Sequence[SunPrior | None] = (),
    ) -> None:
        self.faces = tuple(faces)
        self.sun_priors = tuple(sun_priors)
        self.photo_count = 1 + max(face.photo for face in faces)
        self.model = model
        self.light_prior = light_prior
        self.albedo_prior = albedo_prior
        self.tone_prior = tone_prior(albedo_prior)
        self.weights = weights
        counts = {face.modes.shape[-1] for face in faces if face.modes is not None}
        self.mode_count = max(counts, default=0) if weights.pigment_spread > 0 else 0
        turned = {face.normals.modes.shape[-1] for face in faces if face.normals is not None}
        self.turn_count = max(turned, default=0) if weights.normal_spread > 0 else 0
        device = self.faces[0].target.device
        self.ground = LambertianGround(model.grid.layout[0]).to(device)  # type: ignore[index]
        self.ground_prior = ground_prior().to(device)
        self.pigment_colours = torch.tensor(PIGMENT_COLOURS).to(self.faces[0].target)
        spreads = weights.pigment_spread * torch.tensor(PIGMENT_SPREADS)
        self.pigment_spreads = spreads.to(self.faces[0].target)[:, None]

    @property
    def size(self) -> int:
        return sum(self._sizes)

    @property
    def _sizes(self) -> tuple[int, int, int, int]:
        """Of the light, the photographs, the faces and the ground."""
        per_face = 4 + self.turn_count + 2 * self.mode_count
        faces, photos = per_face * len(self.faces), 3 * self.photo_count
        return self.model.parameter_count, photos, faces, 3

    def faces_of(self, photo: int) -> list[int]:
        """Which faces are of that photograph."""
        return [k for k, face in enumerate(self.faces) if face.photo == photo]

    def pack(
        self,
        light: Float[Tensor, "b p"],
        exposure: Float[Tensor, "b n"],
        gloss: Float[Tensor, "b f"],
        albedo: Float[Tensor, "b f 3"],
        ground_albedo: Float[Tensor, "b 3"],
        balance: Float[Tensor, "b n 2"] | None = None,
        pigments: Float[Tensor, "b f 2 k"] | None = None,
        turns: Float[Tensor, "b f j"] | None = None,
    ) -> Float[Tensor, "b q"]:
        """Free parameters of physical ones.

        By default without a cast, of even skin, and of the normals that were fitted.
        """
        if balance is None:
            balance = exposure.new_zeros(*exposure.shape, 2)
        if pigments is None:
            pigments = gloss.new_zeros(*gloss.shape, 2, self.mode_count)
        if turns is None:
            turns = gloss.new_zeros(*gloss.shape, self.turn_count)
        camera = torch.cat([exposure.log()[..., None], balance], 2)
        skin = torch.cat(
            [
                gloss.log()[..., None],
                torch.logit(albedo, eps=1e-4),
                turns / TURN_STEP,
                pigments.flatten(2),
            ],
            2,
        )
        return torch.cat(
            [
                self.model.to_free(light),
                camera.flatten(1),
                skin.flatten(1),
                torch.logit(ground_albedo, eps=1e-4),
            ],
            1,
        )

    def uneven(self, free: Float[Tensor, "b _"]) -> Float[Tensor, "b q"]:
        """Free parameters as they are, or of the same objective with even skin: without pigments.

        Both mean the same.
        """
        missing = (self.size - free.shape[1]) // len(self.faces)
        light, photos, faces, ground = self._sizes
        even = faces - missing * len(self.faces)
        parts = free.split((light, photos, even, ground), 1)
        skin = pad(parts[2].unflatten(1, (len(self.faces), -1)), (0, missing)).flatten(1)
        return torch.cat([*parts[:2], skin, parts[3]], 1)

    def unpack(self, free: Float[Tensor, "b q"]) -> Unpacked:
        light, camera, skin, ground_albedo = free.split(self._sizes, 1)
        camera = camera.unflatten(1, (-1, 3))
        skin = skin.unflatten(1, (len(self.faces), -1))
        return Unpacked(
            light=self.model.from_free(light),
            # beyond e^+-20 a line search has gone astray; exp must not overflow on its way back
            exposure=camera[..., 0].clamp(-20, 20).exp(),
            balance=camera[..., 1:],
            gloss=skin[..., 0].clamp(-20, 5).exp(),
            albedo=torch.sigmoid(skin[..., 1:4]),
            ground_albedo=torch.sigmoid(ground_albedo),
            turns=TURN_STEP * skin[..., 4 : 4 + self.turn_count],
            pigments=skin[..., 4 + self.turn_count :].unflatten(2, (2, self.mode_count)),
        )

    def white_balance(self, parts: Unpacked) -> Float[Tensor, "b n 3"]:
        """The gains of each photograph's channels; their product is 1."""
        if self.weights.white_balance_spread == 0:
            return torch.ones_like(parts.albedo[:, :1]).expand(-1, self.photo_count, -1)
        log_gains = pad(parts.balance.clamp(-5, 5), (0, 1))[..., [0, 2, 1]]  # green in the middle
        return (log_gains - log_gains.mean(2, keepdim=True)).exp()

    def albedo(
        self, parts: Unpacked, k: int, problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b m 3"]:
        """That of face ``k`` at each pixel."""
        even, modes = parts.albedo[:, k, None], self.faces[k].modes
        if modes is None or self.mode_count == 0:
            return even.expand(-1, self.faces[k].target.shape[1], -1)
        amounts = shade_scenes(modes, parts.pigments[:, k].transpose(1, 2), problem)
        return even * torch.exp(-(amounts.clamp(-5, 5) @ self.pigment_colours))

    def shading(
        self, parts: Unpacked, problem: Int[Tensor, " b"] | None = None
    ) -> list[Float[Tensor, "b _ 3"]]:
        """Each face's rho T l + gloss G l with its photograph's exposure and gains in l.

        Where its normals may be wrong, T l has what they add, and is 0 where that is less.
        """
        radiance = self.model(parts.light)
        exposure = parts.exposure[..., None] * self.white_balance(parts)
        skies = [radiance * e[:, None] for e in exposure.unbind(1)]
        grounds = [self.ground(sky, parts.ground_albedo) for sky in skies]
        shadings = []
        for k, face in enumerate(self.faces):
            sky, ground = skies[face.photo], grounds[face.photo]
            albedo = self.albedo(parts, k, problem)
            shading = face.transport(sky, ground, albedo, problem)
            if face.normals is not None and self.turn_count:
                turns = self.weights.normal_spread * parts.turns[:, k]
                added = face.normals(sky, ground, turns, problem)
                shading = (shading + albedo * added).clamp(min=0)
            if face.gloss is not None:
                gloss = parts.gloss[:, k, None].expand(-1, 3)
                shading = shading + face.gloss(sky, ground, gloss, problem)
            shadings.append(shading)
        return shadings

    def terms(
        self, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
    ) -> dict[str, Float[Tensor, " b"]]:
        """Each part of the objective, weighted and summed over faces; they add up to it."""
        parts = self.unpack(free)
        light = without_azimuth(self.model, free[:, : self.model.parameter_count])
        w = self.weights
        shadings = self.shading(parts, problem)
        data = [f.data_term(s, w, problem) for f, s in zip(self.faces, shadings, strict=True)]
        skin = self.albedo_prior.log_prob(parts.albedo.log().flatten(0, 1))
        sun = self.sun_nll(parts.light, problem)
        return {
            "data": torch.stack(data).sum(0),
            "light_prior": -w.light_prior * self.light_prior.log_prob(light),
            "albedo_prior": -w.albedo_prior * skin.unflatten(0, (-1, len(self.faces))).sum(1),
            "ground_prior": -w.ground_prior * self.ground_prior.log_prob(parts.ground_albedo.log()),
            "gloss_prior": (0.5 * (parts.gloss.log() / GLOSS_SPREAD) ** 2).sum(1),
            "white_balance_prior": self._white_balance_nll(parts),
            "pigment_prior": 0.5 * (parts.pigments / self.pigment_spreads).square().sum((1, 2, 3)),
            "normal_prior": 0.5 * parts.turns.square().sum((1, 2)),
            **({} if sun is None else {"sun_prior": sun}),
        }

    def sun_nll(
        self, light: Float[Tensor, "b p"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, " b"] | None:
        """How unlikely the sun's direction is by clock and place, in nats, weighted.

        None where they tell no problem of it, or the model has no sun.
        """
        sun = self.model.sun_direction(light)
        if sun is None or not any(self.sun_priors):
            return None
        nll = light.new_zeros(len(light))
        for number, prior in enumerate(self.sun_priors):
            if prior is not None:
                own = -self.weights.sun_prior * prior.log_density(sun)
                nll = own if problem is None else torch.where(problem == number, own, nll)
        return nll

    def _white_balance_nll(self, parts: Unpacked) -> Float[Tensor, " b"]:
        spread = self.weights.white_balance_spread or 1.0  # of gains that do not count
        return 0.5 * (parts.balance / spread).square().sum((1, 2))

    @torch.no_grad()
    def at_bayes_scale(self, free: Float[Tensor, "b q"]) -> Float[Tensor, "b q"]:
        """The same appearance with albedo and exposure at the scale of least expected error.

        Albedo and gloss times c under 1/c of a photograph's exposure look the same: only the
        priors know c, and between skins of different tone they have valleys that a descent does
        not cross. Every photograph's c is that of :func:`bayes_scale`.
        """
        parts = self.unpack(free)
        exposure, gloss, albedo = parts.exposure.clone(), parts.gloss.clone(), parts.albedo.clone()
        for photo in range(self.photo_count):
            mine = self.faces_of(photo)
            glossy = free.new_tensor([self.faces[k].gloss is not None for k in mine])
            scale = bayes_scale(
                scale_nll(albedo[:, mine], self.tone_prior, self.weights.albedo_prior)
                + gloss_nll(gloss[:, mine], glossy)
            )
            exposure[:, photo] /= scale
            gloss[:, mine] *= scale[:, None]
            albedo[:, mine] *= scale[:, None, None]
        return self.pack(
            parts.light,
            exposure,
            gloss,
            albedo,
            parts.ground_albedo,
            parts.balance,
            parts.pigments,
            parts.turns,
        )

    def __call__(
        self, free: Float[Tensor, "b q"], problem: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, " b"]:
        """Of points in ascending order of their problems; None where there is but one."""
        return torch.stack(list(self.terms(free, problem).values())).sum(0)


def data_term(
    residual: Float[Tensor, "*b m 3"], share: Float[Tensor, "*#b m 1"], weights: ObjectiveWeights
) -> Float[Tensor, "*b"]:
    """How unlikely a residual is, in nats: its mean Charbonnier over the expected deviation.

    ``share`` holds each pixel's weight over all pixels and channels; it sums to 1/3.
    """
    mean = (charbonnier(residual) * share).sum((-2, -1))
    return weights.independent / weights.noise * mean


def best_exposure(
    shading: Float[Tensor, "b m 3"], target: Float[Tensor, "1 m 3"], share: Float[Tensor, "1 m 1"]
) -> Float[Tensor, " b"]:
    """The exposure that makes the weighted mean of the shading that of the picture."""
    return ((target * share).sum() / (shading * share).sum((1, 2)).clamp(min=1e-12)).clamp(
        min=math.exp(-19), max=math.exp(19)
    )
