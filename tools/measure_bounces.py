"""How much light bounces between the parts of a head.

    python -m tools.measure_bounces

The mean head, at the vertices of its face that face the camera, under even light from all sides
and under an even sky above a ground of a fifth of its radiance: what bounces once and twice add to
direct shading, relative to it (mean, 95th percentile and largest), for the mean luminance of the
skin prior's albedos and for its lightest mode. And against paths of one bounce, with the lightest
skin: the ratio of the means, and the root mean square difference over that of the bounced light.
"""

import argparse
import time
from pathlib import Path

import torch

from skylight.faces._model import HeadModel, Region
from skylight.faces._observe import BOUNCING_ALBEDO
from skylight.faces._skin import SkinPrior
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._interreflection import BouncingMesh
from skylight.transport._matrix import diffuse_transport
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals
from tools.measured import write_measured

ROWS = 64
PATHS = 4096
EVERY = 20  # of the vertices against paths


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/bounces.json"))
    arguments = parser.parse_args()
    begun = time.time()
    model, prior = HeadModel.load(), SkinPrior.load()
    vertices, faces = torch.from_numpy(model.mean.copy()), torch.from_numpy(model.faces.copy())
    caster, normals = Raycaster(vertices, faces), vertex_normals(vertices, faces)
    seen = torch.from_numpy(model.regions == Region.FACE) & (normals[:, 2] > 0)
    points = vertices[seen], normals[seen]
    direct = diffuse_transport(*points, points[1], caster, DirectionGrid.latlong(ROWS))
    lightest = float(luminance(prior.means).max())
    even = torch.ones(len(direct.grid))
    sky = torch.where(direct.grid.directions[:, 1] > 0, 1.0, 0.2)
    facts: dict[str, object] = {"points": int(seen.sum()), "lightest_albedo": lightest}
    for name, albedo in (("mean", BOUNCING_ALBEDO), ("lightest", lightest)):
        mesh = BouncingMesh(vertices=vertices, faces=faces, raycaster=caster, albedo=albedo)
        for bounces in (1, 2):
            more = mesh.transport(direct, *points, bounces=bounces).matrix - direct.matrix
            for light, radiance in (("even", even), ("sky", sky)):
                share = (more @ radiance) / (direct.matrix @ radiance).clamp(min=1e-6)
                facts[f"{name}_skin_{light}_{bounces}_bounces"] = {
                    "mean": float(share.mean()),
                    "p95": float(share.quantile(0.95)),
                    "largest": float(share.max()),
                }
    facts |= _against_paths(vertices, faces, caster, (points[0][::EVERY], points[1][::EVERY]))
    write_measured(
        arguments.out,
        name="bounces",
        what="Light that bounces between the parts of the mean head, over direct light",
        command="python -m tools.measure_bounces",
        begun=begun,
        facts=facts,
    )


def _against_paths(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    caster: Raycaster,
    points: tuple[torch.Tensor, torch.Tensor],
) -> dict[str, object]:
    albedo = 0.3
    mesh = BouncingMesh(vertices=vertices, faces=faces, raycaster=caster, albedo=albedo, rays=512)
    direct = diffuse_transport(*points, points[1], caster, DirectionGrid.latlong(ROWS))
    light = EnvironmentMap(radiance=torch.ones(ROWS, 2 * ROWS, 3))
    found = (mesh.transport(direct, *points, bounces=1).matrix - direct.matrix) @ light.flat
    scene = DiffuseScene.uniform(vertices, faces, albedo)
    means = [
        shade(
            *points,
            scene,
            light,
            albedo=1.0,
            sampling=Sampling(samples=PATHS, bounces=bounces),
            generator=torch.Generator().manual_seed(0),
        ).mean
        for bounces in (0, 1)
    ]
    true = (means[1] - means[0]).float()
    off = (found - true).square().mean().sqrt() / true.square().mean().sqrt()
    return {"to_paths_mean": float(found.mean() / true.mean()), "to_paths_rms": float(off)}


if __name__ == "__main__":
    main()
