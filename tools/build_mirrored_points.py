"""Which of MediaPipe's 478 landmarks is which in a mirror image, for ``skylight.faces``.

    python tools/build_mirrored_points.py canonical_face_model.obj --out skylight/faces/data

The canonical face of MediaPipe (``mediapipe/modules/face_geometry/data``) is symmetric in x, so the
partner of each of its 468 vertices is the one at (-x, y, z). The irises, which it lacks, are five
points each: centre, one side, top, other side, bottom.
"""

import argparse
from pathlib import Path

import numpy as np

from skylight.io._atomic import atomic_path

IRISES = (473, 476, 475, 474, 477, 468, 471, 470, 469, 472)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("face", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    lines = arguments.face.read_text().splitlines()
    vertices = [line.split()[1:4] for line in lines if line.startswith("v ")]
    places = np.array(vertices, dtype=np.float64)
    apart = np.linalg.norm(places[:, None] - places * [-1, 1, 1], axis=2)
    partners = np.array([*apart.argmin(1), *IRISES], dtype=np.int16)
    if len(places) != 468 or apart.min(1).max() > 1e-6:
        raise SystemExit(f"{arguments.face} is not MediaPipe's symmetric face of 468 vertices")
    with atomic_path(arguments.out / "mirrored_points.npy") as path, path.open("wb") as stream:
        np.save(stream, partners)


if __name__ == "__main__":
    main()
