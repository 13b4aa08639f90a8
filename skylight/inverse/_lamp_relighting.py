"""Faces and map of an estimate under its lamps, when these are moved and switched.

The light in the map's units is ::

    l(w) = e A(w) + sum_k E_k / f(s_k) g(w; d_k, s_k),

with A the ambient light of the model that has the lamps (:class:`~skylight.models._lobes
.LampedLight`), e its level, and E_k the irradiance of a surface that faces lamp k; g and f are
``lobes`` and ``facing``. A face's transport is kept, so its picture under another light is a matrix
product.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.imaging._edits import Edit
from skylight.inverse._result import Estimate, FaceLight, Lamp
from skylight.inverse._scan import SCAN_HEIGHT
from skylight.models._lamps import LampsLight
from skylight.models._lobes import Lamps
from skylight.models._sphere import Places, SphereLight
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._observation import Observation


def lamps_radiance(lamps: Sequence[Lamp], rows: int) -> Float[Tensor, "n 3"]:
    """``sum_k E_k / f(s_k) g(w; d_k, s_k)`` on ``rows`` of the sphere, in float64."""
    model = LampsLight(len(lamps), rows)
    if not lamps:
        return torch.zeros(len(model.grid), 3, dtype=torch.float64)
    widths = torch.tensor([lamp.spread_rad for lamp in lamps], dtype=torch.float64)
    received = torch.stack([lamp.irradiance.double() for lamp in lamps])
    lobes = model.lobes(
        Lamps(
            directions=torch.stack([lamp.direction.double() for lamp in lamps]),
            energies=torch.ones_like(widths),
            widths_rad=widths,
            colours=torch.ones_like(received),
        )
    )
    return torch.einsum("kn,kc->nc", lobes, received / LampsLight.facing(widths)[:, None])


@dataclass(frozen=True, kw_only=True)
class LampLight:
    """Ambient light and ``level``, its mean luminance, with some ``lamps``.

    ``ambient`` is A by the rows that it was computed on. A level of 0 switches it off; a lamp that
    is left out is off.
    """

    ambient: Mapping[int, Float[Tensor, "_ 3"]]
    level: float
    lamps: tuple[Lamp, ...]

    @staticmethod
    def of(estimate: Estimate, places: Places | None = None) -> "LampLight":
        """That of an estimate with lamps, on the rows of faces and of its map.

        ``places`` are those of a model of the user's own.
        """
        sphere = estimate.light == SphereLight.name
        model = SphereLight(0, places=places) if sphere else LampsLight(0)
        params = estimate.params[: model.parameter_count].double()
        heights = (SCAN_HEIGHT, estimate.environment.layout[0])
        return LampLight(
            ambient={rows: model.on_rows(rows).ambient(params) for rows in heights},
            level=estimate.exposure,
            lamps=estimate.lamps,
        )

    def radiance(self, rows: int) -> Float[Tensor, "n 3"]:
        """l of the module's text on ``rows`` of the sphere, some of the ambient light's."""
        return (self.level * self.ambient[rows] + lamps_radiance(self.lamps, rows)).float()

    def environment(self, rows: int) -> EnvironmentMap:
        """The same as a map."""
        return EnvironmentMap(radiance=self.radiance(rows).reshape(rows, 2 * rows, 3))

    def ambient_irradiance(self) -> Float[Tensor, "3"]:
        """pi times the ambient light's mean radiance: what surfaces receive on average.

        Its luminance is ``pi * level``.
        """
        weights = DirectionGrid.latlong(SCAN_HEIGHT).solid_angles
        return (self.level * (weights @ self.ambient[SCAN_HEIGHT].double()) / 4).float()


@dataclass(frozen=True, kw_only=True)
class FaceTransport:
    """What a face shows of any light l on ``SCAN_HEIGHT`` rows of the sphere, in the map's units::

        edit(gains * (pixel_albedo * max(diffuse l, 0) + specular l))

    ``diffuse`` is T with the face's normals as they were estimated, ``specular`` G times the face's
    specular scale (None where it is diffuse). Of a ``grey`` picture it shows luminance.
    """

    diffuse: Float[Tensor, "m n"]
    specular: Float[Tensor, "m n"] | None
    pixel_albedo: Float[Tensor, "m 3"]
    gains: Float[Tensor, "3"]
    grey: bool
    edit: Edit

    @staticmethod
    def of(observation: Observation, light: FaceLight, exposure: float) -> "FaceTransport":
        """Of a face as its light explains it; ``exposure`` is the estimate's, in the map.

        Raises
        ------
        ValueError
            The observation has fewer rows of directions than the solver had.
        """
        observed = observation.on_rows(SCAN_HEIGHT)
        diffuse, modes = observed.transport.matrix, observed.normal_modes
        if light.turns is not None and modes is not None:
            turned = modes.modes @ light.turns.to(modes.modes)
            diffuse = diffuse + modes.visible * (turned @ modes.grid.directions.to(diffuse).T)
        return FaceTransport(
            diffuse=diffuse,
            specular=None
            if observed.specular is None
            else light.specular_scale * observed.specular.matrix,
            pixel_albedo=light.pixel_albedo,
            gains=light.white_balance * (light.exposure / exposure),
            grey=observed.grey,
            edit=light.edit,
        )

    def rendered(self, light: LampLight) -> Float[Tensor, "m 3"]:
        """The face's pixels under that light, in its photograph's radiance units."""
        radiance = light.radiance(SCAN_HEIGHT)
        shading = self.pixel_albedo * (self.diffuse @ radiance).clamp(min=0)
        if self.specular is not None:
            shading = shading + self.specular @ radiance
        shading = self.edit.apply(self.gains * shading)
        return luminance(shading)[:, None].expand(-1, 3) if self.grey else shading
