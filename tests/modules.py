"""Every public module with an input: what the contract of all modules is tried on.

A line of :data:`CASES` for each; what is tried stands in ``tests/test_modules.py``. Nothing here
asks for pytest, so that a machine with an accelerator can run the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize
from torch.utils._python_dispatch import TorchDispatchMode

from skylight.csc import (
    BoxDictionary,
    CapFilterBank,
    CodeTensors,
    FilterBank,
    RotationCorrelation,
    SphericalSparseCoder,
    ZonalCorrelation,
)
from skylight.csc._positions import Positions
from skylight.models import (
    ConvolutionalAutoencoder,
    GaussianLobes,
    HarmonicLight,
    LambertianGround,
    LampsLight,
    LampsPrior,
    SphereLight,
    SpherePrior,
    SunSky,
    load_bundle,
)
from skylight.models.autoencoder import AutoencoderLight
from skylight.probes._encoder import ObjectEncoder, SurfaceTransfer
from skylight.probes.partitions import PartitionProbe, named_design
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions.relight import (
    Relighting,
    TransferCoefficients,
    TurningRelighting,
)
from skylight.probes.voxel import DirectReconstruction, VoxelProbe, star_probe
from skylight.probes.voxel._model import exposed_faces
from skylight.sphere import DirectionGrid, DiskSplines, LatLongTransform
from skylight.transport import DiffuseTransport, SkyTransport, SpecularTransport
from skylight.transport._render import Specular

F32, F64 = torch.float32, torch.float64
GRID = DirectionGrid.latlong(8)
SKY = DirectionGrid.sky(8)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A module, what it is called with, and what of it is called.

    ``autocast`` and ``tf32`` bound the error of a value, relative to itself and the mean together.
    Of a product they are three roundings, of its two factors and of the result, to eight and to
    eleven bits: 3 x 2^-9 and 2 x 2^-12 where all terms have one sign, and more by how much larger
    the terms are than their sum where not. ``axis`` is the one of the first input whose size is
    given by the module.
    """

    make: Callable[..., nn.Module]
    inputs: Callable[[Any], tuple[Tensor, ...]]
    call: Callable[..., Tensor] = lambda module, *x: module(*x)
    double: Callable[[], nn.Module] | None = None
    autocast: float = 3 * 2**-9
    tf32: float = 2**-10
    float32: float = 2e-5
    axis: int | None = -1
    host: str = ""  # what of a call is asked for there, and a device waits
    # Of a result: its first input's, or that and float32 at least, where eight bits would ruin
    # it; or the module's own, which is a part of what was learnt or is searched
    dtype: Literal["input", "single", "module"] = "input"
    transforms: bool = True  # torch.func's
    meta: bool = True
    slow: bool = False
    batch: bool = True  # the first dimension of the first input may be any
    no_graph: str = ""  # what they say who cannot have one by torch.compile and torch.export
    slow_graph: bool = False  # it takes seconds to make

    def single(self) -> Any:
        return self.make().float()

    def in_double(self) -> Any:
        return self.double() if self.double else self.make().double()

    @cached_property
    def _given(self) -> tuple[Tensor, ...]:
        return self.inputs(self.in_double())

    def given(self, dtype: torch.dtype) -> list[Tensor]:
        return [x.detach().to(dtype) for x in self._given]

    @cached_property
    def truth(self) -> Tensor:
        """In float64."""
        return self.call(self.in_double(), *self.given(F64)).detach()


def random(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator("cpu").manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=F64, device="cpu")


def normal(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator("cpu").manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=F64, device="cpu")


def free(model: Any) -> tuple[Tensor]:
    """Parameters of a light model, well inside of its bounds."""
    return (model.from_free(0.7 * normal(3, model.parameter_count)),)


def diffuse() -> DiffuseTransport:
    return DiffuseTransport(random(40, len(GRID)) > 0.3, normal(40, 3, seed=1), GRID)


def specular() -> SpecularTransport:
    normals = normalize(normal(40, 3, seed=1))
    views = normalize(normals + 0.4 * normal(40, 3, seed=2))
    visible = random(40, len(GRID)) > 0.3
    return SpecularTransport(visible, normals, GRID, views=views, specular=Specular())


def encoder() -> ObjectEncoder:
    return ObjectEncoder(SurfaceTransfer(functions=random(6, len(GRID), 3), grid=GRID), noise=0.01)


def convolutional() -> ConvolutionalAutoencoder:
    torch.manual_seed(0)
    return ConvolutionalAutoencoder().eval().requires_grad_(False)


