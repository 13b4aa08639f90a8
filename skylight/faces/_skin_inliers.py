"""Which pixels of a face are skin, by whether light on one skin explains them.

Beards, glasses, hands and strands of hair are separated from shadows by a fit: with visibility in
the transport, some non-negative light explains every shade of one skin, attached and cast shadows
included, but not what has another albedo or is not where the head's surface is. The residuals are
a mixture (Jepson & Black 1993), narrow for skin and broad for all else, whose labels agree with
their neighbours' (a Potts model, solved by mean field).
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from skylight.sphere._envmap import luminance
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation

# Radiance is constant in cells of 11 degrees.
LIGHT_ROWS = 16
# Added to values before logarithms, as part of the face's bright skin: noise, interreflection.
FLOOR_SHARE = 0.03
# Skin's residuals: (luminance, red : green, blue : green) in logarithms. The least are those of
# blotches and of normals that are a few degrees off, the most keep a beard from being a spread.
LEAST_SPREAD, MOST_SPREAD = (0.1, 0.05, 0.07), (0.2, 0.09, 0.13)
# All else may be anywhere in ranges of this width.
OUTLIER_RANGE = (4.0, 1.5, 2.0)
FEWEST_OUTLIERS, MOST_OUTLIERS = 0.02, 0.5
NEIGHBOURS = 0.3  # nats by which each of eight neighbours of the same label makes it likelier
ITERATIONS, LIGHT_UPDATES, MEAN_FIELD_STEPS = 6, 40, 10
# Specular scale against shading, 1 / albedo where skin shines as modelled: of light and of dark,
# oily skin.
LEAST_SPECULAR, MOST_SPECULAR = 1.5, 15.0
# By how much the ln of a ratio of channels may change: as shading grows by a factor of e (a low
# sun ten times as bright as blue sky is 2.5 times as red), between diffuse reflection and a
# highlight, and over a face that turns by a radian.
MOST_TINT = (0.4, 1.0, 0.5, 0.5, 0.5)
RIDGE = 1e-3


def inlier_probability(seen: Observation) -> Float[Tensor, " m"]:
    """The probability that each pixel of an observation is skin.

    Alternates between the light and the specular scale g of ::

        argmin sum_i w_i (y_i - (D l + g G l)_i)^2 / (D l + g G l)_i^2,  l >= 0,

    luminances y, transport D and that of specular reflection G; the colours that skin has in that
    light; and the posterior w of the mixture. Over-exposed pixels have no residual: their
    neighbours decide.
    """
    diffuse = _coarse(seen.transport.matrix)
    specular = torch.zeros_like(diffuse) if seen.specular is None else _coarse(seen.specular.matrix)
    exact = torch.ones(len(diffuse), dtype=torch.bool) if seen.clipped is None else ~seen.clipped
    pixels = seen.pixels.double()
    brightness = luminance(pixels)
    single = brightness.float()
    floor = FLOOR_SHARE * float(brightness[exact].quantile(0.9))
    bright, logs = (brightness + floor).log(), (pixels + floor).log()
    ratios = logs[:, [0, 2]] - logs[:, 1:2]
    towards = _seen_from(seen.transport)
    grid = _PixelGrid.of(seen.places)
    skin = seen.weights.double() * exact
    light = torch.ones(diffuse.shape[1])
    light *= single[exact].mean() / (diffuse @ light)[exact].mean()
    inlier, share, specular_scale = exact.double(), 0.2, 2 * LEAST_SPECULAR
    for _ in range(ITERATIONS):
        weights = inlier * skin
        light, specular_scale = _light(
            diffuse, specular, single, weights.float(), (light, specular_scale), floor
        )
        diffuse_shading = (diffuse @ light).double()
        shine = specular_scale * (specular @ light).double()
        shading = (diffuse_shading + shine + floor).log()
        causes = torch.stack(
            [shading, shine / (diffuse_shading + shine + floor), *towards.unbind(1)], 1
        )
        tint = _tint(ratios, causes, weights)
        residual = torch.cat([(bright - shading)[:, None], ratios - tint], 1)
        evidence, share = _evidence(residual, inlier * exact, exact, share)
        inlier = grid.mean_field(evidence)
    return inlier.to(seen.weights)


def _coarse(matrix: Float[Tensor, "m n"]) -> Float[Tensor, "m k"]:
    """The transport of light that is constant in coarse cells, but for a factor for each."""
    rows = math.isqrt(matrix.shape[1] // 2)  # lat-long maps are twice as wide as high
    if rows > LIGHT_ROWS:
        maps = matrix.reshape(len(matrix), 1, rows, 2 * rows)
        matrix = adaptive_avg_pool2d(maps, (LIGHT_ROWS, 2 * LIGHT_ROWS)).flatten(1)
    return matrix


def _light(
    diffuse: Float[Tensor, "m k"],
    specular: Float[Tensor, "m k"],
    brightness: Float[Tensor, " m"],
    weights: Float[Tensor, " m"],
    start: tuple[Float[Tensor, " k"], float],
    floor: float,
) -> tuple[Float[Tensor, " k"], float]:
    """(non-negative light, specular scale) of least squared relative errors.

    By multiplicative updates (Lee & Seung 2001), the two by turns; in single precision: nothing is
    subtracted in them. Those of the light take a matrix of the normal equations, which a core's
    cache holds, not one with a row for each pixel.
    """
    light, specular_scale = start
    basis = torch.add(diffuse, specular, alpha=specular_scale)
    relative = weights / (basis @ light + floor) ** 2
    aim = basis.T @ (relative * brightness)
    normal = basis.T @ (relative[:, None] * basis)
    for _ in range(LIGHT_UPDATES):
        light = light * aim / (normal @ light).clamp(min=1e-30)
    shine = relative * (specular @ light)
    grown = float(shine @ brightness / (shine @ (basis @ light)).clamp(min=1e-30))
    return light, min(max(specular_scale * grown**2, LEAST_SPECULAR), MOST_SPECULAR)


def _seen_from(transport: TransportMatrix) -> Float[Tensor, "m 3"]:
    """Where each pixel's light can come from, in the mean: its normal if nothing is in the way."""
    moment = transport.matrix @ transport.grid.directions.float()
    # 2/3: the mean of a hemisphere, weighted by the cosine
    return (1.5 * moment / transport.matrix.sum(1, keepdim=True).clamp(min=1e-6)).double()


