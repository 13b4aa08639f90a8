"""One face in the objective: pixels and transport on a level of the pyramid, and its data term."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from skylight.inverse.charbonnier import charbonnier
from skylight.inverse.objective.weights import ObjectiveWeights
from skylight.sphere.envmap import luminance
from skylight.transport.diffuse import SkyTransport
from skylight.transport.normal_modes import SkyNormalModes
from skylight.transport.observation import Observation


@dataclass(frozen=True, kw_only=True)
class Transported:
    """A face in lights, for an exposure, albedo and gloss of 1.

    ``diffuse`` T l, what wrong normals add to it (``turned``; None where they are known), and what
    its surface reflects (``glossy``; None where it is matt).
    """

    diffuse: Float[Tensor, "b m 3"]
    turned: Float[Tensor, "b m 3"] | None = None
    glossy: Float[Tensor, "b m 3"] | None = None

    @property
    def matt(self) -> Float[Tensor, "b m 3"]:
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
    def of(observation: Observation, *, sphere: bool = False) -> "FaceTerm":
        """The only face of a photograph whose mean luminance is 1, in one problem.

        For light of the whole ``sphere``, or of skies above grounds.
        """
        gloss, clipped = observation.gloss, observation.clipped
        normals = observation.normal_modes
        return FaceTerm(
            target=observation.pixels[None],
            share=(observation.weights / observation.weights.sum())[None, :, None] / 3,
            transport=SkyTransport.of(observation.transport, sphere=sphere),
            gloss=None if gloss is None else SkyTransport.of(gloss, sphere=sphere),
            level=observation.pixels.new_ones(1),
            clipped=None if clipped is None else clipped[None],
            grey=observation.grey,
            modes=None if observation.modes is None else observation.modes[None],
            normals=None if normals is None else SkyNormalModes.of(normals, sphere=sphere),
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

    def transported(
        self,
        sky: Float[Tensor, "b n 3"],
        ground: Float[Tensor, "b 3"],
        turns: Float[Tensor, "b k"] | None,
        problem: Int[Tensor, " b"] | None = None,
    ) -> Transported:
        """This face in lights; its normals turned by so much, None where they are trusted."""
        turned, glossy = None, None
        if self.normals is not None and turns is not None:
            turned = self.normals(sky, ground, turns, problem)
        if self.gloss is not None:
            glossy = self.gloss.white(sky, ground, problem)
        return Transported(
            diffuse=self.transport.white(sky, ground, problem), turned=turned, glossy=glossy
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
    return x if len(x) == 1 else x[problem]


def _padded(parts: Sequence[Shaped[Tensor, "1 _ *s"]]) -> Shaped[Tensor, "p m *s"]:
    """With zeros after the end of the shorter ones."""
    return pad_sequence([part[0] for part in parts], batch_first=True)


def data_term(
    residual: Float[Tensor, "*b m 3"], share: Float[Tensor, "*#b m 1"], weights: ObjectiveWeights
) -> Float[Tensor, "*b"]:
    """How unlikely a residual is, in nats: its mean Charbonnier over the expected deviation.

    ``share`` holds each pixel's weight over all pixels and channels; it sums to 1/3.
    """
    mean = (charbonnier(residual) * share).sum((-2, -1))
    return weights.independent / weights.noise * mean
