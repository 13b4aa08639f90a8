"""Shading as torch modules: linear in light, differentiable in light, reflectance and normals.

Diffuse reflection, and specular reflection of skin by a transport matrix with a microfacet BRDF.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import normalize

from skylight._modes import Derived
from skylight._module import Module
from skylight.errors import check_shape
from skylight.sphere._frame import DirectionGrid, cosines
from skylight.transport._matrix import TransportMatrix
from skylight.transport._render import Specular, ggx


class DiffuseTransport(Module):
    """Shading of m Lambertian points under distant light from n directions.

    ``s_p = rho_p / pi sum_w V(p, w) <n_p, w>+ L(w) dw`` (thesis, Eq. 5.2 and 5.3), differentiable
    in the radiance L, the albedo rho and the normals. The visibility V is constant: gradients
    with respect to normals are those of the cosine, without the motion of shadow boundaries.

    ``normals`` is a parameter, frozen unless the tensor given requires a gradient. The matrix of
    m n numbers is computed once and again whenever the normals have changed; while they require
    a gradient, it is computed in every forward pass. Normals that another network predicts are
    passed with :func:`torch.func.functional_call`.

    Parameters
    ----------
    visibility
        Which directions are unoccluded, see :func:`skylight.transport._matrix.visibility`; a
        buffer of m n bytes.
    normals
        Of any length: they are normalised. Their precision is that of the result.
    grid
        The directions w and their solid angles dw.

    Raises
    ------
    ValueError
        The shapes do not match.
    """

    visible: Tensor
    directions: Tensor
    solid_angles: Tensor

    def __init__(
        self,
        visibility: Bool[Tensor, "m n"],
        normals: Float[Tensor, "m 3"],
        grid: DirectionGrid,
    ) -> None:
        super().__init__()
        if visibility.shape != (len(normals), len(grid)) or normals.shape != (len(normals), 3):
            raise ValueError(
                f"visibility {tuple(visibility.shape)} must be (m, n) and normals "
                f"{tuple(normals.shape)} (m, 3), of m points and the grid's {len(grid)} directions"
            )
        self.grid = grid
        if not isinstance(normals, nn.Parameter):
            normals = nn.Parameter(normals.detach().clone(), normals.requires_grad)
        self.normals = normals
        self.register_buffer("visible", visibility)
        self.register_buffer("directions", grid.directions, persistent=False)
        self.register_buffer("solid_angles", grid.solid_angles, persistent=False)
        self._matrix: Derived[Tensor] = Derived()

    @property
    def matrix(self) -> Float[Tensor, "m n"]:
        """Radiance to shading at a reflectance of 1, part of the graph where normals are."""
        return self._matrix.of([*self.parameters(), *self.buffers()], self._compute)

    def _compute(self) -> Float[Tensor, "m n"]:
        normals = functional.normalize(self.normals, dim=1)
        cosine = cosines(normals, self.directions.to(normals.dtype)).clamp(min=0)
        return cosine * self.visible * (self.solid_angles / math.pi).to(normals.dtype)

    def transport_matrix(self) -> TransportMatrix:
        """A constant copy for the solvers of :mod:`skylight.inverse`."""
        return TransportMatrix(matrix=self.matrix.detach().float(), grid=self.grid)

    def freeze(self) -> "FrozenTransport":
        """The same with the normals as they are now.

        A graph of ``torch.compile`` or ``torch.export`` then holds the matrix, which it otherwise
        computes in every call.
        """
        return FrozenTransport(self.matrix.detach().clone(), self.grid)

    def forward(
        self, radiance: Float[Tensor, "*batch n 3"], albedo: float | Float[Tensor, "..."] = 1.0
    ) -> Float[Tensor, "*batch m 3"]:
        """``rho (T l)``: shading ``(..., m, 3)`` of m points by radiance ``(..., n, 3)``.

        In the units of the radiance, which is in the order of ``grid.directions``.

        ``albedo`` is a number, (3,) for one colour, (m, 3) for each point's own, or has the
        lights' leading dimensions too, (..., 1, 3) or (..., m, 3).

        Raises
        ------
        ValueError
            An albedo of another shape, such as (m,).
        """
        check_shape(f"{type(self).__name__}'s radiance", radiance.shape, len(self.grid), 3)
        return _reflected(self.matrix, radiance, albedo)


class FrozenTransport(Module):
    """:class:`DiffuseTransport` or :class:`SpecularTransport` of constant normals.

    ``matrix`` (m,n), radiance to shading at a reflectance of 1, is a buffer.
    """

    matrix: Tensor

    def __init__(self, matrix: Float[Tensor, "m n"], grid: DirectionGrid) -> None:
        super().__init__()
        self.grid = grid
        self.register_buffer("matrix", matrix)

    def forward(
        self, radiance: Float[Tensor, "*batch n 3"], albedo: float | Float[Tensor, "..."] = 1.0
    ) -> Float[Tensor, "*batch m 3"]:
        """As :meth:`DiffuseTransport.forward`."""
        check_shape(f"{type(self).__name__}'s radiance", radiance.shape, len(self.grid), 3)
        return _reflected(self.matrix, radiance, albedo)


def _reflected(
    matrix: Float[Tensor, "m n"],
    radiance: Float[Tensor, "*batch n 3"],
    albedo: float | Float[Tensor, "..."],
) -> Float[Tensor, "*batch m 3"]:
    """``albedo * (matrix @ radiance)``, the albedo's shape checked."""
    shading = shade(matrix.to(radiance.dtype), radiance)
    if isinstance(albedo, Tensor) and not _broadcasts(albedo.shape, shading.shape):
        raise ValueError(
            f"an albedo of shape {tuple(albedo.shape)} does not fit shading of shape "
            f"{tuple(shading.shape)}: give a number, (3,), (points, 3) or (..., points, 3)"
        )
    return albedo * shading


