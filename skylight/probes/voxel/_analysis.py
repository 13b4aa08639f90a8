"""How well missing slots follow from known ones, and probes for which they do (thesis, 3.4.4-6).

Residuals are squared norms of composite transfer vectors, ``|tau_u - T^T x|^2`` without a cost of
slots, albedo included. The mean over the 26 other slots of all 169,911 sets of five among 31 is
3.02 for an albedo of 0.8 (thesis: 3.067), the 3-probe's is 2.71 (2.693). The 32nd configuration,
closed all round, is dark: it is never chosen and has no error.

Probes of small reconstruction error are found by beam search (left open in thesis, section 3.4.5):
from one voxel, cells that touch the probe are added, one at a time or, for symmetric probes, in
all its 24 rotations; the best few probes of each size are extended further.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import isfinite

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel._interreflection import (
    ALBEDO,
    GlobalReconstruction,
    slot_transfer,
    transfer_vectors,
)
from skylight.probes.voxel._model import (
    CONFIGURATIONS,
    NORMALS,
    OCCLUDERS,
    ORIENTATIONS,
    VoxelFaces,
    VoxelModel,
    exposed_faces,
    quarter_turns,
)
from skylight.probes.voxel._reconstruct import (
    DirectReconstruction,
    SlotReconstruction,
    occluders_in_words,
    ranks,
)
from skylight.sphere._frame import direction_from_angles
from skylight.transport._rays import Raycaster
from skylight.work._progress import Progress

LIT = CONFIGURATIONS - 1  # the last is dark
EXHAUSTIVE = 7  # configurations in a set: 2.6 million sets
_AT_ONCE = 1024
_DEPENDENT = 1e-9  # of a row's power: what is left of it beside the others of a set


@dataclass(frozen=True, kw_only=True)
class BestSet:
    """Configurations to capture, and the mean squared residual of the other lit ones."""

    configurations: tuple[int, ...]
    residual: float
    exhaustive: bool


@dataclass(frozen=True, kw_only=True)
class TransferError:
    """Mean and standard deviation of ``|t - reconstruction|``, all coefficients of lit slots."""

    mean: float
    std: float

    def __str__(self) -> str:
        return f"{self.mean:.4f} +- {self.std:.4f}"


@dataclass(frozen=True, kw_only=True)
class ProbeReport:
    """What a voxel model encodes: faces of each slot, rank of V, expected errors.

    Errors are None where an orientation has no face at all.
    """

    faces: Int[Tensor, "6 32"]
    rank: Int[Tensor, "6"]
    direct: TransferError | None
    globally: TransferError | None

    @property
    def tractable(self) -> bool:
        """Whether direct light can be reconstructed exactly in all six orientations."""
        return bool((self.rank == len(OCCLUDERS)).all())

    def table(self) -> str:
        """Plain text, one line for each configuration that occurs."""
        lines = [
            "configuration                          " + "".join(f"{o:>5}" for o in ORIENTATIONS)
        ]
        for c in torch.nonzero(self.faces.sum(0))[:, 0].tolist():
            counts = "".join(f"{n:>5}" for n in self.faces[:, c].tolist())
            lines.append(f"{occluders_in_words(c):<39}{counts}")
        lines.append(f"{'rank of V (of 5)':<39}" + "".join(f"{r:>5}" for r in self.rank.tolist()))
        for name, error in (("direct", self.direct), ("global", self.globally)):
            lines.append(f"error of transfer, {name}: {error or 'not all sides have a face'}")
        return "\n".join(lines)


def inspect(model: VoxelModel, *, albedo: float = ALBEDO) -> ProbeReport:
    """Configurations of a model, how often they occur, and errors of their reconstructions."""
    count = exposed_faces(model).counts()
    known = count > 0
    complete = bool(known.any(1).all())
    return ProbeReport(
        faces=count,
        rank=ranks(known),
        direct=transfer_error(DirectReconstruction(known), albedo) if complete else None,
        globally=(
            transfer_error(GlobalReconstruction(known, albedo=albedo), albedo) if complete else None
        ),
    )


def transfer_error(reconstruction: SlotReconstruction, albedo: float = ALBEDO) -> TransferError:
    """L1 error of transfer over the lit slots, captured ones included (thesis, Fig. 3.9)."""
    true = transfer_vectors(albedo).flatten(2)
    error = (reconstruction.weights.double() @ true - true)[:, :LIT].abs()
    return TransferError(mean=float(error.mean()), std=float(error.std()))


def residuals(sets: Int[Tensor, "s k"], *, albedo: float = ALBEDO) -> Float[Tensor, "s 32"]:
    """``min_x |tau_u - T^T x|^2`` of every configuration u from each set of known ones."""
    gram = _gram(albedo)
    return torch.cat([_left(gram, part) for part in sets.split(_AT_ONCE)])


def residuals_by_occluders(*, albedo: float = ALBEDO) -> dict[int, Float[Tensor, " u"]]:
    """Fig. 3.6: {n: residuals of the other slots where all of up to n occluders are known}.

    The dark slot is one of them, so that with four one is left.
    """
    occluders = torch.tensor([c.bit_count() for c in range(CONFIGURATIONS)])
    result = {}
    for most in range(len(OCCLUDERS)):
        known = torch.nonzero(occluders <= most)[:, 0]
        result[most] = residuals(known[None], albedo=albedo)[0, occluders > most]
    return result


def best_sets(
    largest: int = LIT - 1,
    *,
    albedo: float = ALBEDO,
    exhaustive: int = EXHAUSTIVE,
    progress: Progress | None = None,
) -> list[BestSet]:
    """Fig. 3.7: the sets of 1, 2, ... ``largest`` configurations that leave the least residual.

    All sets of up to ``exhaustive`` are tried. Larger ones start from the one before with the best
    addition, and exchange one member for one outside, the best pair at a time, while that helps.
    """
    gram = _gram(albedo)
    found: list[BestSet] = []
    for size in range(1, largest + 1):
        if size <= exhaustive:
            members, left = _exhaustive_best(gram, size)
        else:
            before = found[-1].configurations if found else ()
            members, left = _exchanged(gram, *_grown(gram, before))
        found.append(
            BestSet(
                configurations=tuple(sorted(members)),
                residual=left / (LIT - size),
                exhaustive=size <= exhaustive,
            )
        )
        if progress is not None:
            progress(size / largest)
    return found


def _gram(albedo: float) -> Float[Tensor, "32 32"]:
    rows = slot_transfer(albedo).flatten(1)
    return rows @ rows.T


def _deflated(grams: Float[Tensor, "b n n"], members: Int[Tensor, " b"]) -> Float[Tensor, "b n n"]:
    """Inner products of what one member of each leaves of all rows: its Schur complement."""
    rows = grams[torch.arange(len(grams)), members]
    power = rows.gather(1, members[:, None])
    scaled = rows / power.clamp(min=1e-300)
    return grams - scaled[:, :, None] * rows[:, None, :]


def _left(gram: Float[Tensor, "n n"], sets: Int[Tensor, "b k"]) -> Float[Tensor, "b n"]:
    grams = gram.expand(len(sets), -1, -1)
    for members in sets.T:
        grams = _deflated(grams, members)
    return grams.diagonal(dim1=1, dim2=2).clamp(min=0)


def _left_with_one_more(gram: Tensor, grams: Float[Tensor, "b n n"]) -> Float[Tensor, "b n"]:
    """Total residual where each row in turn joins; infinite for rows that add nothing."""
    power = grams.diagonal(dim1=1, dim2=2)
    gain = grams.square().sum(1) / power.clamp(min=1e-300)
    independent = power > _DEPENDENT * gram.diagonal().clamp(min=_DEPENDENT)
    left = power.sum(1, keepdim=True) - gain
    return torch.where(independent, left, torch.inf)


def _exhaustive_best(gram: Float[Tensor, "n n"], size: int) -> tuple[list[int], float]:
    if size == 1:
        members, left = _grown(gram, ())
        return members, left
    best, lowest = [], torch.inf
    # a set is met once, its members ascending
    rising = torch.ones(len(gram), len(gram), dtype=torch.bool).triu(1)
    number = torch.arange(len(gram))
    for grams, sets in _prefixes(gram, gram[None], torch.zeros(1, 0, dtype=torch.int64), size - 2):
        left = _left_with_two_more(gram, grams)
        allowed = rising.expand_as(left)
        if size > 2:
            allowed = allowed & (number > sets[:, -1:])[:, :, None]
        value, place = torch.where(allowed, left, torch.inf).flatten().min(0)
        if float(value) < lowest:
            lowest = float(value)
            row, pair = divmod(int(place), len(gram) ** 2)
            best = [*sets[row].tolist(), *divmod(pair, len(gram))]
    return best, lowest


def _left_with_two_more(gram: Tensor, grams: Float[Tensor, "b n n"]) -> Float[Tensor, "b n n"]:
    """Total residual where rows i and j join: ``tr G - tr (G_ij,ij^-1 (G G)_ij,ij)``."""
    power = grams.diagonal(dim1=1, dim2=2)
    squares = grams @ grams
    own = squares.diagonal(dim1=1, dim2=2)
    determinant = power[:, :, None] * power[:, None, :] - grams.square()
    gain = power[:, None, :] * own[:, :, None] + power[:, :, None] * own[:, None, :]
    gain = (gain - 2 * grams * squares) / determinant.clamp(min=1e-300)
    scale = gram.diagonal().clamp(min=_DEPENDENT)
    independent = determinant > _DEPENDENT * scale[:, None] * scale
    left = power.sum(1)[:, None, None] - gain
    return torch.where(independent, left, torch.inf)


def _prefixes(
    gram: Tensor, grams: Tensor, sets: Int[Tensor, "b k"], size: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """(deflated Gram matrices, sets) of all ascending sets of ``size``, a batch at a time."""
    if sets.shape[1] == size:
        yield grams, sets
        return
    following = torch.arange(LIT)
    after = following > (sets[:, -1:] if sets.shape[1] else -torch.ones(len(sets), 1))
    # room for the members that are still to come, two after the prefix
    after &= following < LIT - (size - sets.shape[1] + 1)
    for pair in torch.nonzero(after).split(_AT_ONCE):
        row, member = pair.unbind(1)
        extended = torch.cat([sets[row], member[:, None]], 1)
        yield from _prefixes(gram, _deflated(grams[row], member), extended, size)


def _grown(gram: Tensor, members: tuple[int, ...]) -> tuple[list[int], float]:
    """One more, the best."""
    known = torch.tensor([members], dtype=torch.int64)
    grams = gram[None]
    for member in known.T:
        grams = _deflated(grams, member)
    value, place = _left_with_one_more(gram, grams)[0].min(0)
    if not isfinite(float(value)):  # all that is left depends on the members
        place = next(c for c in range(LIT) if c not in members)
        value = grams[0].trace()
    return [*members, int(place)], float(value)


def _exchanged(gram: Tensor, members: list[int], left: float) -> tuple[list[int], float]:
    while True:
        without = [members[:i] + members[i + 1 :] for i in range(len(members))]
        offers = [_grown(gram, tuple(rest)) for rest in without]
        better, value = min(offers, key=lambda offer: offer[1])
        if value >= left * (1 - 1e-9):
            return members, left
        members, left = better, value


_PULLED_IN = 0.1  # of the way from a corner to the face's middle
_GRAZING = 0.15  # cosine below which a face is too oblique to be read


@dataclass(frozen=True, kw_only=True)
class CameraRing:
    """Distant cameras: ``count`` azimuths at each elevation; the lower see what looks down."""

    count: int = 12
    elevations_deg: tuple[float, ...] = (-30.0, 15.0, 35.0, 60.0)

    def directions(self) -> Float[Tensor, "d 3"]:
        """Unit vectors towards the cameras."""
        azimuth = torch.arange(self.count, dtype=torch.float64) * 2 * math.pi / self.count
        zenith = torch.tensor([math.radians(90 - e) for e in self.elevations_deg]).double()
        azimuth, zenith = torch.meshgrid(azimuth, zenith, indexing="ij")
        return direction_from_angles(azimuth, zenith).reshape(-1, 3)


@dataclass(frozen=True, kw_only=True)
class Design:
    """A probe, and its mean squared residual over the lit slots of all orientations."""

    model: VoxelModel
    residual: float


def design_probe(
    voxels: int,
    *,
    size: int = 5,
    symmetric: bool = True,
    beam: int = 8,
    ring: CameraRing | None = None,
    albedo: float = ALBEDO,
) -> Design:
    """The best probe found of up to ``voxels`` cells in a cube of ``size`` cells."""
    if voxels < 1 or size < 1 or size % 2 == 0 or beam < 1:
        raise InputError(
            "a design has 1 voxel or more, an odd grid, and a beam of 1 or more, got "
            f"{voxels}, {size} and {beam}"
        )
    ring = ring or CameraRing()
    seed = np.zeros((size, size, size), bool)
    seed[size // 2, size // 2, size // 2] = True
    layer = [_scored(seed, ring, albedo)]
    best, seen = layer[0], {seed.tobytes()}
    while layer:
        following = []
        for design in layer:
            for grown in _grown_design(design.model.occupied, symmetric):
                if grown.sum() <= voxels and grown.tobytes() not in seen:
                    seen.add(grown.tobytes())
                    following.append(_scored(grown, ring, albedo))
        layer = sorted(following, key=lambda d: d.residual)[:beam]
        best = min([best, *layer], key=lambda d: (d.residual, len(d.model)))
    return Design(model=best.model.cropped(), residual=best.residual)


def probe_residual(
    model: VoxelModel, *, ring: CameraRing | None = None, albedo: float = ALBEDO
) -> float:
    """Mean of ``min |tau_u - T^T x|^2`` over the lit slots, from the faces that the ring sees."""
    faces = exposed_faces(model)
    seen = visible_faces(faces, ring or CameraRing())
    known = torch.zeros(len(ORIENTATIONS), CONFIGURATIONS, dtype=torch.bool)
    known[faces.orientation[seen], faces.configuration[seen]] = True
    known[:, LIT:] = False  # dark: tells nothing
    sets = [torch.nonzero(row).T for row in known]
    return sum(float(residuals(s, albedo=albedo).sum()) for s in sets) / (len(sets) * LIT)


def visible_faces(faces: VoxelFaces, ring: CameraRing) -> Bool[Tensor, " f"]:
    """Faces that one of the cameras at least sees whole: none of the four corners is hidden."""
    caster = Raycaster(*faces.triangles())
    normals = torch.from_numpy(NORMALS[faces.orientation.numpy()]).double()
    middle = faces.corners.mean(1, keepdim=True)
    corners = faces.corners + _PULLED_IN * (middle - faces.corners)
    starts = corners + caster.epsilon * normals[:, None]
    visible = torch.zeros(len(faces), dtype=torch.bool)
    for direction in ring.directions():
        facing = torch.nonzero((normals @ direction > _GRAZING) & ~visible)[:, 0]
        if len(facing):
            hidden = caster.occluded(starts[facing].reshape(-1, 3), direction[None])
            visible[facing] = ~hidden.reshape(-1, 4).any(1)
    return visible


def _scored(occupied: np.ndarray, ring: CameraRing, albedo: float) -> Design:
    model = VoxelModel(occupied=occupied)
    return Design(model=model, residual=probe_residual(model, ring=ring, albedo=albedo))


def _grown_design(occupied: np.ndarray, symmetric: bool) -> Iterator[np.ndarray]:
    """Probes with one more cell beside one of theirs, or with all its turns."""
    turns = quarter_turns() if symmetric else quarter_turns()[:1]
    size, middle = len(occupied), len(occupied) // 2
    for cell in product(range(size), repeat=3):
        if occupied[cell] or not _touches(occupied, np.array(cell)):
            continue
        grown = occupied.copy()
        for turn in turns:
            grown[tuple(turn @ (np.array(cell) - middle) + middle)] = True
        yield grown


def _touches(occupied: np.ndarray, cell: Int[np.ndarray, "3"]) -> bool:
    beside = cell + NORMALS
    beside = beside[((beside >= 0) & (beside < len(occupied))).all(1)]
    return bool(occupied[tuple(beside.T)].any())
