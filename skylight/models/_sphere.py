"""Light from all round, of any place: a smooth field of log radiance, and up to three lamps.

    l(w) = A(w) + 4 pi sum_k e_k c_k g(w; d_k, s_k),    A(w) ~ exp(sum_j c_j(z) B_j(p(w)))

:mod:`~skylight.models._lobes` has the lamps, a sun among them. A is smooth light of mean luminance
1. B are cubic B-splines on two disks, the sphere above and below the horizon
(:mod:`~skylight.sphere._lobes`), and their control points are linear in the latents,
c(z) = b + F z. The whole is turned about the vertical by an azimuth, which is that of the
strongest lamp beforehand.

What places look like was learnt from simulated ones (:mod:`skylight.places`): F is what they vary
by, and the prior (:class:`SpherePrior`) is a mixture over kinds of place.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._modes import constant, full_precision, on_cpu, single
from skylight._module import Module
from skylight.errors import AssetError, InputError, check_shape
from skylight.io._tensors import read_tensors, tensors_sha256, write_tensors
from skylight.models._base import draws
from skylight.models._lobes import LAMP_PARAMETERS, LampedLight, Lamps
from skylight.models._manifest import PLACES
from skylight.models._prior import convex_shape, log_normals
from skylight.sphere._frame import DirectionGrid, angles_from_direction
from skylight.sphere._lobes import DiskSplines

SHIPPED = Path(str(files("skylight.models"))) / "data" / PLACES
MOST_LAMPS = 3
_PIXELS = 4096  # whose splines are dense at a time; all in float64 would take 0.2 GB
MOST_ACROSS = 99  # control points of a file, before memory is asked for
# log radiance, of a mean luminance of 1: a line search may try anything
_DARKEST, _BRIGHTEST = -12.0, 12.0
TURNS = 8  # of starts without a lamp
AHEAD_KAPPA = 20.0  # of lamps about the azimuth of the whole: 13 degrees
_AHEAD_LOG_MEAN = math.log(float(np.i0(AHEAD_KAPPA))) - AHEAD_KAPPA  # e^(k (cos - 1)), all round


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """What was learnt of places: n control points (of both disks), z latents, m components of k
    kinds.

    ``control`` b and ``basis`` F of the module's text; the mixture over latents, which are about
    normal, as ``log_weights``, ``means`` and ``precision_factors``
    (:class:`~skylight.models._prior.GaussianMixture`), and each component's ``kind``. Of the lamps
    of each kind: ``log_counts`` are log probabilities of 0 to 3; ``lamp_means`` and
    ``lamp_factors`` a normal density of the four numbers of a lamp that are no direction;
    ``lamp_up`` h of a density ``e^(h d_y)`` of directions, and ``lamp_ahead`` the share that is at
    the azimuth of the whole.
    """

    kinds: tuple[str, ...]
    across: int
    control: Float[Tensor, "3 n"]
    basis: Float[Tensor, "z 3 n"]
    log_weights: Float[Tensor, " m"]
    means: Float[Tensor, "m z"]
    precision_factors: Float[Tensor, "m z z"]
    kind: Int[Tensor, " m"]
    log_counts: Float[Tensor, "k 4"]
    lamp_means: Float[Tensor, "k 4"]
    lamp_factors: Float[Tensor, "k 4 4"]
    lamp_up: Float[Tensor, " k"]
    lamp_ahead: Float[Tensor, " k"]

    @property
    def tensors(self) -> dict[str, Tensor]:
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: each for name, each in named.items() if isinstance(each, Tensor)}

    def save(self, path: Path, told: Mapping[str, str]) -> None:
        """Write a safetensors file, with what is ``told`` of where it comes from."""
        own = {"across": str(self.across), "kinds": " ".join(self.kinds)}
        write_tensors(path, self.tensors, {**told, **own})

    @property
    def fingerprint(self) -> str:
        """SHA-256 over all that :meth:`save` writes of the model."""
        return tensors_sha256(self.tensors, {"kinds": " ".join(self.kinds)})

    @staticmethod
    def load(path: Path = SHIPPED) -> "Places":
        """Read what :meth:`save` wrote.

        Raises
        ------
        InputError
            That is not in the file.
        AssetError
            The same of the file that comes with skylight.
        """
        try:
            tensors, told = read_tensors(path)
            kinds, across = tuple(told["kinds"].split()), int(told["across"])
            _check(tensors, len(kinds), across)
            return Places(kinds=kinds, across=across, **tensors)
        except FileNotFoundError:
            reason = f"{path}: no such file"
        except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
            first = str(error).partition("\n")[0]
            reason = f"{path} holds no usable model of places ({first})"
        if path == SHIPPED:
            raise AssetError(f"{reason}; reinstall skylight")
        raise InputError(f"{reason}; make one with: skylight train --config sphere")


def _check(tensors: Mapping[str, Tensor], kinds: int, across: int) -> None:
    """ValueError or KeyError for what is no model of so many kinds of place."""
    if not 4 <= across <= MOST_ACROSS:
        raise ValueError(f"{across} control points across")
    points = 2 * DiskSplines(across, DirectionGrid.sky(2)).count
    latents, components = len(tensors["basis"]), len(tensors["kind"])
    shapes = {
        "control": (3, points),
        "basis": (latents, 3, points),
        "log_weights": (components,),
        "means": (components, latents),
        "precision_factors": (components, latents, latents),
        "kind": (components,),
        "log_counts": (kinds, MOST_LAMPS + 1),
        "lamp_means": (kinds, 4),
        "lamp_factors": (kinds, 4, 4),
        "lamp_up": (kinds,),
        "lamp_ahead": (kinds,),
    }
    for name, each in tensors.items():
        if tuple(each.shape) != shapes[name] or not each.numel():
            raise ValueError(f"{name} of shape {tuple(each.shape)}, not {shapes[name]}")
        wanted = torch.int64 if name == "kind" else torch.float32
        if each.dtype != wanted or not bool(each.isfinite().all()):
            raise ValueError(f"{name} is not made of finite numbers of type {wanted}")
    if not bool(((tensors["kind"] >= 0) & (tensors["kind"] < kinds)).all()):
        raise ValueError("components of an unknown kind of place")


@constant()
def shipped() -> Places:
    """The one that comes with skylight."""
    return Places.load()


class SphereLight(LampedLight):
    """Parameters ``(..., z + 1 + 7 k)`` to radiance on ``height`` rows of the sphere, of k lamps.

    Latents, about standard normal beforehand, the azimuth by which the whole is turned (rad), and
    then for each lamp what :class:`~skylight.models._lobes.LampedLight` says; its direction too is
    that before the turn. The prior is :class:`SpherePrior` of as many lamps.

    Parameters
    ----------
    count
        k, 0 or more.
    height
        Rows of ``grid``, an even number.
    places
        What places look like; by default what comes with skylight.
    """

    name = "sphere"
    control: Tensor
    basis: Tensor
    means: Tensor
    values: Tensor

    @on_cpu
    def __init__(self, count: int, height: int = 32, places: Places | None = None) -> None:
        if height % 2:
            raise InputError(f"{height} rows: give an even number, half of them below the horizon")
        self.places = places or shipped()
        latents = len(self.places.basis)
        self.parameter_names = f"{latents} latents, azimuth, {LAMP_PARAMETERS} of each lamp"
        super().__init__(latents + 1, count, height, azimuth_index=latents)
        self.latents = latents
        self.register_buffer("values", _values(self.places.across, height // 2), persistent=False)
        for name in ("control", "basis", "means"):
            self.register_buffer(name, getattr(self.places, name), persistent=False)

    def on_rows(self, height: int) -> "SphereLight":
        """The model on ``height`` rows."""
        return SphereLight(self.count, height, self.places).to(self.control)

    def ambient(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """A of the module's text, turned.

        Turned are its rows, as sums of cosines: exact for what their pixels tell.
        """
        log = self._ahead(params) @ self._turning(params)[..., None, :, :]
        log = log.flatten(-2).clamp(_DARKEST, _BRIGHTEST)
        return self.normalised(log.exp().transpose(-1, -2).contiguous())

    def ambient_log_slopes(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b a 3 n"]:
        """Fields of the latents, and the slope along rows, turned."""
        turning, along = self._turning(params), self._turning(params, slope=True)
        ahead = self._ahead(params)
        fields = self._images(self.basis.to(params)).flatten(0, 2) @ turning
        fields = fields.unflatten(1, (self.latents, 3, -1)).flatten(-2)
        log = (ahead @ turning[:, None]).flatten(-2)
        slopes = torch.cat([fields, (ahead @ along[:, None]).flatten(-2)[:, None]], 1)
        return slopes * ((log > _DARKEST) & (log < _BRIGHTEST))[:, None]

    def _ahead(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch 3 h w"]:
        """Log radiance that is not turned, nor normalised."""
        z = params[..., : self.latents]
        control = self.control + (z @ self.basis.to(z.dtype).flatten(1)).unflatten(-1, (3, -1))
        return self._images(control.to(z.dtype))

    def _images(self, control: Float[Tensor, "*batch 3 k"]) -> Float[Tensor, "*batch 3 h w"]:
        """The splines of such control points, as a lat-long image."""
        rows, columns = self.grid.layout  # type: ignore[misc]
        halves = control.unflatten(-1, (2, -1)) @ self.values.to(control.dtype)
        above, below = halves.unflatten(-1, (rows // 2, columns)).unbind(-3)
        return torch.cat([above, below.flip(-2)], -2)

    def _turning(
        self, params: Float[Tensor, "*batch p"], slope: bool = False
    ) -> Float[Tensor, "*batch w w"]:
        """T of ``row @ T``, each row turned by the azimuth, or the ``slope`` of that along it."""
        return row_turns(params[..., self.latents], self.grid.layout[1], slope=slope)  # type: ignore[index]

    def lamps(self, params: Float[Tensor, "*batch p"]) -> Lamps:
        """What the parameters mean, turned."""
        found = super().lamps(params)
        azimuth = params[..., self.latents, None]
        return replace(found, directions=turned(found.directions, azimuth))

    def ambient_starts(self) -> Float[Tensor, "a p"]:
        """The means of the prior's components."""
        ahead = self.means.new_zeros(len(self.means), 1)
        return torch.cat([self.means, ahead], 1)

    def starts(self) -> Float[Tensor, "s p"]:
        """Those of any lamps; without one, turned all round."""
        if self.count:
            return super().starts()
        starts = self.ambient_starts().repeat(TURNS, 1)
        turn = torch.arange(TURNS).repeat_interleave(len(self.means)) / TURNS
        starts[:, self.latents] = 2 * math.pi * turn.to(starts)
        return starts

    def starts_at(
        self, directions: Float[Tensor, "s k 3"], energies: Float[Tensor, "s k"]
    ) -> Float[Tensor, "s c p"]:
        """As of any lamps, each set turned to its strongest."""
        if self.count == 0:
            return super().starts_at(directions, energies)
        strongest = energies.argmax(1)[:, None, None].expand(-1, 1, 3)
        azimuth, _ = angles_from_direction(directions.gather(1, strongest)[:, 0])
        ahead = turned(directions, -azimuth[:, None])
        params = super().starts_at(ahead, energies)
        params[..., self.latents] = azimuth[:, None].to(params)
        return params


