"""Triangulation of quads and subdivision of long edges."""

import numpy as np
import scipy.sparse as sp


def triangulate(quads: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Split each quad (q, 4) along its shorter diagonal, (2q, 3)."""
    a, b, c, d = quads.T
    # Rounding, so that a quad and its mirror image, equal up to noise, split alike.
    ac = np.linalg.norm(vertices[a] - vertices[c], axis=1).round(7)
    bd = np.linalg.norm(vertices[b] - vertices[d], axis=1).round(7)
    first = np.where((ac <= bd)[:, None], np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where((ac <= bd)[:, None], np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return np.concatenate([first, second])


def subdivide(
    faces: np.ndarray, vertices: np.ndarray, wanted: np.ndarray, longest: float
) -> tuple[np.ndarray, sp.csr_matrix]:
    """Split the edges longer than ``longest`` whose ends are both ``wanted``.

    Returns new faces and the (n', n) matrix of the new vertices as fixed linear combinations of the
    old, so that bases subdivide like positions. A split edge's vertex is placed by the butterfly
    rule (Dyn, Levin, Gregory 1990) without the outer wings where the surface has none: 1/2 the
    ends, +1/8 the opposite corners, -1/16 the four wings.
    """
    corner: dict[tuple[int, int], list[int]] = {}
    for a, b, c in faces.tolist():
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            corner.setdefault((min(i, j), max(i, j)), []).append(k)

    n = len(vertices)
    rows, cols, data = list(range(n)), list(range(n)), [1.0] * n
    middle: dict[tuple[int, int], int] = {}
    for (i, j), opposite in corner.items():
        if not (wanted[i] and wanted[j]):
            continue
        if np.linalg.norm(vertices[i] - vertices[j]) <= longest:
            continue
        weight = {i: 0.5, j: 0.5}
        wings = []
        for k in opposite:
            for e in (i, j):
                others = [o for o in corner[(min(e, k), max(e, k))] if o != (j if e == i else i)]
                wings += others[:1]
        if len(opposite) == 2 and len(wings) == 4:
            for k in opposite:
                weight[k] = weight.get(k, 0.0) + 0.125
            for k in wings:
                weight[k] = weight.get(k, 0.0) - 0.0625
        index = n + len(middle)
        middle[(i, j)] = index
        for k, w in weight.items():
            rows.append(index)
            cols.append(k)
            data.append(w)

    def mid(i: int, j: int) -> int | None:
        return middle.get((min(i, j), max(i, j)))

    out: list[tuple[int, int, int]] = []
    for a, b, c in faces.tolist():
        split = [mid(a, b), mid(b, c), mid(c, a)]
        made = [m is not None for m in split]
        if sum(made) == 0:
            out.append((a, b, c))
            continue
        # Rotate so that the split edges come first (one: ab; two: ab and bc).
        for _ in range(3):
            if made == [True, False, False] or made == [True, True, False] or all(made):
                break
            a, b, c = b, c, a
            split = [mid(a, b), mid(b, c), mid(c, a)]
            made = [m is not None for m in split]
        ab, bc, ca = split
        if all(made):
            out += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        elif made[1]:
            out += [(ab, b, bc), (a, ab, bc), (a, bc, c)]
        else:
            out += [(a, ab, c), (ab, b, c)]
    matrix = sp.csr_matrix((data, (rows, cols)), shape=(n + len(middle), n))
    return np.asarray(out, dtype=np.int64), matrix
