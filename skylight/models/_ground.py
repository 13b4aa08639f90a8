"""Light reflected by the ground: one Lambertian bounce of the sky, and a prior of its albedo.

The prior is that of grounds in general, or narrow about one that was measured
(:class:`KnownGround`). Light of the whole sphere has no ground, but a lower half that is likelier
where it is as bright as that ground would be (:class:`GroundBelow`).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import on_cpu
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.io._bounded import read_number, read_object, require_keys, write_json
from skylight.models._base import Light, is_sky, name_of
from skylight.models._prior import GaussianMixture
from skylight.sphere._frame import DirectionGrid, row_edges_cos

USUAL_SPREAD = 0.1
_KIND = "ground albedo"
_CHANNELS = ("red", "green", "blue")
# Mean linear albedos of nine grounds (thesis, Fig. B.4): light and dark concrete, asphalt, dry
# and wet dirt, grass, rocks, gravel, mulch.
GROUND_ALBEDOS = (
    (0.20, 0.17, 0.14),
    (0.14, 0.13, 0.12),
    (0.05, 0.04, 0.03),
    (0.09, 0.08, 0.06),
    (0.05, 0.04, 0.03),
    (0.09, 0.10, 0.03),
    (0.20, 0.18, 0.15),
    (0.17, 0.15, 0.13),
    (0.14, 0.10, 0.08),
)
# The nine lie close together; real grounds do not (snow, sand, paving): this much wider.
GROUND_SPREAD = 1.5


class LambertianGround(Module):
    """A horizontal plane of constant albedo under an unoccluded sky of ``height`` rows.

    Thesis, eq. 5.7: ``s = rho / pi sum_w l(w) <n, w>+ dw``. The weight of a pixel is the exact
    integral of the cosine over it, ``dphi (cos^2 t_0 - cos^2 t_1) / 2``, so the weights sum to pi
    to rounding and a constant sky of 1 gives exactly rho. The prior of log albedos is
    :func:`ground_prior`.
    """

    transfer: Tensor

    @on_cpu
    def __init__(self, height: int = 32) -> None:
        super().__init__()
        width = 4 * height
        row = -torch.diff(row_edges_cos(height, width) ** 2) * math.pi / width
        self.register_buffer("transfer", row.repeat_interleave(width), persistent=False)

    def forward(
        self, sky: Float[Tensor, "*batch n 3"], albedo: Float[Tensor, "*#batch 3"]
    ) -> Float[Tensor, "*batch 3"]:
        """``rho / pi sum_w l(w) <n, w>+ dw``: radiance ``(..., 3)`` of the ground.

        It is the same in all directions, and in the units of ``sky`` (..., n, 3), radiance in the
        order of :meth:`DirectionGrid.sky`. ``albedo`` rho is (..., 3), 0 to 1.
        """
        check_shape("LambertianGround's sky", sky.shape, len(self.transfer), 3)
        check_shape("LambertianGround's albedo", albedo.shape, 3)
        irradiance = torch.einsum("n,...nc->...c", self.transfer.to(sky.dtype), sky)
        return albedo / math.pi * irradiance

    def append(
        self, sky: Float[Tensor, "*batch n 3"], albedo: Float[Tensor, "*#batch 3"]
    ) -> Float[Tensor, "*batch m 3"]:
        """The full sphere, (h,4h) sky rows above (h,4h) ground rows: m = 2 n."""
        ground = self(sky, albedo)[..., None, :].expand_as(sky)
        return torch.cat([sky, ground], dim=-2)


@dataclass(frozen=True, kw_only=True)
class KnownGround:
    """Linear Rec.709 ``albedo`` of the ground, and the ``spread`` of its log.

    ``spread`` is the standard deviation in each channel: by how much, relatively, the ground
    round a face may differ from what was measured.
    """

    albedo: tuple[float, float, float]
    spread: float = USUAL_SPREAD

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) and 0 < value < 1 for value in self.albedo):
            given = ", ".join(f"{value:g}" for value in self.albedo)
            raise InputError(f"a ground's albedo is above 0 and below 1 in each colour: {given}")
        if not (math.isfinite(self.spread) and 0.01 <= self.spread <= 2):
            raise InputError(
                f"the spread of a ground's albedo is relative, 0.01 to 2, not {self.spread:g}"
            )

    def option(self) -> str:
        """As ``--ground-albedo`` takes it."""
        return ",".join(f"{value:.3g}" for value in (*self.albedo, self.spread))

    def save(self, path: Path, facts: dict[str, object]) -> None:
        """Write it as JSON, with ``facts`` of how it was measured."""
        albedo = dict(zip(_CHANNELS, self.albedo, strict=True))
        write_json(path, {"kind": _KIND, **albedo, "spread": self.spread, **facts})

    @staticmethod
    def parse(text: str) -> "KnownGround":
        """From "R,G,B" or "R,G,B,SPREAD", or the name of a file that :meth:`save` wrote.

        Raises
        ------
        InputError
            It is neither, or no albedo.
        """
        if text.lower().endswith(".json"):
            return load_ground(Path(text))
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 4):
            raise InputError(
                f"--ground-albedo {text!r}: give R,G,B or R,G,B,SPREAD, such as 0.2,0.17,0.14,0.1, "
                "or a file (.json) of `skylight probe ground`"
            )
        red, green, blue, *spread = numbers
        return KnownGround(albedo=(red, green, blue), spread=(spread or [USUAL_SPREAD])[0])


class GroundBelow(Module):
    """How likely light of the whole sphere is where the ground's albedo is ``known``.

    Below the horizon are ground, its shadows and what stands on it. With m the mean radiance there,
    E the irradiance of a horizontal surface from above and rho the albedo, ::

        r_c = log m_c - log(rho_c E_c / pi)

    of the three channels has Student's t density of 3 degrees of freedom and the scale matrix
    ``LEVEL^2 1 1^T + (COLOUR^2 + spread^2) I``. Of 90 simulated places outdoors on grounds of known
    albedo the likeliest have 0.14 and 0.026, and a median of r of 0.01: two thirds of the levels
    are within 0.16, but those under roofs and beside walls are off by up to a factor of twenty.
    """

    LEVEL, COLOUR, FREEDOM = 0.15, 0.03, 3.0
    HEIGHT = 8  # rows of the light: what is asked of it is as broad as half the sphere
    log_albedo: Tensor
    functionals: Tensor

    @on_cpu
    def __init__(self, known: KnownGround) -> None:
        super().__init__()
        self.own = self.COLOUR**2 + known.spread**2
        self.register_buffer("log_albedo", torch.tensor(known.albedo).log(), persistent=False)
        self.register_buffer("functionals", below_and_above(self.HEIGHT).float(), persistent=False)

    def log_prob(self, radiance: Float[Tensor, "*batch n 3"]) -> Float[Tensor, "*batch"]:
        """ln of the density, but for a constant, of light on :attr:`HEIGHT` rows of the sphere."""
        check_shape("GroundBelow's light", radiance.shape, self.functionals.shape[1], 3)
        both = (self.functionals.to(radiance.dtype) @ radiance).clamp(min=1e-12).log()
        off = both[..., 0, :] - both[..., 1, :] - self.log_albedo.to(radiance.dtype)
        common = self.LEVEL**2 * off.sum(-1).square() / (self.own + 3 * self.LEVEL**2)
        squares = (off.square().sum(-1) - common) / self.own  # r^T S^-1 r
        return -0.5 * (self.FREEDOM + 3) * torch.log1p(squares / self.FREEDOM)


def below_and_above(height: int) -> Float[Tensor, "2 n"]:
    """Functionals of light on so many rows of the sphere: the mean radiance of the lower half, and
    that of a white ground in the light of the upper half. Of a light of 1 both are 1."""
    share = DirectionGrid.latlong(height).solid_angles / (2 * math.pi)
    rows = torch.zeros(2, len(share), dtype=torch.float64)
    rows[0, len(share) // 2 :] = share[len(share) // 2 :]
    rows[1, : len(share) // 2] = LambertianGround(height // 2).transfer / math.pi
    return rows


def check_has_ground(light: Light, ground: KnownGround | None) -> None:
    """:class:`InputError` for a ground and a light that has no use for it."""
    if ground is not None and not is_sky(light) and light != "sphere":
        raise InputError(
            f"--ground-albedo is for skies over a ground, and {name_of(light)} has none: leave it "
            "out, or choose --light sphere, autoencoder or sunsky"
        )


def load_ground(path: Path) -> KnownGround:
    """The ground that :meth:`KnownGround.save` wrote."""
    content = read_object(path, _KIND)
    require_keys(path, content, [*_CHANNELS, "spread"])
    try:
        red, green, blue, spread = (read_number(content, name) for name in (*_CHANNELS, "spread"))
        return KnownGround(albedo=(red, green, blue), spread=spread)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def ground_prior(known: KnownGround | None = None) -> GaussianMixture:
    """Density of log albedos (RGB): one Gaussian, from the moments of the nine grounds.

    Of a ground that is known, N(log albedo, spread^2) in each channel.

    One component, because nine grounds carry no more: with two, the Bayesian information
    criterion is higher. Its covariance is :data:`GROUND_SPREAD` squared times theirs, plus 0.01
    where they leave no room.
    """
    if known is not None:
        mean = torch.tensor(known.albedo).log()
        return GaussianMixture(torch.ones(1), mean[None], torch.eye(3)[None] / known.spread)
    log_albedo = torch.tensor(GROUND_ALBEDOS).log()
    covariance = torch.cov(log_albedo.T) * GROUND_SPREAD**2 + 0.01 * torch.eye(3)
    # precision = B B^T with an upper triangular B
    factor = torch.linalg.inv(torch.linalg.cholesky(covariance)).mT.contiguous()
    return GaussianMixture(torch.ones(1), log_albedo.mean(0)[None], factor.triu()[None])