@constant(4)
def _values(across: int, rows: int) -> Float[Tensor, "k n"]:
    """The splines of one disk at the pixels of so many rows."""
    splines = DiskSplines(across, DirectionGrid.sky(rows))
    index, weights = (each[0] for each in splines.taps(torch.zeros(1, dtype=torch.float64)))
    values = torch.empty(splines.count, len(index), dtype=torch.float32)
    for some in torch.arange(len(index)).split(_PIXELS):
        dense = torch.zeros(len(some), splines.count, dtype=torch.float64)
        values[:, some] = dense.scatter_add_(1, index[some], weights[some].double()).T.float()
    return values


def row_turns(
    azimuth_rad: Float[Tensor, "*b"], width: int, *, slope: bool = False
) -> Float[Tensor, "*b w w"]:
    """Matrices that turn rows of ``width`` pixels to the right, as sums of waves.

    With ``slope`` their derivatives along the azimuth.
    """
    like = azimuth_rad.dtype, azimuth_rad.device
    order, share, cosines, sines, behind = _waves(width, *like)
    phase = azimuth_rad[..., None] * order
    cos, sin = share * phase.cos(), share * phase.sin()
    if slope:
        cos, sin = -order * sin, order * cos
    return (cos @ cosines + sin @ sines)[..., behind]


