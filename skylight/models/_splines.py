"""The sky autoencoder that ships: a smooth function on the hemisphere, without pixels.

What it decodes are control points of cubic B-splines on the hemisphere, seen as a disk
(:mod:`~skylight.sphere._lobes`)::

    log(L(w) + 0.02) = sum_k c_k(z) B_k(p(w)),    c(z) = A z + b + MLP(z)

so a sky has no rows, columns or pole to show, a turn about the vertical is exact, and the
decoder multiplies a hundredth as often as convolutions do that paint 4,096 pixels. The encoder is
an MLP of the sky's own control points on a coarser lattice, those of least squares.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from skylight._modes import constant, full_precision, on_cpu, single
from skylight._module import Module
from skylight.models._network import CENTRE_AZIMUTH_RAD, CODE_LIMIT, HEIGHT, WIDTH, SkyNetwork
from skylight.models._sun_head import COORDINATES
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._lobes import DiskSplines

# control points across the disk, 4.4 degrees apart; the encoder's, 7.8 degrees
ACROSS, SEEN_ACROSS = 44, 26
HIDDEN = 320
FLOOR = 0.02  # radiance, of a mean luminance of 1: what is darker is alike
_RIDGE = 1e-3  # of a mean control point's weight: those beyond the horizon are seen by hardly any


class SplineAutoencoder(SkyNetwork):
    """See the module; ``latents`` counts the sun's five coordinates."""

    seen: Tensor

    @on_cpu
    def __init__(self, latents: int = 64) -> None:
        super().__init__(latents)
        self.splines = DiskSplines(ACROSS, DirectionGrid.sky(HEIGHT))
        self._evaluation = _Products(_tables(ACROSS))
        self.register_buffer("seen", _least_squares(SEEN_ACROSS), persistent=False)
        self.encoder = _mlp(3 * len(self.seen), latents - COORDINATES)
        self.linear = nn.Linear(latents, 3 * self.splines.count)
        self.decoder = _mlp(latents, 3 * self.splines.count, bias=False)

    def code(self, radiance: Float[Tensor, "b h w 3"]) -> Float[Tensor, "b 3 h w"]:
        """log(0.02 + L)"""
        return torch.log(radiance.permute(0, 3, 1, 2) + FLOOR)

    def uncode(self, coded: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b h w 3"]:
        return _radiance(coded).permute(0, 2, 3, 1)

    def control(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b k 3"]:
        """The control points c(z)."""
        self.check_latents(z)
        values = single(self.linear(z)) + self.decoder(z)
        return values.unflatten(1, (self.splines.count, 3))

    def encode_coded(
        self, sun: Float[Tensor, "b s"], coded: Float[Tensor, "b 3 h w"]
    ) -> Float[Tensor, "b z"]:
        with full_precision(coded):  # least squares: large terms of either sign
            seen = torch.einsum("kn,bcn->bkc", self.seen, coded.flatten(2))
        return torch.cat([self.encoder(seen.flatten(1)), sun], 1)

    def decode_coded(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b 3 h w"]:
        values = self._evaluation(self.control(z).permute(1, 2, 0).flatten(1))
        return values.unflatten(1, (3, z.shape[0])).permute(2, 1, 0).unflatten(2, (HEIGHT, WIDTH))

    def decode_at_azimuth(
        self,
        z: Float[Tensor, "b z"],
        azimuth_rad: Float[Tensor, " t"],
        sun_spread_rad: float,
        height: int = HEIGHT,
    ) -> Float[Tensor, "b h w 3"]:
        """:meth:`decode`, rotated so that suns are there; exact, as nothing is resampled."""
        z, azimuth_rad = (self._in_own_precision(x) for x in (z, azimuth_rad))
        rows = None if height == HEIGHT else height
        coded = self.splines(self.control(z), azimuth_rad - CENTRE_AZIMUTH_RAD, rows)
        sky = _radiance(coded).unflatten(1, (height, 4 * height))
        assert self.sun_head is not None
        return sky + self.sun_head.lobe(z[:, -COORDINATES:], azimuth_rad, sun_spread_rad, rows)

    def exportable(self, z: Float[Tensor, "b z"]) -> Float[Tensor, "b h w 3"]:
        """:meth:`decode` by operations that ONNX knows."""
        assert self.sun_head is not None
        coded = self.splines.gathered(self.control(z), torch.zeros(1, device=z.device))
        sky = _radiance(coded).unflatten(1, (HEIGHT, WIDTH))
        return sky + self.sun_head.lobe(z[:, -COORDINATES:])


class _Products(Module):
    """Products of a sparse matrix (n,k) with many columns (k,c), differentiable in these.

    As weighted sums of rows both ways; torch's own gradient of such sums takes ten times as long.
    """

    def __init__(self, tables: dict[str, Tensor]) -> None:
        super().__init__()
        for name, table in tables.items():
            self.register_buffer(name, table, persistent=False)

    def forward(self, x: Float[Tensor, "k c"]) -> Float[Tensor, "n c"]:
        if torch.compiler.is_compiling():  # knows no function with a derivative forwards
            columns, first, values = self._matrix("forth")
            terms = values[:, None] * x[columns]
            rows = self.get_buffer("rows")
            return x.new_zeros(len(first), x.shape[1]).index_add(0, rows, terms)
        return _Product.apply(x, *self._matrix("forth"), *self._matrix("back"))

    def _matrix(self, name: str) -> tuple[Tensor, Tensor, Tensor]:
        columns, first, values = (
            self.get_buffer(f"{name}_{part}") for part in ("columns", "first", "values")
        )
        return columns, first, values


# Tables that all networks share; to make them takes ten times as long as the rest of one.
@constant()
def _tables(across: int) -> dict[str, Tensor]:
    """Of :class:`_Products`: the values of splines at the pixels of a network's skies."""
    matrix = DiskSplines(across, DirectionGrid.sky(HEIGHT)).matrix()
    tables = {"rows": matrix.nonzero()[:, 0]}
    for name, part in (("forth", matrix), ("back", matrix.T)):
        rows, columns = part.nonzero(as_tuple=True)
        first = torch.bincount(rows, minlength=len(part)).cumsum(0).roll(1)
        first[0] = 0
        tables[f"{name}_columns"], tables[f"{name}_first"] = columns, first
        tables[f"{name}_values"] = part[rows, columns].float()
    return tables


class _Product(torch.autograd.Function):
    """Of x (k,c) with a matrix as three tensors, and with its transpose in the way back."""

    @staticmethod
    def forward(x: Tensor, *matrices: Tensor) -> Tensor:
        columns, first, values = matrices[:3]
        return functional.embedding_bag(columns, x, first, mode="sum", per_sample_weights=values)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        forth, back = ctx.saved_tensors[:3], ctx.saved_tensors[3:]
        return _Product.apply(grads[0].contiguous(), *back, *forth), *[None] * 6

    @staticmethod
    def jvp(ctx: Any, *tangents: Tensor | None) -> Tensor:
        assert tangents[0] is not None
        return _Product.apply(tangents[0].contiguous(), *ctx.saved_tensors)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *args: Tensor) -> tuple[Tensor, int]:
        """More columns."""
        assert in_dims[0] is not None
        x = args[0].movedim(in_dims[0], -1)
        return _Product.apply(x.flatten(1), *args[1:]).unflatten(1, x.shape[1:]), 2


def _radiance(coded: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    return (coded.clamp(max=CODE_LIMIT).exp() - FLOOR).clamp(min=0)


class _Residual(Module):
    """``x + SiLU(W x + b)``"""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.inner = nn.Linear(size, size)

    def forward(self, x: Float[Tensor, "b f"]) -> Float[Tensor, "b f"]:
        return x + functional.silu(self.inner(x))


def _mlp(size_in: int, size_out: int, *, bias: bool = True) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size_in, HIDDEN),
        nn.SiLU(),
        _Residual(HIDDEN),
        _Residual(HIDDEN),
        nn.Linear(HIDDEN, size_out, bias=bias),
    )


@constant()
def _least_squares(across: int) -> Float[Tensor, "k n"]:
    """The linear map from the values of a network's skies to the control points that are nearest
    to them in the mean square over solid angle."""
    grid = DirectionGrid.sky(HEIGHT)
    matrix, solid = DiskSplines(across, grid).matrix(), grid.solid_angles.double()
    gram = matrix.T @ (solid[:, None] * matrix)
    gram = gram + _RIDGE * gram.diagonal().mean() * torch.eye(len(gram)).double()
    return torch.linalg.solve(gram, matrix.T * solid).float()
