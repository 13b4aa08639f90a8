"""Rotations: of spherical harmonic expansions by Wigner matrices, and of points, with translations.

``(R f)(w) = f(R^T w)`` turns coefficients by one orthogonal block per band,
``(R f)_l = D^l(R) f_l``. Blocks act on the basis of :func:`skylight.sphere._harmonics.evaluate`,
whose polar axis is +Z.

Euler angles are z-y-z, ``R = Rz(alpha) Ry(beta) Rz(gamma)``, each right-handed: the polar axis goes
to longitude alpha and polar angle beta, after a turn (*twist*) by gamma about itself.

A :class:`RigidTransform` is a rotation and a translation of points, SE(3).
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import constant
from skylight.errors import InputError
from skylight.sphere import _harmonics as harmonics

_POLE = 1e-9  # sin(beta) below which alpha and gamma turn about the same axis


def euler_angles(
    rotation: Float[Tensor, "*b 3 3"],
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"], Float[Tensor, "*b"]]:
    """(alpha, beta, gamma) of rotation matrices, beta in [0, pi]; gamma = 0 for beta = 0 or pi."""
    column_x, column_y, cosine = rotation[..., :, 2].unbind(-1)
    sine = torch.hypot(column_x, column_y)
    at_pole = sine < _POLE
    alpha = torch.where(
        at_pole,
        torch.atan2(-rotation[..., 0, 1], rotation[..., 1, 1]),
        torch.atan2(column_y, column_x),
    )
    gamma = torch.where(at_pole, 0.0, torch.atan2(rotation[..., 2, 1], -rotation[..., 2, 0]))
    return alpha, torch.atan2(sine, cosine), gamma


def matrix_from_euler(
    alpha: Float[Tensor, "*b"], beta: Float[Tensor, "*b"], gamma: Float[Tensor, "*b"]
) -> Float[Tensor, "*b 3 3"]:
    """``Rz(alpha) Ry(beta) Rz(gamma)``."""
    ca, sa, cb, sb, cg, sg = (f(x) for x in (alpha, beta, gamma) for f in (torch.cos, torch.sin))
    rows = [
        [ca * cb * cg - sa * sg, -ca * cb * sg - sa * cg, ca * sb],
        [sa * cb * cg + ca * sg, -sa * cb * sg + ca * cg, sa * sb],
        [-sb * cg, sb * sg, cb],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def wigner_small(beta: Float[Tensor, " b"], degree: int) -> list[Float[Tensor, "b i j"]]:
    """``d^l_mn(beta)``, l = 0 .. degree, each (b, 2l + 1, 2l + 1) with m, n from -l to l.

    They turn complex coefficients without the Condon-Shortley sign: with
    ``f_m = (c_m - i s_m) / sqrt 2`` for m > 0, of the real coefficients c of cos(m phi) and s of
    sin(m phi), and ``f_-m`` its conjugate, a turn by beta about y is ``f'_m = sum_n d_mn f_n``.

    The rim ``|m| = l`` or ``|n| = l`` has closed forms in cos and sin of beta / 2; inside, the
    three-term recursion in l (Varshalovich, Moskalev, Khersonskii 1988, 4.8.2; Kostelec and
    Rockmore 2008) is stable upwards: unitary to 1e-13 at degree 100 in float64. Differentiable in
    beta.
    """
    cosine = torch.cos(beta)[:, None, None]
    half_cos, half_sin = torch.cos(beta / 2), torch.sin(beta / 2)
    bands = [torch.ones_like(cosine)]
    before = torch.zeros_like(cosine[:, :0, :0])
    signless = bands[0]  # with the Condon-Shortley sign, as the recursion has it
    for l in range(degree):  # noqa: E741
        m = torch.arange(-l, l + 1, dtype=beta.dtype, device=beta.device)
        row, column = m[:, None], m[None, :]
        outer = ((l + 1) ** 2 - row**2) * ((l + 1) ** 2 - column**2)
        inner = (l * l - row**2) * (l * l - column**2)
        # m n / (l (l + 1)) is 0 for l = 0, where m = n = 0
        shift = row * column / max(1, l * (l + 1))
        older = torch.nn.functional.pad(before, (1, 1, 1, 1)) if l else torch.zeros_like(signless)
        core = (cosine - shift) * signless
        core = core - inner.clamp(min=0).sqrt() / max(1, l * (2 * l + 1)) * older
        core = core * ((l + 1) * (2 * l + 1) / outer.sqrt())
        before, signless = signless, _with_rim(core, half_cos, half_sin, l + 1)
        n = torch.arange(-(l + 1), l + 2, device=beta.device)
        sign = torch.where((n > 0) & (n % 2 == 1), -1.0, 1.0).to(beta)
        bands.append(sign[:, None] * signless * sign)
    return bands


def _with_rim(
    core: Float[Tensor, "b i i"],
    half_cos: Float[Tensor, " b"],
    half_sin: Float[Tensor, " b"],
    l: int,  # noqa: E741
) -> Float[Tensor, "b j j"]:
    """``core`` (``|m|, |n| < l``) with the rows and columns ``|m| = l``, ``|n| = l`` round it.

    ``d_lm = sqrt(binomial(2l, l + m)) cos^(l+m) (-sin)^(l-m)``; the other three sides follow from
    ``d_mn = (-1)^(m-n) d_nm = d_-n,-m``.
    """
    root = _roots(l, half_cos.device).to(half_cos.dtype)
    m = torch.arange(-l, l + 1, device=half_cos.device)
    up, down = l + m, l - m
    size = root * half_cos[:, None] ** up * half_sin[:, None] ** down  # (b, 2l + 1)
    bottom = size * torch.where(down % 2 == 1, -1.0, 1.0).to(size)  # row m = l
    right = size  # column n = l: (-1)^(l-m) d_lm
    top, left = right.flip(1), bottom.flip(1)  # d_-l,n = d_-n,l and d_m,-l = d_l,-m
    middle = torch.cat([left[:, 1:-1, None], core, right[:, 1:-1, None]], 2)
    return torch.cat([top[:, None], middle, bottom[:, None]], 1)


@constant()
def _roots(l: int, device: torch.device) -> Float[Tensor, " j"]:  # noqa: E741
    """sqrt(binomial(2l, k)), k = 0 .. 2l."""
    roots = [math.sqrt(math.comb(2 * l, k)) for k in range(2 * l + 1)]
    return torch.tensor(roots, dtype=torch.float64, device=device)


def rotation_blocks(
    rotation: Float[Tensor, "*b 3 3"], degree: int
) -> list[Float[Tensor, "*b i j"]]:
    """D^l(R), l = 0 .. degree, real orthogonal (2l + 1, 2l + 1), by :func:`wigner_small`.

    ``D = Z(alpha) d(beta) Z(gamma)``. In the real basis d couples cosines with cosines,
    ``d_mn + d_m,-n``, and sines with sines, ``d_mn - d_m,-n``; Z turns each pair (c_m, s_m) by m
    times the angle.
    """
    leading = rotation.shape[:-2]
    alpha, beta, gamma = (a.reshape(-1) for a in euler_angles(rotation))
    blocks = []
    for l, d in enumerate(wigner_small(beta, degree)):  # noqa: E741
        block = _turn_band(_real_form(d), alpha)
        block = _turn_band(block.mT, -gamma).mT
        blocks.append(block.reshape(*leading, 2 * l + 1, 2 * l + 1))
    return blocks


def _real_form(d: Float[Tensor, "b i i"]) -> Float[Tensor, "b i i"]:
    """``d`` for real coefficients, ordered s_l .. s_1, c_0, c_1 .. c_l."""
    l = d.shape[1] // 2  # noqa: E741
    plus, minus = d[:, l + 1 :, l + 1 :], d[:, l + 1 :, :l].flip(2)
    out = torch.zeros_like(d)
    out[:, l, l] = d[:, l, l]
    out[:, l + 1 :, l] = math.sqrt(2) * d[:, l + 1 :, l]
    out[:, l, l + 1 :] = math.sqrt(2) * d[:, l, l + 1 :]
    out[:, l + 1 :, l + 1 :] = plus + minus
    out[:, :l, :l] = (plus - minus).flip(1, 2)
    return out


def _turn_band(
    band: Float[Tensor, "b i j"], angle_rad: Float[Tensor, " b"]
) -> Float[Tensor, "b i j"]:
    """:func:`turn_about_pole` of the columns of one band's matrix, whose rows are m = -l .. l."""
    l = band.shape[1] // 2  # noqa: E741
    turn = torch.arange(-l, l + 1, dtype=band.dtype, device=band.device) * angle_rad[:, None]
    return torch.cos(turn)[..., None] * band - torch.sin(turn)[..., None] * band.flip(1)


