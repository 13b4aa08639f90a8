"""A scene lit by a probe's cells as one .glb file: any viewer shows it, and engines can relight it.

The format is described in docs/relightable_glb.md.
"""

import math
from io import BytesIO
from pathlib import Path

import torch
from jaxtyping import Float
from numpy.typing import ArrayLike
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.atomic import atomic_path
from skylight.probes.partitions.probe import PartitionProbe
from skylight.probes.partitions.scene import Scene

KIND, FORMAT = "skylight relightable mesh", 1
_BAKED = "_BAKED"  # trimesh exports colours as bytes only: they travel under another name


def write_relightable_glb(
    path: Path,
    scene: Scene,
    transfer: Float[Tensor, "v n 3"],
    light: Float[Tensor, "n 3"],
    *,
    probe: PartitionProbe,
    rotation: Float[Tensor, "3 3"],
    exposure: float = 1.0,
) -> None:
    """glTF 2.0 of a ``scene`` in metres: ``COLOR_0 = exposure sum_i L_i t_i``, and each ``t_i``.

    A direction w of the probe's frame is ``rotation @ w`` in the scene's. Colours are linear,
    float32, in an unlit material (KHR_materials_unlit); what exceeds 1 is clipped.
    """
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if not (math.isfinite(exposure) and exposure > 0):
        raise InputError(f"the exposure must be above 0, got {exposure:g}")
    transfer, light = transfer.float(), light.clamp(min=0)
    baked = torch.einsum("vnc,nc->vc", transfer, light.float()) * exposure
    names = [f"_T{i}" for i in range(probe.cells.count)]
    attributes: dict[str, ArrayLike] = {_BAKED: baked.clamp(0, 1).numpy()}
    attributes |= {name: transfer[:, i].contiguous().numpy() for i, name in enumerate(names)}
    mesh = trimesh.Trimesh(
        scene.vertices.numpy(),
        scene.faces.numpy(),
        vertex_normals=scene.normals.numpy(),
        vertex_attributes=attributes,
        visual=TextureVisuals(material=PBRMaterial(metallicFactor=0.0, doubleSided=True)),
        process=False,
    )
    facts = {
        "kind": KIND,
        "format": FORMAT,
        "attributes": names,
        "light": light.tolist(),
        "exposure": exposure,
        **_probe_facts(probe, rotation),
    }

    def finish(tree: dict) -> None:
        tree["extensionsUsed"] = ["KHR_materials_unlit"]
        for material in tree["materials"]:
            material["extensions"] = {"KHR_materials_unlit": {}}
        (only,) = tree["meshes"]
        only["extras"] = facts
        named = only["primitives"][0]["attributes"]
        named["COLOR_0"] = named.pop(_BAKED)

    buffer = BytesIO()
    mesh.export(buffer, file_type="glb", include_normals=True, tree_postprocessor=finish)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _probe_facts(probe: PartitionProbe, rotation: Float[Tensor, "3 3"]) -> dict[str, object]:
    """What an engine needs to make light of shading, or of a picture of its own surroundings."""
    cells = probe.cells
    return {
        "design": cells.design.name,
        "seeds": (cells.design.seeds @ rotation.double().T).tolist(),
        "cell_of_seed": cells.design.labels.tolist(),
        "cell_directions": (cells.normals @ rotation.double().T).tolist(),
        "cell_solid_angles": cells.solid_angles.tolist(),
        "weights": probe.weights.tolist(),
        "kernel_albedo": probe.albedo.tolist(),
        "inverse_response": probe.inverse.tolist(),
    }
