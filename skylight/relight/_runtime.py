"""Relighting with numpy and onnxruntime alone: torch is never imported here.

What :mod:`skylight.relight._export` wrote is read back: a precomputed scene, the pixels of one
camera and their transport, here, and the sky decoder by :mod:`skylight.relight._decoder`. The few
formulas that the package has in torch too (named at each) are written again in numpy, and the tests
hold the two together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from PIL import Image

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.io._bounded import load_arrays, require_pixels
from skylight.io._hdr import write_exr
from skylight.io._light import read_latlong
from skylight.relight._decoder import SkyDecoder, read_latent

SCENE_FORMAT = "skylight scene 1"
PICTURE_PIXELS_MAX = 2**23  # the largest that is exported has 2880 x 2160
DIRECTIONS_MAX = 2**17  # 256 x 512; 64 x 128 are exported
_TYPES = {
    "pixels": np.uint16,
    "normals": np.float32,
    "albedo": np.float32,
    "on_ground": np.bool_,
    "visible": np.uint8,
    "directions": np.float32,
    "solid_angles": np.float32,
}


@dataclass(frozen=True, kw_only=True)
class PrecomputedScene:
    """What one camera sees of a scene, and which directions light each of its m pixels.

    The transport matrix T[p, w] = V(p, w) <n_p, w>+ dw / pi (thesis, Eq. 5.3) in factors:
    one bit for V instead of a float for T is 32 times smaller, and exact.
    :func:`skylight.relight._runtime.relight` puts T together again, a block of pixels at a time.

    ``visible`` holds V as bits, the n directions of a row packed as :func:`numpy.packbits` does.
    ``directions`` are unit vectors of ``grid_layout``, a full lat-long map, ``solid_angles`` in sr.
    ``pixels`` are (row, column) in a picture of ``layout`` (height, width); ``focal_px`` and
    ``center_px`` (x, y) belong to a camera that looks along -Z. ``on_ground`` marks the pixels
    that take the ground's albedo instead of their own.
    """

    layout: tuple[int, int]
    focal_px: float
    center_px: tuple[float, float]
    pixels: UInt16[np.ndarray, "m 2"]
    normals: Float32[np.ndarray, "m 3"]
    albedo: Float32[np.ndarray, "m 3"]
    on_ground: Bool[np.ndarray, " m"]
    visible: UInt8[np.ndarray, "m bytes"]
    grid_layout: tuple[int, int]
    directions: Float32[np.ndarray, "n 3"]
    solid_angles: Float32[np.ndarray, " n"]

    def __post_init__(self) -> None:
        m, n = len(self.pixels), math.prod(self.grid_layout)
        shapes = {
            "pixels": (m, 2),
            "normals": (m, 3),
            "albedo": (m, 3),
            "on_ground": (m,),
            "visible": (m, math.ceil(n / 8)),
            "directions": (n, 3),
            "solid_angles": (n,),
        }
        for name, shape in shapes.items():
            got = getattr(self, name).shape
            if got != shape:
                raise ValueError(f"{name} must have the shape {shape}, got {got}")
        if m and (self.pixels.min() < 0 or (self.pixels.max(0) >= self.layout).any()):
            raise ValueError(f"pixels must lie in a picture of {self.layout}")

    def save(self, path: str | Path) -> None:
        """Write the scene as a compressed .npz."""
        path = Path(path)
        if path.suffix != ".npz":
            raise InputError(f"{path}: scenes are .npz files; choose a name that ends in .npz")
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        with atomic_path(path) as temporary:
            np.savez_compressed(temporary, format=SCENE_FORMAT, **arrays)


def load_scene(path: str | Path) -> PrecomputedScene:
    """A scene that :meth:`PrecomputedScene.save` wrote; :class:`InputError` for anything else."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such scene; write one with: skylight export scene MESH")
    try:
        names = [field.name for field in fields(PrecomputedScene)]
        arrays: dict[str, Any] = dict(load_arrays(path, ["format", *names]))
        if str(form := arrays.pop("format")) != SCENE_FORMAT:
            raise ValueError(f"format {form}")
        plain = {
            "layout": _whole_numbers(arrays.pop("layout")),
            "focal_px": float(arrays.pop("focal_px")),
            "center_px": tuple(arrays.pop("center_px").tolist()),
            "grid_layout": _whole_numbers(arrays.pop("grid_layout")),
        }
        _require_usable(plain, arrays)
        return PrecomputedScene(**plain, **arrays)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: damaged, or no scene of this version of skylight ({error}); write it again "
            "with: skylight export scene MESH"
        ) from error