class SkyTransport(Module):
    """Shading from skies above grounds of uniform radiance; differentiable in both and in albedo.

    Half as many columns as the full sphere: all directions below the horizon are one, the last.
    ``folded`` (p,m,n) are the matrices of p scenes; where one has fewer points, its last rows are
    zeros. For light that is no sky but the whole ``sphere``'s, that column is left out, and there
    is no ground.
    """

    folded: Tensor

    def __init__(self, folded: Float[Tensor, "p m n"], *, sphere: bool = False) -> None:
        super().__init__()
        self.sphere = sphere
        self.register_buffer("folded", folded)

    @staticmethod
    def of(transport: TransportMatrix, *, sphere: bool = False) -> "SkyTransport":
        """That of one scene; for light of the whole ``sphere``, or of skies above grounds."""
        folded = transport.matrix if sphere else transport.fold_ground()
        return SkyTransport(folded[None], sphere=sphere)

    def forward(
        self,
        sky: Float[Tensor, "b n 3"],
        ground: Float[Tensor, "b 3"],
        albedo: Float[Tensor, "b 3"] | Float[Tensor, "b m 3"],
        scene: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b m 3"]:
        """rho (T l) (Eq. 5.2) for a batch of lights, with one albedo per light or per point.

        ``scene`` is the one that each light falls on, in ascending order; None where there is
        but one.
        """
        check_shape("SkyTransport's albedo", albedo.shape, 3)
        per_point = albedo if albedo.dim() == 3 else albedo[:, None]
        return per_point * self.white(sky, ground, scene)

    def white(
        self,
        sky: Float[Tensor, "b n 3"],
        ground: Float[Tensor, "b 3"],
        scene: Int[Tensor, " b"] | None = None,
    ) -> Float[Tensor, "b m 3"]:
        """T l: the same for an albedo of 1."""
        directions = self.folded.shape[2] - (not self.sphere)
        check_shape("SkyTransport's sky", sky.shape, directions, 3)
        check_shape("SkyTransport's ground", ground.shape, sky.shape[0], 3)
        rows = sky.mT  # as products want them
        if not self.sphere:
            rows = torch.cat([rows, ground[..., None]], dim=2)
        return shade_scenes(self.folded.to(sky.dtype), rows.mT, scene)


def shade_scenes(
    matrices: Float[Tensor, "p m n"],
    radiance: Float[Tensor, "b n c"],
    scene: Int[Tensor, " b"] | None,
) -> Float[Tensor, "b m c"]:
    """``matrices[scene] @ radiance`` as one batched product, which copies no matrix.

    ``scene`` is in ascending order. The lights of each scene go into as many slots as the scene
    with the most lights has; the product is over all slots. A graph, whose sizes cannot depend on
    values, copies the matrix of each light.
    """
    if len(matrices) == 1:
        return shade(matrices[0], radiance)
    assert scene is not None
    if torch.compiler.is_compiling():
        return matrices[scene] @ radiance
    assert scene.device.type != "cpu" or bool((scene.diff() >= 0).all())
    colours = radiance.shape[-1]
    counts = torch.bincount(scene, minlength=len(matrices))
    size = int(counts.max())
    place = torch.arange(len(scene), device=scene.device) - (counts.cumsum(0) - counts)[scene]
    slot = scene * size + place
    rows = radiance.transpose(1, 2)
    slots = rows.new_zeros(len(matrices) * size, *rows.shape[1:]).index_copy(0, slot, rows)
    several = slots.reshape(len(matrices), size * colours, matrices.shape[2])
    shading = several @ matrices.transpose(1, 2)
    return shading.reshape(len(slots), colours, matrices.shape[1])[slot].transpose(1, 2)


def of_scene(x: Shaped[Tensor, "p *s"], scene: Int[Tensor, " b"] | None) -> Shaped[Tensor, "_ *s"]:
    """Each light's own; that of the only scene is left to broadcast."""
    return x if scene is None or len(x) == 1 else x[scene]


def shade(
    matrix: Float[Tensor, "m n"], radiance: Float[Tensor, "*batch n c"]
) -> Float[Tensor, "*batch m c"]:
    """``matrix @ radiance`` as one product for all lights and colours."""
    rows = radiance.transpose(-1, -2).flatten(0, -2)
    # BLAS takes twice as long where a row's numbers are apart in memory
    shading = functional.linear(rows.contiguous(), matrix)
    return shading.reshape(*radiance.shape[:-2], radiance.shape[-1], len(matrix)).transpose(-1, -2)


def _broadcasts(shape: Sequence[int], target: Sequence[int]) -> bool:
    """Whether a tensor of this shape expands to the target's."""
    aligned = zip(reversed(shape), reversed(target), strict=False)
    return len(shape) <= len(target) and all(a in (1, b) for a, b in aligned)


_BLOCK = 2**17  # entries at a time: 6 MB of intermediate results, which the processor's caches hold


class SpecularTransport(DiffuseTransport):
    """Specular reflection at m points under distant light from n directions.

    ``s_p = sum_w f_s(n_p, w, v_p) V(p, w) <n_p, w>+ L(w) dw``.

    ``forward(radiance, specular_scale)`` is :class:`DiffuseTransport`'s with the strength of the
    lobe in the place of the albedo; differentiable in radiance, specular scale and normals, the
    latter where the cosine with the view is above 0.01. ``views`` (towards the camera) are unit
    vectors.

    Memory: about ten times 4 m n bytes while the matrix is computed.
    """

    views: Tensor

    def __init__(
        self,
        visibility: Bool[Tensor, "m n"],
        normals: Float[Tensor, "m 3"],
        grid: DirectionGrid,
        *,
        views: Float[Tensor, "m 3"],
        specular: Specular,
    ) -> None:
        super().__init__(visibility, normals, grid)
        self.specular = specular
        self.register_buffer("views", views)

    def _compute(self) -> Float[Tensor, "m n"]:
        normals = normalize(self.normals, dim=1)
        light, views = self.directions.to(normals.dtype), self.views.to(normals.dtype)
        return math.pi * specular_lobe(normals, views, light, self.specular) * super()._compute()


def specular_transport(
    transport: TransportMatrix,
    normals: Float[Tensor, "m 3"],
    views: Float[Tensor, "m 3"],
    specular: Specular,
) -> TransportMatrix:
    """G[p, w] = f_s(n_p, w, v_p) V(p, w) <n_p, w>+ dw = pi f_s T[p, w].

    ``normals`` and ``views`` (towards the camera) are unit vectors; visibility and cosine come
    from ``transport``, so that no ray is cast. Memory: 4 m n bytes of result and a few MB.
    """
    light = transport.grid.directions.float()
    out = torch.empty_like(transport.matrix)
    block = max(1, _BLOCK // len(light))
    for start in range(0, len(normals), block):
        rows = slice(start, start + block)
        lobe = specular_lobe(normals[rows].float(), views[rows].float(), light, specular)
        torch.mul(lobe.mul_(math.pi), transport.matrix[rows], out=out[rows])
    return TransportMatrix(matrix=out, grid=transport.grid)


def camera_lamp(
    normals: Float[Tensor, "m 3"], views: Float[Tensor, "m 3"], specular: Specular | None
) -> Float[Tensor, "m 2"]:
    """(<n,v>, pi f_s <n,v>): T and G for a lamp at the camera, of irradiance pi and no shadow.

    It is taken to be far away: one at the camera lights a face at 50 cm unevenly by a quarter, at
    1.5 m by a twelfth. Without ``specular`` the second is 0.
    """
    facing = (normals * views).sum(1).clamp(min=0)
    reflected = torch.zeros_like(facing)
    if specular is not None:
        n_v = facing.clamp(min=1e-2)
        reflected = math.pi * ggx(n_v[None], n_v, torch.ones_like(n_v)[None], specular)[0] * facing
    return torch.stack([facing, reflected], 1)


def specular_lobe(
    normals: Float[Tensor, "m 3"],
    views: Float[Tensor, "m 3"],
    light: Float[Tensor, "n 3"],
    specular: Specular,
) -> Float[Tensor, "m n"]:
    """f_s(n_p, w, v_p) in 1/sr; all three are unit vectors, ``views`` towards the camera."""
    n_v = (normals * views).sum(1).clamp(min=1e-2)
    return ggx(cosines(light, normals).clamp(min=0), n_v, cosines(light, views), specular).T