def convolutional_light() -> AutoencoderLight:
    z = 64
    mean = torch.zeros(z, device="cpu")
    return AutoencoderLight(
        convolutional(),
        latent_mean=mean,
        latent_scale=torch.eye(z, device="cpu") + 0.1 * normal(z, z).float().tril(-1),
        bank=normal(8, z).float(),
        bank_zenith_rad=torch.linspace(0, 1.5, 8, device="cpu"),
        white_centroids=mean.repeat(2, 1),
    )


def shipped() -> nn.Module:
    return load_bundle().light().network


def of_scenes(module: SkyTransport, *given: Tensor) -> Tensor:
    sky = given[0]
    return module(*given, torch.tensor([0, 2, 2], device=sky.device)[: sky.shape[0]])


def latents(_: nn.Module) -> tuple[Tensor]:
    return (0.7 * normal(2, 64),)


def filters() -> FilterBank:
    return FilterBank(normal(4, 16), "random")


def coder(height: int = 8) -> SphericalSparseCoder:
    return SphericalSparseCoder(filters(), height=height, activations=3, banded=True)


CODES = CodeTensors(
    filters=torch.tensor([3, 0, 1]),
    rotations=3 * random(3, 3),
    weights=random(3, 3, seed=1) + 0.5,
    count=torch.tensor(3),
)


@cache
def codes_on(device: torch.device, dtype: torch.dtype) -> CodeTensors:
    filters, rotations, weights, count = (each.to(device) for each in CODES)
    return CodeTensors(filters, rotations.to(dtype), weights, count)


def codes_for(module: SphericalSparseCoder) -> CodeTensors:
    return codes_on(module.bank.unnormalised.device, module.bank.unnormalised.dtype)


def decoded(module: SphericalSparseCoder, weights: Tensor) -> Tensor:
    return module.decode(codes_for(module)._replace(weights=weights))


def refitted(module: SphericalSparseCoder, maps: Tensor) -> Tensor:
    codes = codes_for(module)
    return module.refit(maps, codes._replace(weights=codes.weights.to(maps.dtype))).weights


def light(count: int = len(GRID), *, batch: int = 2) -> Callable[[nn.Module], tuple[Tensor]]:
    return lambda _: (random(batch, count, 3),)


def skies(_: nn.Module) -> tuple[Tensor]:
    """Two with their suns in the centre column."""
    sky = 0.3 + random(2, 32, 128, 3)
    sky[:, 12, 64] += 300
    return (sky,)


TRANSFER = TransferCoefficients(values=random(30, 6, 3).float(), orders=torch.ones(1))
TURNS = TransferCoefficients(values=random(4, 30, 6, 3).float(), orders=torch.ones(1))


def zonal() -> Tensor:
    coefficients = torch.zeros(2, 16, dtype=F64, device="cpu")
    coefficients[:, [0, 2, 6, 12]] = random(2, 4) + 0.1
    return coefficients