def _tint(
    ratios: Float[Tensor, "m 2"], causes: Float[Tensor, "m c"], weights: Float[Tensor, " m"]
) -> Float[Tensor, "m 2"]:
    """ln of red and of blue over green, linear in what changes them, by least squares in bounds.

    Sun, sky and walls have different colours, so that ratios change with the shading and with where
    skin faces; specular reflection has the light's own.
    """
    total = weights.sum().clamp(min=1e-12)
    mean, middle = weights @ ratios / total, weights @ causes / total
    apart = causes - middle
    moment = apart.T @ (weights[:, None] * apart) / total
    moment = moment + RIDGE * torch.eye(len(moment)).to(moment)
    slope = torch.linalg.solve(moment, apart.T @ (weights[:, None] * (ratios - mean)) / total)
    most = slope.new_tensor(MOST_TINT)[:, None]
    return mean + apart @ slope.clamp(-most, most)


def _evidence(
    residual: Float[Tensor, "m 3"],
    inlier: Float[Tensor, " m"],
    exact: Bool[Tensor, " m"],
    share: float,
) -> tuple[Float[Tensor, " m"], float]:
    """(ln p(residual, skin) - ln p(residual, else), the share of all else)."""
    least, most = residual.new_tensor(LEAST_SPREAD), residual.new_tensor(MOST_SPREAD)
    typical = residual[inlier > 0.5] if bool((inlier > 0.5).any()) else residual[exact]
    spread = (1.4826 * typical.abs().median(0).values).clamp(least, most)
    distance = (residual / spread).square().sum(1)
    skin = -0.5 * distance - (spread * math.sqrt(2 * math.pi)).log().sum()
    other = -residual.new_tensor(OUTLIER_RANGE).log().sum()
    prior = math.log((1 - share) / share)
    evidence = torch.where(exact, skin - other + prior, prior)
    found = 1 - float(torch.sigmoid(evidence)[exact].mean())
    return evidence, min(max(found, FEWEST_OUTLIERS), MOST_OUTLIERS)


@dataclass(frozen=True, kw_only=True)
class _PixelGrid:
    """Places (m,2) on a picture's grid: ``grid`` holds each pixel's number, m where none is."""

    places: Int[Tensor, "m 2"]
    grid: Int[Tensor, "h w"]

    @staticmethod
    def of(places: Int[Tensor, "m 2"]) -> "_PixelGrid":
        """Of pixels at rows and columns."""
        places = places - places.min(0).values + 1
        height, width = (places.max(0).values + 2).tolist()
        grid = torch.full((height, width), len(places))
        grid[places[:, 0], places[:, 1]] = torch.arange(len(places))
        return _PixelGrid(places=places, grid=grid)

    def mean_field(self, evidence: Float[Tensor, " m"]) -> Float[Tensor, " m"]:
        """Probabilities of a Potts model with this evidence, by mean field."""
        row, column = self.places.unbind(1)
        around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
        beside = torch.stack([self.grid[row + i, column + j] for i, j in around])
        inlier = torch.sigmoid(evidence)
        for _ in range(MEAN_FIELD_STEPS):
            votes = torch.cat([2 * inlier - 1, inlier.new_zeros(1)])[beside].sum(0)
            inlier = torch.sigmoid(evidence + NEIGHBOURS * votes)
        return inlier
