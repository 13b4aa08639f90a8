"""The light in which any object of known shape was photographed (thesis, 6.5)."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import nnls
from torch import Tensor

from skylight._modes import without_autocast
from skylight._names import OBJECT_LIGHTS, ObjectLightName
from skylight.csc._code import CodeTensors, SparseCode
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank, builtin
from skylight.csc._greedy import Pursuit, PursuitOptions, Support, pursue
from skylight.csc._least_squares import LinearObservation
from skylight.csc._sub_dictionaries import rotated_atoms
from skylight.errors import InputError
from skylight.inverse._harmonic import nonnegative_harmonics
from skylight.inverse._problem import require_observations
from skylight.inverse._result import Lamp
from skylight.object._lamps import lamps_of_objects, thinned
from skylight.object._view import GRID_HEIGHT, ObjectMaterial, shading
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from skylight.work._device import choose_device
from skylight.work._progress import Progress

MAP_HEIGHT = 64
LEAST_GAIN = 0.01  # of the squared error, by PATIENCE activations together
PATIENCE = 3
POOR_FIT = 0.25
RIDGES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
RIDGE_COST = 0.1


@dataclass(frozen=True, kw_only=True)
class ObjectLight:
    """The light of a known object's picture, in the mesh's world and the picture's units.

    ``environment``
        64 x 128, clamped at zero; ``clamped_share`` is the share removed by that:
        ``int max(0, -L) / int |L|``, over all colours.
    ``coefficients``
        (k,3), before clamping: of :func:`skylight.sphere._harmonics.evaluate`, or, where ``code``
        is given, of :func:`skylight.sphere._harmonics.evaluate_about_zenith`. None of lamps.
    ``rendered``
        (m,3), the observation's pixels under ``environment``; ``residual`` is their difference
        from those seen, root of weighted mean squares, relative to the pixels'. ``linear_residual``
        is the same before clamping.
    ``code``
        The activations; its ``relative_error`` is ``linear_residual``.
    ``lamps``
        Those of "lamps", the strongest first; ``log_evidence`` (nats) is how likely the picture is
        under so many.
    """

    light: str
    environment: EnvironmentMap
    coefficients: Float[Tensor, "k 3"] | None
    rendered: Float[Tensor, "m 3"]
    residual: float
    linear_residual: float
    clamped_share: float
    advice: tuple[str, ...]
    dictionary: FilterBank | None = None
    code: SparseCode | None = None
    lamps: tuple[Lamp, ...] = ()
    log_evidence: float | None = None


@without_autocast
def estimate_object_light(
    observations: Observation | Sequence[Observation],
    light: ObjectLightName | FilterBank,
    *,
    material: ObjectMaterial | None = None,
    activations: int = 50,
    device: str = "auto",
    progress: Progress | None = None,
) -> ObjectLight:
    """Minimise ``sum_p w_p |s_p - (T l)_p|^2`` (thesis, Eq. 6.18) over lights of one kind.

    Spherical harmonics are those whose light is nowhere negative
    (:func:`~skylight.inverse._harmonic.nonnegative_harmonics`), with the largest ridge
    (1e-2 .. 1e-6) that raises the squared error by a tenth at most: a diffuse object hardly shows
    some of them. Sparse codes grow by one activation at a time, up to ``activations``, and end
    where three together lower the squared error by less than 1 %; the shortest code within 1 % of
    the least error is taken.
    All colours share their activations; each colour's weights are then fitted to its own albedo,
    none below 0.
    Lamps, none to three in smooth ambient light, minimise the robust error with a prior instead:
    see :mod:`skylight.object._lamps`.

    Parameters
    ----------
    observations
        Pixels of the object; several are of the same material and exposure: other views, other
        objects of a picture.
    light
        Spherical harmonics, a dictionary of the thesis, a dictionary of one's own, or lamps.
    material
        That with which the object was observed.
    device
        "cpu", "cuda", or "auto" for CUDA where it is. Transport is moved there once. The light is
        on the CPU.

    Returns
    -------
    ObjectLight
        With the pixels ``rendered`` of all observations, in their order.

    Raises
    ------
    InputError
        No observation, an unknown light, no activation, or no sparse code that explains the
        pictures.
    ValueError
        Material and observation disagree about specular reflection.
    """
    if activations < 1:
        raise InputError(f"a sparse code has 1 or more activations, got {activations}")
    if isinstance(light, str) and light not in OBJECT_LIGHTS:
        raise InputError(f"unknown light {light!r}: choose one of {', '.join(OBJECT_LIGHTS)}")
    material, where = material or ObjectMaterial(), choose_device(device)
    given = [observations] if isinstance(observations, Observation) else observations
    require_observations(bool(given))
    if any((material.specular is None) != (one.specular is None) for one in given):
        raise ValueError("material and observation disagree about specular reflection")
    parts = [one.to(where) for one in given]
    observation = _together(parts)
    if light == "lamps":
        coarse = _together([thinned(one) for one in parts])
        found = lamps_of_objects(observation, coarse, material, progress)
        return _explained(
            observation,
            material,
            found.environment,
            light="lamps",
            coefficients=None,
            clamped_share=0.0,
            lamps=found.lamps,
            log_evidence=found.log_evidence,
        )
    bank, code = None, None
    if isinstance(light, FilterBank) or light == "ani" or light == "iso" or light == "vmf":
        bank = light if isinstance(light, FilterBank) else builtin(light)
        name, fine = bank.name, _basis(bank.degree, harmonics.evaluate_about_zenith)
        linear = _Shading.of(observation, material, fine)
        code, coefficients = _sparse_code(linear, bank, activations, progress)
    else:
        name, fine = light, _basis(math.isqrt(int(light[2:])) - 1, harmonics.evaluate)
        linear = _Shading.of(observation, material, fine)
        coefficients = _harmonic_coefficients(linear)
    radiance = fine @ coefficients.cpu()
    environment = EnvironmentMap(
        radiance=radiance.clamp(min=0).float().reshape(MAP_HEIGHT, 2 * MAP_HEIGHT, 3)
    )
    share = DirectionGrid.latlong(MAP_HEIGHT).solid_angles[:, None]
    clamped = float((share * (-radiance).clamp(min=0)).sum() / (share * radiance.abs()).sum())
    return _explained(
        observation,
        material,
        environment,
        linear.apply(coefficients),
        light=name,
        coefficients=coefficients.cpu(),
        clamped_share=clamped,
        dictionary=bank,
        code=code,
    )


def _explained(
    observation: Observation,
    material: ObjectMaterial,
    environment: EnvironmentMap,
    unclamped: Float[Tensor, "m 3"] | None = None,
    **found: Any,
) -> ObjectLight:
    """The answer, with what the pixels are in the light found; ``unclamped`` are those before."""
    coarse = environment.resize(GRID_HEIGHT).flat.to(observation.pixels)
    rendered = shading(observation.transport, observation.specular, coarse, material)
    residual = _relative_error(observation, rendered)
    return ObjectLight(
        environment=environment,
        rendered=rendered.cpu(),
        residual=residual,
        linear_residual=residual if unclamped is None else _relative_error(observation, unclamped),
        advice=_advice(residual),
        **found,
    )


def _together(observations: list[Observation]) -> Observation:
    """All pixels as those of one observation."""
    first, *more = observations
    if not more:
        return first

    def rows(matrices: list[TransportMatrix]) -> TransportMatrix:
        return replace(matrices[0], matrix=torch.cat([one.matrix for one in matrices]))

    specular = [one.specular for one in observations if one.specular is not None]
    return Observation(
        pixels=torch.cat([one.pixels for one in observations]),
        weights=torch.cat([one.weights for one in observations]),
        places=torch.cat([one.places for one in observations]),
        transport=rows([one.transport for one in observations]),
        specular=rows(specular) if specular else None,
    )


@dataclass(frozen=True, kw_only=True)
class _Shading:
    """Pixels as a linear map of coefficients: ``albedo_c diffuse + share specular``, (m,k) each."""

    observation: Observation
    material: ObjectMaterial
    diffuse: Float[Tensor, "m k"]
    specular: Float[Tensor, "m k"] | None

    @staticmethod
    def of(
        observation: Observation, material: ObjectMaterial, fine: Float[Tensor, "n k"]
    ) -> "_Shading":
        """``fine`` is the basis on the pixels of the map; its means over cells meet transport."""
        coarse = _cell_means(fine)
        specular = observation.specular
        return _Shading(
            observation=observation,
            material=material,
            diffuse=observation.transport.project(coarse).double(),
            specular=None if specular is None else specular.project(coarse).double(),
        )

    def operator(self, colour: int) -> Float[Tensor, "m k"]:
        return self.mixed(self.material.albedo[colour])

    def mixed(self, albedo: float) -> Float[Tensor, "m k"]:
        """``albedo diffuse + share specular``."""
        diffuse = albedo * self.diffuse
        return diffuse if self.specular is None else diffuse + self.material.share * self.specular

    def apply(self, coefficients: Float[Tensor, "k 3"]) -> Float[Tensor, "m 3"]:
        return torch.stack([self.operator(c) @ coefficients[:, c] for c in range(3)], dim=1)


def _harmonic_coefficients(linear: _Shading) -> Float[Tensor, "k 3"]:
    """Non-negative light; the ridge by the discrepancy principle (Morozov 1966)."""
    root = linear.observation.weights.double().sqrt()[:, None]
    pixels = root * linear.observation.pixels.double()
    points, count = linear.diffuse.shape

    def solved(ridge: float) -> tuple[Float[Tensor, "k 3"], float]:
        noise = math.sqrt(ridge * points / count)  # a ridge of that share of the mean |A_k|^2
        coefficients = torch.cat(
            [
                nonnegative_harmonics(
                    root * linear.operator(c), pixels[:, c : c + 1], noise=noise
                ).coefficients
                for c in range(3)
            ],
            dim=1,
        )
        return coefficients, _relative_error(linear.observation, linear.apply(coefficients))

    solutions = [solved(ridge) for ridge in RIDGES]
    enough = math.sqrt(1 + RIDGE_COST) * solutions[-1][1]
    return next(coefficients for coefficients, error in solutions if error <= enough)


def _sparse_code(
    linear: _Shading,
    bank: FilterBank,
    activations: int,
    progress: Progress | None,
) -> tuple[SparseCode, Float[Tensor, "k 3"]]:
    """The code, and the coefficients of its light.

    The activations are sought for an albedo that is grey (the mean), with pixels divided by the
    albedo's colour: exact but for specular reflection on a coloured object. The weights are then
    those of non-negative least squares with each colour's own albedo.
    """
    device = linear.diffuse.device
    # a copy: to() moves a module in place
    coder = SphericalSparseCoder(copy.deepcopy(bank), height=MAP_HEIGHT, banded=True).to(device)
    albedo = linear.diffuse.new_tensor(linear.material.albedo)
    tint = albedo / albedo.mean() if float(albedo.min()) > 0 else torch.ones_like(albedo)
    pixels, weights = linear.observation.pixels.double(), linear.observation.weights.double()
    objective = LinearObservation.of(linear.mixed(float(albedo.mean())), pixels / tint, weights)
    pursuit = Pursuit(coder.parts, objective, PursuitOptions(weights="nonnegative"))
    found: list[Support] = []
    for code in pursue(pursuit, list(range(1, activations + 1))):
        found.append(code)
        if progress is not None:
            progress(len(found) / activations)
        before = min((c.error for c in found[:-PATIENCE]), default=math.inf)
        if min(c.error for c in found) > (1 - LEAST_GAIN) * before:
            break
    enough = min(c.error for c in found) / (1 - LEAST_GAIN)
    code = next(c for c in found if c.error <= enough).tensors(coder.parts).to(device)
    if not int(code.count):
        raise InputError(
            "no light explains the picture: the object's pixels are black, or none sees any light"
        )
    atoms = rotated_atoms(coder.parts, code).detach()
    root = weights.sqrt()[:, None]
    values = np.zeros((len(atoms), 3))
    for c in range(3):
        columns = root * (linear.operator(c) @ atoms.T)
        seen = root[:, 0] * pixels[:, c]
        values[:, c], _ = nnls(columns.cpu().numpy(), seen.cpu().numpy())
    fitted = torch.from_numpy(values).to(device)
    used = fitted.any(1)
    weights = fitted[used]
    coefficients = atoms[used].T @ weights
    code = CodeTensors(code.filters[used], code.rotations[used], weights, used.sum())
    error = _relative_error(linear.observation, linear.apply(coefficients))
    return coder.sparse_code(code, error), coefficients


def _basis(degree: int, evaluate: Callable[[Tensor, int], Tensor]) -> Float[Tensor, "n k"]:
    """The harmonics on the pixels of the map."""
    return evaluate(DirectionGrid.latlong(MAP_HEIGHT).directions, degree)


def _cell_means(fine: Float[Tensor, "n k"]) -> Float[Tensor, "n2 k"]:
    """Means of functions on the map over the cells of the transport's grid, as maps are resized."""
    factor = MAP_HEIGHT // GRID_HEIGHT
    weight = DirectionGrid.latlong(MAP_HEIGHT).solid_angles[:, None]
    cells = (GRID_HEIGHT, factor, 2 * GRID_HEIGHT, factor, -1)
    total = (weight * fine).reshape(cells).sum((1, 3))
    return (total / weight.reshape(cells).sum((1, 3))).flatten(0, 1)


def _relative_error(observation: Observation, rendered: Float[Tensor, "m 3"]) -> float:
    """``sqrt(sum w |rendered - seen|^2 / sum w |seen|^2)``."""
    weights = observation.weights.double()[:, None]
    seen = observation.pixels.double()
    error = (weights * (rendered.double() - seen).square()).sum()
    return float((error / (weights * seen.square()).sum()).sqrt())


def _advice(residual: float) -> tuple[str, ...]:
    if residual > POOR_FIT:
        return (
            f"the re-rendered object is off by {100 * residual:.0f} %: the light is unreliable; "
            "check that mesh and camera fit the picture, and leave out painted parts with a mask",
        )
    return ()