CASES: dict[str, Case] = {
    "autoencoder light": Case(
        dtype="single",
        slow=True,
        make=lambda: load_bundle().light(sun_spread_rad=0.025),
        inputs=free,
        float32=5e-5,
    ),
    "autoencoder light, convolutions": Case(
        dtype="single", slow=True, make=convolutional_light, inputs=free
    ),
    "autoencoder light, coarse": Case(
        dtype="single",
        slow_graph=True,
        make=lambda: load_bundle().light(sun_spread_rad=0.025).on_rows(8),
        inputs=free,
        float32=5e-5,
    ),
    "sunsky": Case(dtype="single", make=lambda: SunSky(8), inputs=free, autocast=1e-5, tf32=1e-5),
    "lamps": Case(
        dtype="single", slow_graph=True, make=lambda: LampsLight(2, 8), inputs=free, autocast=1e-5
    ),
    "sphere": Case(
        dtype="single", slow_graph=True, make=lambda: SphereLight(2, 8), inputs=free, autocast=1e-5
    ),
    "harmonics": Case(
        dtype="single",
        make=lambda: HarmonicLight(4, 8),
        inputs=free,
        autocast=1e-5,
        tf32=5 * 2**-10,
    ),
    "gaussians": Case(
        dtype="single",
        slow_graph=True,
        make=lambda: GaussianLobes(3, 8),
        inputs=free,
        autocast=1e-5,
    ),
    "ground": Case(
        make=lambda: LambertianGround(8),
        inputs=lambda _: (random(2, len(SKY), 3), random(2, 3)),
        axis=-2,
    ),
    # a network's encoder adds the roundings of its layers
    "splines, encode": Case(
        host="whether the sun is in the centre",
        dtype="module",
        slow=True,
        make=shipped,
        inputs=skies,
        call=lambda m, x: m.encode(x),
        axis=-2,
        autocast=2**-4,
        tf32=2**-8,
    ),
    "splines, decode": Case(
        dtype="module", slow=True, make=shipped, inputs=latents, call=lambda m, z: m.decode(z)
    ),
    "splines, azimuth": Case(
        dtype="module",
        slow_graph=True,
        make=shipped,
        inputs=lambda _: (0.7 * normal(2, 64), normal(2)),
        call=lambda m, z, azimuth: m.decode_at_azimuth(z, azimuth, 0.025),
    ),
    "convolutions, encode": Case(
        host="whether the sun is in the centre",
        dtype="module",
        slow=True,
        make=convolutional,
        inputs=skies,
        call=lambda m, x: m.encode(x),
        axis=-2,
    ),
    "convolutions, decode": Case(
        dtype="module", slow=True, make=convolutional, inputs=latents, call=lambda m, z: m.decode(z)
    ),
    "convolutions, azimuth": Case(
        dtype="module",
        slow_graph=True,
        make=convolutional,
        inputs=lambda _: (0.7 * normal(2, 64), normal(2)),
        call=lambda m, z, azimuth: m.decode_at_azimuth(z, azimuth, 0.025),
    ),
    "mixture": Case(
        dtype="single",
        make=lambda: load_bundle().prior(),
        inputs=lambda _: (normal(5, 64),),
        call=lambda m, x: m.log_prob(x),
        autocast=1e-5,
    ),
    "prior of lamps": Case(
        dtype="single",
        make=lambda: LampsPrior(2),
        inputs=lambda _: (normal(5, 30),),
        call=lambda m, x: m.log_prob(x),
        autocast=1e-5,
    ),
    "prior of places": Case(
        dtype="single",
        make=lambda: SpherePrior(1),
        inputs=lambda _: (0.5 * normal(5, SpherePrior(1).parameter_count),),
        call=lambda m, x: m.log_prob(x),
        autocast=1e-5,
    ),
    "diffuse transport": Case(make=diffuse, inputs=light(), axis=-2),
    "specular transport": Case(make=specular, inputs=light(), axis=-2),
    "frozen transport": Case(
        make=lambda: specular().freeze(),
        double=lambda: specular().double().freeze(),
        inputs=light(),
        axis=-2,
    ),
    "sky transport": Case(
        make=lambda: SkyTransport(random(1, 40, len(SKY) + 1)),
        inputs=lambda _: (random(2, len(SKY), 3), random(2, 3), random(2, 3)),
        axis=-2,
    ),
    # how many lights a scene has decides what is computed
    "sky transport, scenes": Case(
        host="which light belongs to which scene",
        make=lambda: SkyTransport(random(3, 40, len(SKY) + 1)),
        inputs=lambda _: (random(3, len(SKY), 3), random(3, 3), random(3, 3)),
        call=of_scenes,
        axis=-2,
        meta=False,
        batch=False,
    ),
    "partition probe": Case(
        make=lambda: PartitionProbe(Cells.of(named_design("6d"))),
        inputs=light(),
        call=lambda m, x: m(x, GRID),
        axis=-2,
    ),
    "partition probe, decode": Case(
        make=lambda: PartitionProbe(Cells.of(named_design("6d"))),
        inputs=light(6),
        call=lambda m, x: m.decode(x, GRID),
        axis=-2,
    ),
    # its transfer is solved for on the CPU, wherever the probe is
    "voxel probe": Case(
        slow=True,
        make=lambda: VoxelProbe(star_probe(3), size=2, degree=2).requires_grad_(False),
        inputs=light(),
        call=lambda m, x: m(x, GRID),
        axis=-2,
        meta=False,
    ),
    "object encoder": Case(make=encoder, inputs=light(), axis=-2),
    # the dual has terms of either sign
    "object encoder, decode": Case(
        make=encoder,
        inputs=light(6),
        call=lambda m, x: m.decode(x),
        axis=-2,
        autocast=2**-5,
        tf32=2**-8,
    ),
    "relighting": Case(make=lambda: Relighting(TRANSFER), inputs=light(6), axis=-2),
    "turning relighting": Case(
        make=lambda: TurningRelighting(TURNS),
        inputs=light(6),
        call=lambda m, x: m(x, 0.3),
        axis=-2,
    ),
    # rotated by two quarter turns, products too
    "coder, decode": Case(
        batch=False,
        make=coder,
        inputs=lambda _: (CODES.weights,),
        call=decoded,
        axis=None,
        autocast=2**-6,
        tf32=2**-9,
    ),
    "coder, refit": Case(
        batch=False,
        make=coder,
        inputs=lambda _: (random(8, 16, 3),),
        call=refitted,
        axis=-2,
    ),
    "coder": Case(
        host="what a search takes",
        make=coder,
        inputs=lambda _: (random(8, 16, 3),),
        call=lambda m, x: m.decode(m(x)),
        axis=None,
        transforms=False,
        meta=False,  # the search compares values, and a code is as long as they need
        no_graph="is searched for, which no graph",
        autocast=2**-6,
        tf32=0.25,  # of filters that are alike another may be taken: see the test of the search
    ),
    # harmonics of either sign add up to a filter
    "filters": Case(
        slow_graph=True,
        make=filters,
        inputs=lambda _: (GRID.directions,),
        call=lambda m, x: m.evaluate(x),
        axis=None,
        autocast=2**-6,
        tf32=2**-9,
    ),
    "filters in a cap": Case(
        slow_graph=True,
        make=lambda: CapFilterBank(filters(), [1, 2]),
        inputs=lambda _: (GRID.directions,),
        call=lambda m, x: m.evaluate(x),
        axis=None,
        autocast=2**-6,
        tf32=2**-9,
    ),
    "boxes": Case(
        make=lambda: BoxDictionary(8, 0, 3, sizes=((1, 1), (2, 3))),
        inputs=lambda _: (normal(2, 128),),
        call=lambda m, x: m.correlation.by_group(x)[0],
    ),
    # slots are sums and differences of others
    "slots": Case(
        make=lambda: DirectReconstruction(exposed_faces(star_probe(3)).counts() > 0),
        inputs=lambda _: (random(6, 32, 2, 2, 3),),
        axis=None,
        batch=False,
        autocast=2**-5,
        tf32=2**-8,
    ),
    "correlation": Case(
        dtype="module",
        slow_graph=True,
        make=lambda: RotationCorrelation(normal(3, 16), Positions(rows=4, twists=2)),
        double=lambda: RotationCorrelation(normal(3, 16), Positions(rows=4, twists=2), dtype=F64),
        batch=False,  # as many maps at a time as memory is set aside for
        inputs=lambda _: (normal(2, 16),),
        tf32=2**-9,
    ),
    "zonal correlation": Case(
        dtype="module",
        slow_graph=True,
        make=lambda: ZonalCorrelation(zonal(), Positions(rows=4, twists=1)),
        inputs=lambda _: (normal(2, 16),),
        call=lambda m, x: m.by_group(x)[0],
        autocast=2**-6,
    ),
    "splines on a disk": Case(
        slow_graph=True,
        make=lambda: DiskSplines(10, SKY),
        inputs=lambda m: (normal(2, m.count, 3), normal(2)),
        axis=1,
        autocast=1e-5,
    ),
    "harmonic transform": Case(
        make=lambda: LatLongTransform(4, 8), inputs=lambda _: (normal(2, 8, 16),), autocast=2**-6
    ),
}
# public modules that no case has, and why
NOT_HERE = {
    "ParametricLight": "abstract",
    "SkyNetwork": "abstract",
    "GlobalReconstruction": "of DirectReconstruction's class, with weights that take seconds",
}


def error(found: Tensor, truth: Tensor) -> float:
    """The largest of a value, relative to the value and the mean together."""
    found, truth = (torch.nan_to_num(x.detach().cpu().double(), nan=1e30) for x in (found, truth))
    return float(((found - truth).abs() / (truth.abs() + truth.abs().mean())).max())


class TF32(TorchDispatchMode):
    """Products of float32 as an Ampere GPU makes them where TF32 is allowed, on any device.

    Operands are rounded to eleven significant bits; sums are float32's.
    """

    _products = ("mm", "bmm", "addmm", "baddbmm", "convolution", "addmv", "mv")

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func._schema.name.split("::")[1]
        if name in self._products:
            args = tuple(rounded(x) for x in args)
        return func(*args, **(kwargs or {}))


def rounded(x: Any) -> Any:
    """Float32 numbers, or parts of complex ones, to eleven significant bits, to the nearest."""
    if isinstance(x, Tensor) and x.dtype == torch.complex64:
        return torch.complex(rounded(x.real), rounded(x.imag))
    if not isinstance(x, Tensor) or x.dtype != F32:
        return x
    mantissa, exponent = torch.frexp(x)
    return torch.ldexp((mantissa * 2048).round(), exponent - 11)