def _whole_numbers(array: np.ndarray) -> tuple[int, ...]:
    if array.dtype.kind not in "iu":
        raise ValueError(f"a layout of {array.dtype}")
    return tuple(array.tolist())


def _require_usable(plain: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """ValueError for numbers of the wrong type, that are not finite, or of a huge picture."""
    for name, array in arrays.items():
        if array.dtype != _TYPES[name]:
            raise ValueError(f"{name} holds {array.dtype}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    (height, width), (rows, columns) = plain["layout"], plain["grid_layout"]
    require_pixels(width, height, PICTURE_PIXELS_MAX)
    require_pixels(columns, rows, DIRECTIONS_MAX)
    if columns != 2 * rows:
        raise ValueError(f"{columns} x {rows} directions are no lat-long map")
    if not 0 < plain["focal_px"] < math.inf or not np.isfinite(plain["center_px"]).all():
        raise ValueError("its camera is none")


GROUND_ALBEDO = 0.2  # thesis, B.1: where nothing tells the ground's
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # ITU-R BT.709-6, section 3.3
_BLOCK_ENTRIES = 1 << 23  # of the transport, shaded together: 2 x 34 MB of scratch memory
_BACKGROUND_PIXELS = 1 << 14  # looked up together: 4 MB


def relight(
    scene: PrecomputedScene,
    probe: Float[np.ndarray, "gh gw 3"],
    ground_albedo: Sequence[float] = (GROUND_ALBEDO,) * 3,
) -> Float32[np.ndarray, "h w 3"]:
    """Radiance of each pixel, rho T l (Eq. 5.2), before the probe itself.

    ``probe`` is a full lat-long map of any size: the light is averaged onto the scene's
    directions, the background is seen as it is.
    """
    light = resize(probe, scene.grid_layout[0]).reshape(-1, 3)
    light = (light * (scene.solid_angles[:, None] / np.pi)).astype(np.float32)
    shading = np.empty((len(scene.pixels), 3), np.float32)
    pixels = max(1, _BLOCK_ENTRIES // len(light))
    for start in range(0, len(shading), pixels):
        block = slice(start, start + pixels)
        transport = scene.normals[block] @ scene.directions.T
        np.maximum(transport, 0, out=transport)
        transport *= np.unpackbits(scene.visible[block], axis=1, count=len(light))
        shading[block] = transport @ light
    albedo = np.where(scene.on_ground[:, None], np.asarray(ground_albedo, np.float32), scene.albedo)
    picture = _background(scene, probe)
    picture[scene.pixels[:, 0], scene.pixels[:, 1]] = albedo * shading
    return picture


def relight_files(
    scene: str | Path,
    out: str | Path,
    *,
    probe: str | Path | None = None,
    latent: str | Path | None = None,
    azimuth_deg: float | None = None,
    decoder: str | Path | None = None,
    exposure: float | None = None,
    ground_albedo: float | None = None,
) -> None:
    """A picture of a scene file under a probe, or under the sky of a latent.

    Parameters
    ----------
    out : .png (8-bit sRGB) or .exr (linear).
    probe : .exr or .hdr lat-long map, of the whole sphere or of the sky.
    latent : JSON: as many numbers as the decoder takes, 64 for the one that ships; or an object
        with them as "latent", or with one more as "params", the sun's azimuth in radians (an
        estimate of skylight), and optionally "exposure" and "ground_albedo".
    azimuth_deg : where the latent's sun goes, from straight ahead towards the right; by default
        the file's azimuth, or 0. A probe is turned by this angle.
    exposure : radiance is multiplied by it, and 1 is white in a .png. By default the latent
        file's; without either an .exr keeps the light's own units and a .png is scaled so
        that 2 % of its pixels are white.
    ground_albedo : reflectance of the ground, for its pixels, and for the light it throws back up
        where only the sky is given; by default the latent file's, or 0.2.
    """
    out = Path(out)
    if out.suffix.lower() not in (".png", ".exr"):
        raise InputError(f"{out}: pictures are written as .png or .exr; choose one of them")
    if (probe is None) == (latent is None):
        raise InputError("give either a latent (--latent Z.json) or a probe (--probe X.exr)")
    for name, value in (("azimuth_deg", azimuth_deg), ("exposure", exposure)):
        if value is not None and not math.isfinite(value):
            raise InputError(f"{name} must be a finite number, got {value}")
    if exposure is not None and exposure <= 0:
        raise InputError(f"exposure must be above 0, got {exposure}")
    if ground_albedo is not None and not 0 <= ground_albedo <= 1:
        raise InputError(f"ground_albedo must be from 0 to 1, got {ground_albedo}")
    described = load_scene(scene)
    albedo = (GROUND_ALBEDO if ground_albedo is None else ground_albedo,) * 3
    if latent is not None:
        network = SkyDecoder(decoder)
        sky = read_latent(latent, network.latents)
        exposure = sky.exposure if exposure is None else exposure
        if ground_albedo is None and sky.ground_albedo is not None:
            albedo = sky.ground_albedo
        azimuth_rad = sky.azimuth_rad if azimuth_deg is None else math.radians(azimuth_deg)
        light = network.decode(sky.z[None])[0]
        light = rotate_columns(light, azimuth_rad - network.centre_azimuth_rad)
    else:
        assert probe is not None
        light = rotate_columns(read_probe(probe), math.radians(azimuth_deg or 0.0))
    if light.shape[1] == 4 * light.shape[0]:
        light = add_ground(light, albedo)
    with np.errstate(over="ignore", invalid="ignore"):
        picture = relight(described, light * np.float32(exposure or 1.0), albedo)
    if not np.isfinite(picture).all():
        raise InputError(f"{out} was not written: too bright for float32; lower the exposure")
    with atomic_path(out) as temporary:
        if out.suffix.lower() == ".exr":
            write_exr(temporary, picture, half=False, header={})
        else:
            white = None if exposure is None else 1.0
            Image.fromarray(tone_map(picture, white=white)).save(temporary, format="PNG")


def read_probe(
    path: str | Path, *, layer: str | None = None, repair: bool = False
) -> Float32[np.ndarray, "h w 3"]:
    """Light from a lat-long map of the sphere (w = 2 h) or the sky (w = 4 h).

    The files and options of :func:`skylight.io.read_environment_map`, without torch.
    """
    return read_latlong(Path(path), layer=layer, repair=repair)


def rotate_columns(
    image: Float[np.ndarray, "*b h w c"], azimuth_rad: float
) -> Float[np.ndarray, "*b h w c"]:
    """:func:`skylight.sphere._envmap.shift_columns` in numpy: a turn to the right, circular."""
    shift = azimuth_rad * image.shape[-2] / (2 * math.pi)
    whole = math.floor(shift)
    part = np.asarray(shift - whole, image.dtype)
    moved = np.roll(image, whole, axis=-2)
    return (1 - part) * moved + part * np.roll(moved, 1, axis=-2)


def add_ground(
    sky: Float[np.ndarray, "h w 3"], albedo: Sequence[float]
) -> Float32[np.ndarray, "h2 w 3"]:
    """The full sphere over a Lambertian ground, rho / pi sum_w L(w) <n, w>+ dw (Eq. 5.7).

    :class:`skylight.models._ground.LambertianGround` in numpy.
    """
    cosine = np.cos(np.linspace(0, np.pi / 2, len(sky) + 1))
    weight = -np.diff(cosine**2) * np.pi / sky.shape[1]
    irradiance = weight @ sky.sum(1, dtype=np.float64)
    ground = np.asarray(albedo) / np.pi * irradiance
    return np.concatenate([sky, np.broadcast_to(ground, sky.shape)]).astype(np.float32)


def resize(probe: Float[np.ndarray, "gh gw 3"], height: int) -> Float[np.ndarray, "h w 3"]:
    """:meth:`skylight.sphere._envmap.EnvironmentMap.resize` of full maps in numpy: keeps energy."""
    if len(probe) == height:
        return probe
    rows = _overlap(*(np.cos(np.linspace(np.pi, 0, k + 1)) for k in (len(probe), height)))
    columns = _overlap(*(np.linspace(0, 1, 2 * k + 1) for k in (len(probe), height)))
    return columns @ np.tensordot(rows[::-1, ::-1], probe, 1)


def tone_map(
    radiance: Float[np.ndarray, "h w 3"], *, quantile: float = 0.98, white: float | None = None
) -> UInt8[np.ndarray, "h w 3"]:
    """:func:`skylight.imaging._colour.tone_map` in numpy: round(255 srgb(min(1, L / white)))."""
    if white is None:
        level = np.sort((radiance @ LUMINANCE).ravel())
        white = float(level[max(1, round(quantile * level.size)) - 1]) or float(level[-1])
    linear = np.clip(radiance / max(white, 1e-30), 0, 1)
    # IEC 61966-2-1:1999, 5.2
    curve = 1.055 * linear ** (1 / 2.4) - 0.055
    return np.rint(255 * np.where(linear > 0.0031308, curve, 12.92 * linear)).astype(np.uint8)


def _background(
    scene: PrecomputedScene, probe: Float[np.ndarray, "gh gw 3"]
) -> Float32[np.ndarray, "h w 3"]:
    """The probe through each pixel's centre, bilinear."""
    (height, width), (x0, y0) = scene.layout, scene.center_px
    ahead = scene.focal_px
    rows, columns = probe.shape[:2]
    seen = np.empty((height * width, 3), np.float32)
    for start in range(0, len(seen), _BACKGROUND_PIXELS):
        stop = min(start + _BACKGROUND_PIXELS, len(seen))
        pixel = np.arange(start, stop)
        right, up = pixel % width + 0.5 - x0, y0 - (pixel // width + 0.5)
        azimuth, zenith = np.arctan2(right, ahead), np.arctan2(np.hypot(right, ahead), up)
        row = np.clip(zenith / np.pi * rows - 0.5, 0, rows - 1)
        column = (azimuth / (2 * np.pi) + 0.5) * columns - 0.5
        r, c = np.floor(row).astype(int), np.floor(column).astype(int)
        fr, fc = (row - r)[:, None], (column - c)[:, None]
        r1, c, c1 = np.minimum(r + 1, rows - 1), c % columns, (c + 1) % columns
        top = (1 - fc) * probe[r, c] + fc * probe[r, c1]
        bottom = (1 - fc) * probe[r1, c] + fc * probe[r1, c1]
        seen[start:stop] = (1 - fr) * top + fr * bottom
    return seen.reshape(height, width, 3)


def _overlap(source: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "k l"]:
    """Weights that average the cells with ascending borders ``source`` over ``target``'s."""
    low = np.maximum(source[None, :-1], target[:-1, None])
    high = np.minimum(source[None, 1:], target[1:, None])
    return np.maximum(high - low, 0) / np.diff(target)[:, None]
