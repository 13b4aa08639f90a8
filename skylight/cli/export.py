"""``skylight export`` and ``relight``: light things without torch."""

import math
from pathlib import Path
from typing import Literal

import tyro
from tyro.conf import Positional

export = tyro.extras.SubcommandApp()


@export.command(name="decoder")
def export_decoder(out: Path = Path("sky_decoder.onnx")) -> None:
    """Write the sky decoder as an ONNX graph, checked against torch.

    Args:
        out: The .onnx file.
    """
    from skylight.models.shipped import autoencoder_light
    from skylight.relight.export import export_decoder

    difference = export_decoder(autoencoder_light(), out)
    print(f"{out}: onnxruntime and torch differ by {difference:.1g} at most")


@export.command(name="scene")
def export_scene(
    mesh: Positional[Path],
    out: Path,
    height: int = 240,
    up: Literal["y", "z"] = "y",
    turn: float = 0.0,
    ground: bool = True,
) -> None:
    """Precompute how light reaches a mesh on a ground, for relighting it anywhere.

    Args:
        mesh: .obj, .ply, .glb, .gltf, .stl or .off; its materials are not used.
        out: The .npz file.
        height: Rows of the picture, which is 4:3.
        up: The mesh's own up axis.
        turn: Turn of the mesh to the right about that axis, degrees.
        ground: Whether there is a ground that takes the mesh's shadow.
    """
    from skylight.app.progress import stage_bar
    from skylight.relight.export import Placement, precompute_scene

    placement = Placement(up=up, turn_rad=math.radians(turn), ground=ground)
    with stage_bar() as progress:
        scene = precompute_scene(
            mesh,
            out,
            height=height,
            placement=placement,
            progress=lambda share: progress("tracing light", share),
        )
    print(f"{out}: {len(scene.pixels)} pixels lit from {len(scene.directions)} directions")


def relight(
    scene: Positional[Path],
    out: Path,
    probe: Path | None = None,
    latent: Path | None = None,
    azimuth: float | None = None,
    decoder: Path | None = None,
    exposure: float | None = None,
    ground_albedo: float | None = None,
) -> None:
    """Light a precomputed scene, by a probe or by the sky of a latent; needs no torch.

    Args:
        scene: .npz file that `skylight export scene` wrote.
        out: Picture to write: .png (8-bit sRGB) or .exr (linear).
        probe: Light as an .exr or .hdr lat-long map, such as an estimate's probe.exr.
        latent: Light as JSON: 64 latents, or an estimate's estimate.json.
        azimuth: Where the latent's sun goes, or how far a probe is turned: degrees to the right.
        decoder: .onnx file that `skylight export decoder` wrote; by default the one shipped.
        exposure: Factor on radiance, with 1 as white.
        ground_albedo: Reflectance of the ground, from 0 to 1.
    """
    from skylight.relight.runtime import relight_files

    relight_files(
        scene,
        out,
        probe=probe,
        latent=latent,
        azimuth_deg=azimuth,
        decoder=decoder,
        exposure=exposure,
        ground_albedo=ground_albedo,
    )
    print(out)
