"""A scene lit by a probe's cells as a .glb file: any viewer shows it, and engines can relight it.

The format is described in docs/relightable_glb.md.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import ArrayLike
from torch import Tensor

from skylight.errors import InputError
from skylight.io._atomic import atomic_path
from skylight.probes._unlit_glb import baked_material, write_unlit_glb
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.relight._atlas import Atlas
from skylight.probes.partitions.relight._scene import Scene

KIND, FORMAT = "skylight relightable mesh", 1
_BAKED = "_BAKED"  # trimesh exports colours as bytes only: they travel under another name


@dataclass(frozen=True, kw_only=True, eq=False)
class Baking:
    """The light of the ``probe``'s cells that is baked into a scene, times the ``exposure``.

    A direction w of the probe's frame is ``rotation @ w`` in the scene's.
    """

    probe: PartitionProbe
    rotation: Float[Tensor, "3 3"]
    light: Float[Tensor, "n 3"]
    exposure: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.exposure) and self.exposure > 0):
            raise InputError(f"the exposure must be above 0, got {self.exposure:g}")

    def colours(self, transfer: Float[Tensor, "m n 3"]) -> Float[Tensor, "m 3"]:
        """``exposure sum_i L_i t_i``, linear; what exceeds 1 is clipped."""
        light = self.light.clamp(min=0).float()
        baked = torch.einsum("mnc,nc->mc", transfer.float(), light)
        return (baked * self.exposure).clamp(0, 1)

    def facts(self) -> dict[str, object]:
        """What an engine needs to get the cells' radiance from shading or an environment map."""
        cells, turn = self.probe.cells, self.rotation.double().T
        return {
            "kind": KIND,
            "format": FORMAT,
            "light": self.light.clamp(min=0).tolist(),
            "exposure": self.exposure,
            "design": cells.design.name,
            "seeds": (cells.design.seeds @ turn).tolist(),
            "cell_of_seed": cells.design.labels.tolist(),
            "cell_directions": (cells.normals @ turn).tolist(),
            "cell_solid_angles": cells.solid_angles.tolist(),
            "weights": self.probe.weights.tolist(),
            "kernel_albedo": self.probe.albedo.tolist(),
            "inverse_response": self.probe.inverse.tolist(),
        }


def write_relightable_glb(
    path: Path, scene: Scene, transfer: Float[Tensor, "v n 3"], baking: Baking
) -> None:
    """glTF 2.0 of a ``scene`` in metres: ``COLOR_0`` is the baked light, ``_T0``, ... are ``t_i``.

    All float32, in an unlit material (KHR_materials_unlit).
    """
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    transfer = transfer.float()
    names = [f"_T{i}" for i in range(baking.probe.cells.count)]
    attributes: dict[str, ArrayLike] = {_BAKED: baking.colours(transfer).numpy()}
    attributes |= {name: transfer[:, i].contiguous().numpy() for i, name in enumerate(names)}
    mesh = trimesh.Trimesh(
        scene.vertices.numpy(),
        scene.faces.numpy(),
        vertex_normals=scene.normals.numpy(),
        vertex_attributes=attributes,
        visual=TextureVisuals(material=PBRMaterial(metallicFactor=0.0, doubleSided=True)),
        process=False,
    )
    facts = {"attributes": names, **baking.facts()}

    def finish(tree: dict) -> None:
        (only,) = tree["meshes"]
        only["extras"] = facts
        named = only["primitives"][0]["attributes"]
        named["COLOR_0"] = named.pop(_BAKED)

    write_unlit_glb(path, mesh, normals=True, finish=finish)


def atlas_path(path: Path) -> Path:
    """The file beside a .glb that holds the coefficients of its texels."""
    return path.with_suffix(".atlas.npz")


def write_relightable_atlas(
    path: Path,
    scene: Scene,
    atlas: Atlas,
    transfer: Float[Tensor, "m n 3"],
    baking: Baking,
) -> None:
    """As :func:`write_relightable_glb`, with ``transfer`` of the covered texels of an ``atlas``.

    The baked light is the texture of the .glb, sRGB in 8 bit; :func:`atlas_path` beside it has
    ``transfer`` (n,h,w,3) as float16, ``coverage`` (h,w) and ``extras``, the facts as JSON.
    """
    import trimesh
    from trimesh.visual import TextureVisuals

    baked = atlas.image(baking.colours(transfer))
    vertex, uv, faces = atlas.vertices(scene)
    mesh = trimesh.Trimesh(
        scene.vertices[vertex].numpy(),
        faces.numpy(),
        vertex_normals=scene.normals[vertex].numpy(),
        visual=TextureVisuals(
            uv=uv.numpy(), material=baked_material(Response().encode(baked), two_sided=True)
        ),
        process=False,
    )
    beside = atlas_path(path)
    facts = {"atlas": beside.name, **baking.facts()}

    def finish(tree: dict) -> None:
        (only,) = tree["meshes"]
        only["extras"] = facts

    with atomic_path(beside) as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            transfer=atlas.image(transfer.half()).permute(2, 0, 1, 3).contiguous().numpy(),
            coverage=atlas.covered.numpy(),
            extras=np.array(json.dumps(facts)),
        )
    write_unlit_glb(path, mesh, normals=True, finish=finish)
