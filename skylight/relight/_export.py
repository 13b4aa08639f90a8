"""What :mod:`skylight.relight._runtime` needs, written with torch: the decoder and scenes."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn

from skylight.errors import AssetError, InputError, SkylightError
from skylight.io._atomic import atomic_path
from skylight.io._onnx import onnx_graph
from skylight.models._network import CENTRE_AZIMUTH_RAD, SkyNetwork
from skylight.models._splines import SplineAutoencoder
from skylight.models.autoencoder import AutoencoderLight
from skylight.relight._decoder import SkyDecoder
from skylight.relight._runtime import PrecomputedScene
from skylight.sphere._frame import DirectionGrid, rotation_about
from skylight.transport._cameras import Camera
from skylight.transport._matrix import TransportMatrix, diffuse_transport
from skylight.transport._mesh import creased, read_mesh
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize
from skylight.work._progress import Progress

if TYPE_CHECKING:
    from trimesh import Trimesh

# A sun of kappa 30,000 makes 1e-4 of its radiance from the last bit of its height.
TOLERANCE = 3e-4
# A tenth of the mean luminance; below it differences are absolute. Near 0 relative ones would
# measure rounding: radiance is exp(x) - 1, wrong by 1e-7 in float32 however small it is.
RADIANCE_FLOOR = 0.1
BATCHES = (1, 5, 10)
GRID_HEIGHT = 64  # twice the decoder's rows
_ALBEDO = 0.7  # of meshes, whose materials are not used
EYE_HEIGHT, DISTANCE = 1.6, 3.4  # of the camera, in radii of the mesh's bounding sphere
_BLOCK_PIXELS = 4096  # 134 MB of transport at a time


def export_decoder(light: AutoencoderLight | SkyNetwork, path: str | Path) -> float:
    """Write latent (b, z) -> radiance (b, 32, 128, 3), float32, as an ONNX graph; b is dynamic.

    Before anything is written, onnxruntime decodes batches of 1, 5 and 10 random latents (a light
    model's own Gaussian, otherwise standard normal ones). Returned is the largest difference ::

        |onnx - torch| / max(torch, 0.1)

    over all pixels; above 3e-4 it is a :class:`SkylightError`.
    """
    network = light.network if isinstance(light, AutoencoderLight) else light
    graph = _decoder_graph(network)
    latents = torch.randn(
        sum(BATCHES), network.latents + 1, generator=torch.Generator().manual_seed(0)
    )
    if isinstance(light, AutoencoderLight):
        latents = light.from_free(latents)
    difference = decoder_difference(graph, network, latents[:, :-1])
    # not "difference > TOLERANCE", which lets NaN pass
    if not difference <= TOLERANCE:
        raise SkylightError(
            f"{path} was not written: onnxruntime's skies differ from torch's by {difference:.2g}, "
            f"more than {TOLERANCE:g}; try other versions of torch, onnxscript and onnxruntime"
        )
    with atomic_path(path) as temporary:
        temporary.write_bytes(graph)
    return difference


def decoder_difference(graph: bytes, network: SkyNetwork, latents: Float[Tensor, "b z"]) -> float:
    """``max |onnx - torch| / max(torch, 0.1)``, the latents split into batches of several sizes."""
    try:
        session, worst = SkyDecoder(graph), 0.0
    except AssetError as error:
        reason = error.__cause__
        raise InputError(
            f"{type(network).__name__} makes no decoder that skylight reads ({reason}): "
            "decode by other layers"
        ) from error
    for batch in latents.split(BATCHES):
        with torch.no_grad():
            expected = network.decode(batch).numpy()
        error = np.abs(session.decode(batch.numpy()) - expected)
        # np.maximum keeps a NaN that max() might drop
        worst = float(np.maximum(worst, (error / np.maximum(expected, RADIANCE_FLOOR)).max()))
    return worst


def _decoder_graph(network: SkyNetwork) -> bytes:
    return onnx_graph(
        _Decoder(network),
        {"latent": torch.zeros(2, network.latents)},
        "radiance",
        sizes={"latent": {0: "batch"}},
        metadata={
            "centre_azimuth_rad": repr(CENTRE_AZIMUTH_RAD),
            "radiance": "linear Rec.709, relative: mean luminance about 1",
            "layout": "upper half of a lat-long image, row 0 at the zenith, centre along -Z",
        },
    )


class _Decoder(nn.Module):
    """The network with ``decode`` as its ``forward``, which is what exporters follow."""

    def __init__(self, network: SkyNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, latent: Tensor) -> Tensor:
        if type(self.network).decode_coded is SplineAutoencoder.decode_coded:
            assert isinstance(self.network, SplineAutoencoder)
            return self.network.exportable(latent)  # decode's sparse products are none of ONNX's
        return self.network.decode(latent)


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a mesh stands before the camera: its own up axis, and a turn to the right about it."""

    up: Literal["y", "z"] = "y"
    turn_rad: float = 0.0
    ground: bool = True


def precompute_scene(
    mesh: "str | Path | Trimesh",
    out: str | Path,
    *,
    height: int = 240,
    placement: Placement | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> PrecomputedScene:
    """Write the transport of a mesh that stands on a ground as a scene file, and return it.

    The mesh is scaled to a bounding sphere of radius 1 and seen from 3.4 away and 1.6 above its
    feet in a 4:3 picture of ``height`` rows, with the camera level.

    The ground is an endless plane. It takes the mesh's shadow, but stops no light: from below the
    mesh is lit by the lower half of the probe, which for a sky is the plane's own bounce,
    unshadowed (thesis, Eq. 5.7).

    ``mesh`` is a file that trimesh reads (.obj, .ply, .glb, ...), or a mesh; ``workers`` are those
    of :func:`skylight.transport._matrix.diffuse_transport`.
    """
    if not 16 <= height <= 2160:
        raise InputError(f"height must be from 16 to 2160 rows, got {height}")
    placement = placement or Placement()
    vertices, faces = read_mesh(mesh) if isinstance(mesh, str | Path) else creased(mesh)
    vertices = _placed(vertices, placement)
    camera = Camera(
        focal_px=1.2 * height,
        width=round(4 / 3 * height),
        height=height,
        center_px=(round(4 / 3 * height) / 2, 0.15 * height),
    )
    raycaster = Raycaster(vertices, faces)
    seen = rasterize(camera, vertices, faces, raycaster)
    parts = [(seen.pixels, seen.origins, seen.normals, seen.geometric_normals)]
    if placement.ground:
        parts.append(_ground_seen(camera, seen.pixels))
    pixels, origins, normals, flat = (torch.cat(part) for part in zip(*parts, strict=True))
    if not len(pixels):
        raise InputError("the mesh covers no pixel: it is too thin for this height; raise it")
    grid, visible = DirectionGrid.latlong(GRID_HEIGHT), []
    for start in range(0, len(pixels), _BLOCK_PIXELS):
        block = slice(start, start + _BLOCK_PIXELS)
        transport = diffuse_transport(
            origins[block], normals[block], flat[block], raycaster, grid, workers=workers
        )
        visible.append(pack_visibility(transport))
        if progress is not None:
            progress(min(1.0, (start + _BLOCK_PIXELS) / len(pixels)))
    scene = make_scene(
        camera=camera,
        pixels=pixels,
        normals=normals,
        albedo=torch.full((len(pixels), 3), _ALBEDO),
        on_ground=torch.arange(len(pixels)) >= len(seen),
        visible=np.concatenate(visible),
        grid=grid,
    )
    scene.save(out)
    return scene


def make_scene(
    *,
    camera: Camera,
    pixels: Int[Tensor, "m 2"],
    normals: Float[Tensor, "m 3"],
    albedo: Float[Tensor, "m 3"],
    on_ground: Bool[Tensor, " m"],
    visible: UInt8[np.ndarray, "m bytes"],
    grid: DirectionGrid,
) -> PrecomputedScene:
    """The parts of a scene as the numpy arrays that its file holds."""
    assert grid.layout is not None
    return PrecomputedScene(
        layout=(camera.height, camera.width),
        focal_px=camera.focal_px,
        center_px=camera.center_px,
        pixels=pixels.numpy().astype(np.uint16),
        normals=normals.float().numpy(),
        albedo=albedo.float().numpy(),
        on_ground=on_ground.numpy(),
        visible=visible,
        grid_layout=grid.layout,
        directions=grid.directions.float().numpy(),
        solid_angles=grid.solid_angles.float().numpy(),
    )


def pack_visibility(transport: TransportMatrix) -> UInt8[np.ndarray, "m bytes"]:
    """V(p, w) as bits: where a direction above the horizon of the normal is not blocked."""
    return np.packbits(transport.matrix.numpy() > 0, axis=1)


def _ground_seen(
    camera: Camera, taken: Int[Tensor, "k 2"]
) -> tuple[Int[Tensor, "m 2"], Float[Tensor, "m 3"], Float[Tensor, "m 3"], Float[Tensor, "m 3"]]:
    """Pixels, points and both normals of the plane y = -1.6 below the horizon, where no mesh is."""
    rays = camera.rays()
    below = rays[:, 1] < 0
    below[taken[:, 0] * camera.width + taken[:, 1]] = False
    index = torch.nonzero(below)[:, 0]
    points = rays[index] * (-EYE_HEIGHT / rays[index, 1:2])
    up = torch.tensor([0.0, 1.0, 0.0], dtype=points.dtype).expand_as(points)
    pixels = torch.stack([index // camera.width, index % camera.width], dim=1)
    return pixels, points, up, up


def _placed(vertices: Float[Tensor, "n 3"], placement: Placement) -> Float[Tensor, "n 3"]:
    """The mesh at its place before the camera."""
    if placement.up == "z":
        vertices = torch.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], dim=1)
    # a growing azimuth is a negative angle about +Y
    axis = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    vertices = vertices @ rotation_about(axis, -placement.turn_rad).T
    low, high = vertices.amin(0), vertices.amax(0)
    size = (high - low).norm()
    if not size > 0:
        raise InputError("the mesh has no extent: all its vertices are one point")
    feet = torch.stack([(low + high)[0] / 2, low[1], (low + high)[2] / 2])
    where = torch.tensor([0.0, -EYE_HEIGHT, -DISTANCE], dtype=torch.float64)
    return (vertices - feet) * (2 / size) + where