@constant(8)
def _waves(width: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """Each wave's number along a row, its share, cosine and sine at each column, and by how many
    columns each is behind each other."""
    column = torch.arange(width, device=device)
    order = column[: width // 2 + 1]
    share = torch.where((order == 0) | (2 * order == width), 1, 2).to(dtype) / width
    waves = 2 * math.pi / width * (order[:, None] * column % width).to(dtype)
    behind = (column - column[:, None]) % width
    return order.to(dtype), share, waves.cos(), waves.sin(), behind


def turned(
    directions: Float[Tensor, "*b k 3"], azimuth_rad: Float[Tensor, "*#b #k"]
) -> Float[Tensor, "*b k 3"]:
    """Directions turned about the vertical, to the right for a positive angle."""
    x, y, z = directions.unbind(-1)
    sin, cos = azimuth_rad.sin().to(x.dtype), azimuth_rad.cos().to(x.dtype)
    return torch.stack([cos * x - sin * z, y, sin * x + cos * z], -1)


class SpherePrior(Module):
    """Density of :class:`SphereLight`'s free parameters but the azimuth: a mixture over places ::

        p(z, lamps) = sum_m w_m N(z; mu_m, S_m) P(k | m) prod_i p(lamp_i | m)

    with what is learnt of lamps in places of component m's kind. A direction's length, which means
    nothing, is 1 with a standard deviation of 0.1.

    ``count`` is k; P is known up to 3, and more count as 3. ``log_odds`` are what else is known of
    the kinds of place, by which each is likelier than it was; minus infinity rules one out.
    """

    log_weights: Tensor
    means: Tensor
    precision_factors: Tensor
    precisions: Tensor
    kind: Tensor
    log_counts: Tensor
    lamp_means: Tensor
    lamp_factors: Tensor
    lamp_up: Tensor
    lamp_ahead: Tensor

    @on_cpu
    def __init__(
        self,
        count: int,
        places: Places | None = None,
        log_odds: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__()
        places = places or shipped()
        self.count, self.kinds = count, places.kinds
        self.latents = places.means.shape[1]
        self.parameter_count = self.latents + LAMP_PARAMETERS * count
        for name, each in places.tensors.items():
            if name not in ("control", "basis"):
                self.register_buffer(name, each.clone(), persistent=False)
        known = log_odds or {}
        for kind in known:
            if kind not in self.kinds:
                raise InputError(
                    f"unknown kind of place {kind!r}: choose of {', '.join(self.kinds)}"
                )
        if all(known.get(kind) == -math.inf for kind in self.kinds):
            raise InputError("every kind of place is ruled out")
        odds = torch.tensor([float(known.get(kind, 0.0)) for kind in self.kinds])
        self.log_weights = (self.log_weights + odds[self.kind].to(self.log_weights)).log_softmax(0)

        factors = self.precision_factors.double()
        self.register_buffer("precisions", factors @ factors.mT, persistent=False)

    def log_prob(self, x: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch"]:
        """Natural logarithm of the density, differentiable in x."""
        return torch.logsumexp(self.of_components(x), -1)

    def responsibilities(self, x: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch k"]:
        """How likely each kind of place is."""
        share = torch.softmax(self.of_components(x), -1)
        kinds = share.new_zeros(*share.shape[:-1], len(self.kinds))
        return kinds.index_add(-1, self.kind, share)

    def of_components(self, x: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch m"]:
        """The logarithms of the mixture's summands."""
        names = f"{self.latents} latents, {LAMP_PARAMETERS} of each lamp"
        check_shape("SpherePrior's parameters", x.shape, self.parameter_count, names=names)
        x = single(x)
        with full_precision(x):
            latents = log_normals(x[..., : self.latents], self.means, self.precision_factors)
            total = self.log_weights.to(x.dtype) + latents
            counts = self.log_counts[:, min(self.count, MOST_LAMPS)].to(x.dtype)
            of_kinds = counts.expand(*x.shape[:-1], -1)
            if self.count:
                each = x[..., self.latents :].unflatten(-1, (self.count, LAMP_PARAMETERS))
                of_kinds = of_kinds + self._of_lamps(each).sum(-2)
            return total + of_kinds[..., self.kind]

    @torch.no_grad()
    def convex_shape(
        self, x: Float[Tensor, "b p"]
    ) -> tuple[Float[Tensor, "b p"], Float[Tensor, "b p p"]]:
        """Slope of ``-log_prob``, and the Hessian of a function above it that touches it at x.

        That function is the mean of the components' logarithms, weighted by their
        responsibilities at x (expectation-maximisation: Dempster, Laird & Rubin 1977): over
        latents the mean of the normals' precisions. Of lamps it is by differences, without its
        negative eigenvalues.
        """
        x = single(x)
        with full_precision(x):
            share, z = torch.softmax(self.of_components(x), -1), self.latents
            precisions = self.precisions.to(x.dtype)
            pulls = torch.einsum(
                "bmz,mzy->bmy", x[:, None, :z] - self.means.to(x.dtype), precisions
            )
            slope, hessian = torch.zeros_like(x), x.new_zeros(*x.shape, x.shape[1])
            slope[:, :z] = torch.einsum("bm,bmz->bz", share, pulls)
            hessian[:, :z, :z] = torch.einsum("bm,mzy->bzy", share, precisions)
            kinds = share.new_zeros(len(x), len(self.kinds)).index_add(-1, self.kind, share)

            def of_lamps(each: Tensor, rows: Tensor) -> Tensor:
                return -(kinds[rows] * self._of_lamps(each)).sum(-1)

            if self.count:
                each = x[:, z:].unflatten(1, (self.count, LAMP_PARAMETERS)).flatten(0, 1)
                rows = torch.arange(len(x), device=x.device).repeat_interleave(self.count)
                slopes, hessians = convex_shape(of_lamps, each, rows)
                slope[:, z:] = slopes.reshape(len(x), -1)
                for k, of_lamp in enumerate(hessians.unflatten(0, (len(x), -1)).unbind(1)):
                    own = slice(z + LAMP_PARAMETERS * k, z + LAMP_PARAMETERS * (k + 1))
                    hessian[:, own, own] = of_lamp
            return slope, hessian

    def _of_lamps(self, each: Float[Tensor, "*b 7"]) -> Float[Tensor, "*b k"]:
        """Log density of a lamp in places of each kind."""
        length = each[..., :3].norm(dim=-1, keepdim=True).clamp(min=1e-12)
        direction = each[..., :3] / length
        up = self.lamp_up.to(each.dtype)
        of_height = up * direction[..., 1:2] + (up / (4 * math.pi * up.sinh())).log()
        level = direction[..., ::2].norm(dim=-1, keepdim=True).clamp(min=1e-6)
        cosine = -direction[..., 2:] / level  # to the azimuth of the whole, which is -Z
        ahead = AHEAD_KAPPA * (cosine - 1) - _AHEAD_LOG_MEAN
        share = self.lamp_ahead.to(each.dtype)
        of_azimuth = torch.logaddexp(share.log() + ahead, torch.log1p(-share))
        of_length = -0.5 * (((length - 1) / 0.1).square() + math.log(2 * math.pi * 0.01))
        numbers = log_normals(each[..., 3:], self.lamp_means, self.lamp_factors)
        return of_height + of_azimuth + of_length - 2 * length.log() + numbers

    def sample(
        self, shape: int | Sequence[int] = (), generator: torch.Generator | None = None
    ) -> Float[Tensor, "*shape p"]:
        """Independent draws ``(*shape, p)``, n of them for ``shape=n`` and one for none.

        Of places with this prior's number of lamps; in the module's dtype and on its device.
        """
        shape, where = draws(shape), {"dtype": self.means.dtype, "device": self.means.device}
        n, count = shape.numel(), self.count
        weights = (self.log_weights + self.log_counts[self.kind, min(count, MOST_LAMPS)]).exp()
        which = torch.multinomial(weights, max(n, 1), replacement=True, generator=generator)[:n]
        kind = self.kind[which]

        def normal(means: Tensor, factors: Tensor, rows: Tensor, *more: int) -> Tensor:
            noise = torch.randn(n, *more, means.shape[1], generator=generator, **where)
            offset = torch.linalg.solve(
                factors.mT[rows].reshape(n, *[1] * len(more), *factors.shape[1:]), noise[..., None]
            )
            return means[rows].reshape(n, *[1] * len(more), means.shape[1]) + offset[..., 0]

        z = normal(self.means, self.precision_factors, which)
        rest = normal(self.lamp_means, self.lamp_factors, kind, count)
        uniform = torch.rand(n, count, 4, generator=generator, **where)
        h = self.lamp_up[kind, None]
        # the height's distribution function is (e^(h y) - e^-h) / (e^h - e^-h)
        y = ((-h).exp() + uniform[..., 0] * (h.exp() - (-h).exp())).log() / h
        y = y.clamp(-1, 1)
        ahead = uniform[..., 1] < self.lamp_ahead[kind, None]
        azimuth = torch.where(
            ahead, _von_mises(uniform[..., 2]), 2 * math.pi * (uniform[..., 2] - 0.5)
        )
        level = (1 - y.square()).sqrt()
        towards = torch.stack([level * azimuth.sin(), y, -level * azimuth.cos()], -1)
        length = 1 + 0.1 * torch.randn(n, count, 1, generator=generator, **where)
        lamps = torch.cat([towards * length, rest], -1)
        return torch.cat([z, lamps.flatten(1)], 1).reshape(*shape, self.parameter_count)


@constant()
def _von_mises_table() -> Float[Tensor, " n"]:
    """Angles at which the distribution about 0 has reached i / (n - 1)."""
    angle = torch.linspace(-math.pi, math.pi, 4001, dtype=torch.float64)
    density = (AHEAD_KAPPA * (angle.cos() - 1)).exp()
    reached = torch.cumulative_trapezoid(density, angle)
    reached = torch.cat([reached.new_zeros(1), reached]) / reached[-1]
    at = torch.searchsorted(reached, torch.linspace(0, 1, 1001, dtype=torch.float64))
    return angle[at.clamp(max=4000)]


def _von_mises(uniform: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    """Angles of that distribution, of uniform numbers."""
    table = _von_mises_table().to(uniform)
    place = uniform * (len(table) - 1)
    low = place.long().clamp(max=len(table) - 2)
    return torch.lerp(table[low], table[low + 1], place - low)