def turn_about_pole(
    coefficients: Float[Tensor, "*c k"], angle_rad: Float[Tensor, "*c"]
) -> Float[Tensor, "*c k"]:
    """Expansions turned about the polar axis: two products a number, all bands at once.

    ``c' = c cos(m a) - s sin(m a)``, ``s' = s cos(m a) + c sin(m a)``, which is one formula where
    sines have negative m.
    """
    degree = harmonics.degree_of(coefficients.shape[-1])
    l = harmonics.bands(degree, coefficients.device)  # noqa: E741
    m = harmonics.orders(degree, coefficients.device)
    turn = m * angle_rad.to(coefficients)[..., None]
    return torch.cos(turn) * coefficients - torch.sin(turn) * coefficients[..., l * (l + 1) - m]


def rotate(
    coefficients: Float[Tensor, "*c k"], rotation: Float[Tensor, "3 3"]
) -> Float[Tensor, "*c k"]:
    """Coefficients of ``f(R^T w)``, for the basis with polar axis +Z."""
    degree = harmonics.degree_of(coefficients.shape[-1])
    blocks = rotation_blocks(rotation, degree)
    parts = coefficients.split([2 * l + 1 for l in range(degree + 1)], dim=-1)  # noqa: E741
    return torch.cat(
        [part @ block.to(part).mT for part, block in zip(parts, blocks, strict=True)], -1
    )


