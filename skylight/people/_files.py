"""Rendered faces on disk: a folder each, rendered in parallel and resumable."""

import os
import shutil
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import get_args
from uuid import uuid4

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError, OutputError
from skylight.faces._fit import FaceFit
from skylight.imaging._colour import srgb_to_linear
from skylight.imaging._photo import read_codes
from skylight.io._atomic import PARTIAL, atomic_path
from skylight.io._bounded import json_content, load_arrays, write_json
from skylight.io._files import read_environment_map, write_environment_map, write_png
from skylight.io._hdr import HALF_MAX, write_exr
from skylight.io._light import read_linear
from skylight.people._background import BackgroundFacts, BackgroundKind
from skylight.people._independent_render import mitsuba_variant
from skylight.people._light import RenderOptions
from skylight.people._maps import TurnedMap
from skylight.people._render import RenderedFace, render
from skylight.transport._cameras import Camera
from skylight.work._progress import CountProgress
from skylight.work._resumable import Workers, keep_settings, locked, share_work

_FACTS = ("number", "scene", "cluster", "sky_seed", "sun_transmittance", "exposure")
_ARRAYS = ("rotation", "translation", "identity", "expression", "vertices")


def folder_name(number: int) -> str:
    return f"face{number:04d}"


def rendered_faces(directory: Path) -> list[Path]:
    """The faces' folders in ``directory``, in order.

    Raises :class:`InputError` where there are none.
    """
    found = sorted(note.parent for note in directory.glob("face*/face.json"))
    if not found:
        raise InputError(
            f"{directory}: no rendered faces; make some with: "
            f"skylight faces render --out {directory}"
        )
    return found


def write_rendered_face(folder: Path, face: RenderedFace, options: RenderOptions) -> None:
    """picture.png, picture.exr, hair.png, probe.exr, mesh.npz and face.json.

    The mesh is the head model's, in metres and the camera's frame: the camera is at the origin,
    looks along -Z, and +Y is up.
    """
    write_png(folder / "picture.png", face.encoded)
    write_png(folder / "hair.png", np.repeat(face.hair[..., None], 3, 2).astype(np.uint8) * 255)
    fits = float(face.linear.max()) <= HALF_MAX  # a lamp behind somebody may not
    with atomic_path(folder / "picture.exr") as temporary:
        write_exr(temporary, face.linear.numpy(), half=fits, header={})
    write_environment_map(folder / "probe.exr", face.environment)
    arrays = {name: getattr(face.truth, name) for name in _ARRAYS}
    with atomic_path(folder / "mesh.npz") as temporary:
        np.savez_compressed(temporary, landmarks=face.landmarks, **arrays)
    camera = face.truth.camera
    write_json(
        folder / "face.json",
        {name: getattr(face, name) for name in _FACTS}
        | {
            "camera": {"focal_px": camera.focal_px, "center_px": list(camera.center_px)},
            "albedo": face.albedo.tolist(),
            "ground_albedo": _listed(face.ground_albedo),
            "sun_direction": _listed(face.sun_direction),
            "turbidity": face.turbidity,
            "background": None if face.background is None else asdict(face.background),
            "options": options.settings(),
        }
        | _map_facts(face.turned_map),
    )


def read_rendered_face(folder: Path) -> RenderedFace:
    """What :func:`write_rendered_face` wrote.

    Raises :class:`InputError` for a folder that is not complete.
    """
    try:
        facts = json_content(folder / "face.json")
        encoded = read_codes(folder / "picture.png")
        hair = read_codes(folder / "hair.png")[..., 0] > 0
        arrays = load_arrays(folder / "mesh.npz", (*_ARRAYS, "landmarks"))
        height, width = encoded.shape[:2]
        camera = Camera(
            focal_px=facts["camera"]["focal_px"],
            width=width,
            height=height,
            center_px=tuple(facts["camera"]["center_px"]),
        )
        plain = {name: facts[name] for name in _FACTS}
        albedo, ground = torch.tensor(facts["albedo"]), _vector(facts["ground_albedo"])
        sun = _vector(facts["sun_direction"], torch.float64)
        turbidity = facts.get("turbidity")  # faces of simulated skies alone once had none
        turned_map, behind = _turned_map(facts), _background(facts)
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{folder}: no complete rendered face ({error})") from error
    codes = torch.from_numpy(encoded)
    landmarks = arrays.pop("landmarks")
    return RenderedFace(
        encoded=encoded,
        picture=srgb_to_linear(codes.float() / 255),
        clipped=(codes == 255).any(2),
        environment=read_environment_map(folder / "probe.exr"),
        albedo=albedo,
        ground_albedo=ground,
        truth=FaceFit(camera=camera, landmark_error=0.0, converged=True, **arrays),
        linear=torch.from_numpy(read_linear(folder / "picture.exr")),
        landmarks=landmarks,
        hair=hair,
        sun_direction=sun,
        turbidity=turbidity,
        turned_map=turned_map,
        background=behind,
        **plain,
    )


