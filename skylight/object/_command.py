"""``skylight estimate-object``: illumination from an object of known shape."""

from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from skylight._names import ObjectLightName
from skylight._options import take_care
from skylight.work._device import Device, choose_device

Decoding = tyro.conf.create_mutex_group(required=False)


def estimate_object(
    mesh: Positional[Path],
    photo: Positional[Path],
    camera: Path,
    light: ObjectLightName = "ani",
    activations: int = 50,
    mask: Path | None = None,
    albedo: str | None = None,
    roughness: float | None = None,
    reflectance: float | None = None,
    bounces: int = 0,
    device: Device = "auto",
    out: Path | None = None,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
) -> None:
    """Recover the light in which an object of known shape was photographed.

    Writes probe.exr and probe.hdr (linear lat-long maps of 64 x 128 pixels in the mesh's world:
    the centre looks along -Z, +X is to its right, +Y up), probe.png (the same to look at),
    estimate.json (all numbers) and comparison.png (the object as seen and as re-rendered, and the
    light).

    Args:
        mesh: .obj, .ply, .glb, .gltf, .stl or .off; its materials are not used.
        photo: Colour picture of the object: JPEG, PNG, TIFF, EXR or Radiance HDR.
        camera: JSON with fov_deg (vertical) or focal_px, and either position, look_at and up (in
            the mesh's world) or world_from_camera (4 x 4; the camera looks along -Z, +Y is up).
        light: Sparse code of anisotropic Gaussians (ani), isotropic ones (iso) or equal lobes
            (vmf), 9, 25 or 49 spherical harmonics, or lamps in ambient light (up to three).
        activations: Most activations of a sparse code.
        mask: Picture of the photo's size, white where the object shows and black elsewhere.
        albedo: Reflectance of the object as R,G,B; by default it is taken to be grey and counts
            as brightness of the light.
        roughness: Roughness of a specular object, 0.25 to 1; without it, the object is diffuse. How
            strong the specular reflection is against the diffuse part depends on --albedo.
        reflectance: Of a specular object, seen head-on; by default 0.04.
        bounces: How often light may bounce between parts of the object; needs --albedo.
        device: Where the light is fitted: on the CPU, by CUDA, or by CUDA where it is.
        out: Folder for the results; by default PHOTO's name with _light, in the current folder.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
    """
    from skylight.imaging._photo import read_photo
    from skylight.object._files import (
        CODES,
        estimate_known_object,
        material_of,
        summarise_object,
        write_object_results,
    )
    from skylight.work._progress import stage_bar
    from skylight.work._resumable import results_folder

    out = out or Path(f"{photo.stem}_light")
    material = material_of(albedo, roughness, reflectance, bounces)
    picture = read_photo(photo, decode="linear" if linear else gamma, require_colour=True)
    choose_device(device)
    with stage_bar() as progress, results_folder(out, CODES) as folder:
        result = estimate_known_object(
            mesh,
            picture,
            camera,
            light=light,
            activations=activations,
            device=device,
            mask=mask,
            material=material,
            progress=progress,
        )
        progress("writing the results", 0.0)
        write_object_results(folder, result, mesh=mesh, photo=photo)
    for advice in result.light.advice:
        take_care(advice)
    print(summarise_object(result))
    code = "" if result.light.code is None else ", code.json"
    files = "probe.exr, probe.hdr, probe.png, estimate.json, comparison.png"
    print(f"written into {out}: {files}{code}")