_TOLERANCE = 1e-6  # of float64; numbers of single precision are a hundred times coarser

# rows of a tensor or, for OpenCV, of an array; results are of the same kind
Vectors = TypeVar("Vectors", Float[Tensor, "*_ 3"], Float[np.ndarray, "*_ 3"])


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidTransform:
    """``y = rotation @ x + translation``, with R R^T = 1 and det R = 1.

    Variables are named after the frames: ``camera_from_board.points(x)`` are the camera's
    coordinates of the board's points x, and ``camera_from_board @ board_from_probe`` is
    ``camera_from_probe``. Leading dimensions are a batch. Everything is differentiable.
    """

    rotation: Float[Tensor, "*batch 3 3"]
    translation: Float[Tensor, "*batch 3"]

    def __post_init__(self) -> None:
        identity = torch.eye(3).to(self.rotation)
        off = (self.rotation @ self.rotation.mT - identity).abs()
        limit = _TOLERANCE * (1 if self.rotation.dtype == torch.float64 else 100)
        if not (off < limit).all() or (self.rotation.det() < 0).any():
            raise InputError("a rotation must be orthonormal and no mirror")
        if not self.translation.isfinite().all():
            raise InputError("a translation must be finite")

    @staticmethod
    def identity() -> "RigidTransform":
        """In float64."""
        return RigidTransform.translating(torch.zeros(3, dtype=torch.float64))

    @staticmethod
    def translating(translation: Float[Tensor, "*batch 3"]) -> "RigidTransform":
        """``y = x + translation``."""
        rotation = torch.eye(3).to(translation).expand(*translation.shape, 3)
        return RigidTransform(rotation=rotation, translation=translation)

    @staticmethod
    def from_numpy(
        rotation: Float[np.ndarray, "*batch 3 3"], translation: Float[np.ndarray, "*batch 3"]
    ) -> "RigidTransform":
        """In float64."""
        return RigidTransform(
            rotation=torch.tensor(rotation, dtype=torch.float64),
            translation=torch.tensor(translation, dtype=torch.float64),
        )

    @staticmethod
    def from_vector(vector: Float[Tensor, "*batch 6"]) -> "RigidTransform":
        """``rotation = exp([r]x)`` of a rotation vector r, rad (Rodrigues), and a translation t.

        These are OpenCV's ``rvec`` and ``tvec``.
        """
        from kornia.geometry.conversions import axis_angle_to_rotation_matrix  # slow to import

        turn, translation = vector.split(3, dim=-1)
        rotation = axis_angle_to_rotation_matrix(turn.reshape(-1, 3))
        return RigidTransform(rotation=rotation.reshape(*turn.shape, 3), translation=translation)

    @property
    def rotation_vector(self) -> Float[Tensor, "*batch 3"]:
        """log R: the axis times the angle, 0 to pi rad."""
        from kornia.geometry.conversions import rotation_matrix_to_axis_angle  # slow to import

        found = rotation_matrix_to_axis_angle(self.rotation.reshape(-1, 3, 3))
        return found.reshape(self.translation.shape)

    def vector(self) -> Float[Tensor, "*batch 6"]:
        """That of :meth:`from_vector`."""
        return torch.cat([self.rotation_vector, self.translation], -1)

    @property
    def angle_deg(self) -> Float[Tensor, "*batch"]:
        """How far it turns, 0 to 180 degrees."""
        return torch.rad2deg(self.rotation_vector.norm(dim=-1))

    def matrix(self) -> Float[Tensor, "*batch 4 4"]:
        """[[R, t], [0, 1]], of homogeneous coordinates."""
        last = torch.eye(4).to(self.rotation)[3:].expand(*self.translation.shape[:-1], 1, 4)
        return torch.cat([torch.cat([self.rotation, self.translation[..., None]], -1), last], -2)

    def __matmul__(self, other: "RigidTransform") -> "RigidTransform":
        """``(a @ b).points(x) = a.points(b.points(x))``."""
        return RigidTransform(
            rotation=self.rotation @ other.rotation,
            translation=self.points(other.translation),
        )

    def inverse(self) -> "RigidTransform":
        """``x = R^T (y - t)``."""
        back = self.rotation.mT
        shift = torch.einsum("...ij,...j->...i", back, self.translation)
        return RigidTransform(rotation=back, translation=-shift)

    def about(self, centre: Float[Tensor, "*batch 3"]) -> "RigidTransform":
        """The same motion with its rotation about ``centre``: ``R (x - c) + c + t``."""
        there = RigidTransform.translating(centre)
        return there @ self @ there.inverse()

    def points(self, points: Vectors) -> Vectors:
        """``R x + t``; leading dimensions broadcast with the batch's."""
        if isinstance(points, np.ndarray):
            return self.points(torch.tensor(points)).numpy()
        return self.directions(points) + self.translation.to(points)

    def directions(self, directions: Vectors) -> Vectors:
        """``R w``: directions are not moved by the translation."""
        if isinstance(directions, np.ndarray):
            return self.directions(torch.tensor(directions)).numpy()
        rotation = self.rotation.to(directions)
        if rotation.ndim == 2:  # a third of the time for few directions
            return directions @ rotation.T
        return torch.einsum("...ij,...j->...i", rotation, directions)