def read_scene_facts(folder: Path) -> tuple[TurnedMap | None, BackgroundFacts | None]:
    """Which given map lights a face and what is behind it, from its facts alone.

    None where a simulated sky lights it, and where the light itself is behind it.

    Raises :class:`InputError` for facts that cannot be read.
    """
    try:
        facts = json_content(folder / "face.json")
        return _turned_map(facts), _background(facts)
    except (OSError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{folder}: no facts of a rendered face ({error})") from error


def _listed(vector: Float[Tensor, "3"] | None) -> list[float] | None:
    return None if vector is None else vector.tolist()


def _vector(listed: list[float] | None, dtype: torch.dtype = torch.float32) -> Tensor | None:
    return None if listed is None else torch.tensor(listed, dtype=dtype)


def _map_facts(turned: TurnedMap | None) -> dict[str, object]:
    if turned is None:
        return {"map": None, "category": None, "turn_deg": None}
    return {"map": turned.file, "category": turned.category, "turn_deg": turned.turn_deg}


def _turned_map(facts: dict) -> TurnedMap | None:
    """None also for faces written before there were maps, whose facts do not mention any."""
    if facts.get("map") is None:
        return None
    return TurnedMap(
        file=facts["map"], category=facts["category"], turn_deg=float(facts["turn_deg"])
    )


def _background(facts: dict) -> BackgroundFacts | None:
    """None also for faces from before there were backgrounds."""
    behind = facts.get("background")
    if behind is None:
        return None
    kind, depth = behind["kind"], behind["depth_m"]
    if kind not in get_args(BackgroundKind):
        raise ValueError(f"no kind of background: {kind}")
    return BackgroundFacts(
        kind=kind,
        depth_m=None if depth is None else float(depth),
        blur_px=float(behind["blur_px"]),
    )


def render_folder(
    out: Path,
    count: int,
    options: RenderOptions,
    *,
    workers: Workers = 1,
    progress: CountProgress | None = None,
) -> int:
    """Render faces 0 to ``count`` - 1 into ``out`` and say how many were made now.

    A face's folder appears when all of it is there, so those that exist are passed over.

    Raises
    ------
    InputError
        ``out`` holds faces made with other options, another run is at work there, or Mitsuba is
        not installed.
    OutputError
        A folder that cannot be written to.
    """
    mitsuba_variant()  # refuses at once where it is not installed
    with locked(out):
        keep_settings(out / "options.json", options.settings())
        missing = [n for n in range(count) if not (out / folder_name(n)).exists()]
        done = count - len(missing)
        if progress:
            progress(done, count)
        work = [(out, number, options) for number in missing]
        for _ in share_work(render_to, work, workers=workers, prepare=_prepare, finish=True):
            done += 1
            if progress:
                progress(done, count)
    return len(missing)


def render_to(out: Path, number: int, options: RenderOptions) -> None:
    """Render one face into its folder, which appears whole or not at all.

    A folder that another process has made meanwhile, which was taken for lost, is left as it is.
    """
    place, partial = out / folder_name(number), out / f"{PARTIAL}{uuid4().hex[:12]}"
    try:
        partial.mkdir()
        write_rendered_face(partial, render(number, options), options)
        try:
            os.replace(partial, place)
        except OSError:
            if not place.is_dir():
                raise
    except OSError as error:
        raise OutputError(f"cannot write {place}: {error.strerror}") from error
    finally:
        with suppress(OSError):
            shutil.rmtree(partial)


def _prepare() -> None:
    mitsuba_variant()
    import drjit

    drjit.set_thread_count(1)  # the processes already share the cores
