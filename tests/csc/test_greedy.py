"""Pursuits against explicit dictionaries: every atom of a small one, as a column of pixels."""

from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import combinations

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from sklearn.linear_model import Lasso, orthogonal_mp

from skylight.csc import _dictionary as dictionary, _greedy as pursuit
from skylight.csc._dictionary import FilterBank
from skylight.csc._greedy import (
    Atom,
    Pursuit,
    PursuitOptions,
    Sign,
    Support,
    exchange,
    exchange_pair,
    pursue,
)
from skylight.csc._least_squares import SampledSignal
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import BoxDictionary, SubDictionary
from skylight.csc._wigner import RotationCorrelation, atom_norms, rotated_filters
from skylight.errors import InputError
from skylight.sphere._latlong_transform import LatLongTransform
from tests.csc.draws import F64, random

DEGREE = ROWS = TWISTS = 8
SIGNS: list[Sign] = ["free", "nonnegative", "l1"]


@dataclass(frozen=True)
class Setting:
    """A dictionary at 8 x 16 places of 8 twists, and maps as large."""

    bank: FilterBank
    rows: int = ROWS
    dtype: torch.dtype = F64

    @cached_property
    def part(self) -> SubDictionary:
        return SubDictionary(self.bank, Positions(rows=self.rows, twists=TWISTS), dtype=self.dtype)

    @cached_property
    def transform(self) -> LatLongTransform:
        return LatLongTransform(self.bank.degree, self.rows)

    @cached_property
    def norms(self) -> list[torch.Tensor]:
        assert isinstance(self.part.plan().correlation, RotationCorrelation)
        return atom_norms(self.part.plan().correlation, self.transform)

    def maps(self, atoms: list[Atom], weights: torch.Tensor) -> torch.Tensor:
        """``sum_j z_j a_j`` at the pixels."""
        turned = self.part.plan().correlation.rotated(
            torch.tensor([a[0] for a in atoms]), torch.tensor([a[1] for a in atoms])
        )
        return self.transform.synthesise((turned.T @ weights).T).movedim(0, -1)

    @cached_property
    def every_column(self) -> np.ndarray:
        places = torch.tensor([place for _, place in self.all_atoms()])
        filters = self.bank.coefficients[[filter_ for filter_, _ in self.all_atoms()]]
        atoms = rotated_filters(filters, self.part.positions.rotations(places)).detach()
        return self.weighted(self.transform.synthesise(atoms).movedim(0, -1))

    def columns(self, atoms: list[Atom]) -> np.ndarray:
        """Atoms in the metric: times the roots of the solid angles."""
        maps = self.maps(atoms, torch.eye(len(atoms), dtype=F64))
        return self.weighted(maps)

    def weighted(self, maps: torch.Tensor) -> np.ndarray:
        return (maps * self.transform.solid_angles.sqrt()[..., None]).flatten(0, 1).numpy()

    def start(self, maps: torch.Tensor, *, norms: bool = False, **options: object) -> Pursuit:
        signal = SampledSignal.of(maps, self.transform)
        choice = PursuitOptions(**options)  # type: ignore[arg-type]
        return Pursuit([self.part], signal, choice, self.norms if norms else None)

    def all_atoms(self) -> list[Atom]:
        """Each once: as many twists as differ, and the constant at one place."""
        found = []
        for filter_ in range(len(self.bank)):
            group, _ = self.part.plan().correlation.index[filter_]
            sizes = (ROWS, 2 * ROWS, self.norms[group].shape[0])
            places = [(0, 0, 0)] if filter_ in self.part.constant else np.ndindex(*sizes)
            found += [(filter_, tuple(int(i) for i in place)) for place in places]
        return found

    def named(self, atoms: list[Atom]) -> list[Atom]:
        """As :meth:`all_atoms` names them."""
        out = []
        for filter_, (row, column, twist) in atoms:
            group, _ = self.part.plan().correlation.index[filter_]
            twist = twist % self.norms[group].shape[0]
            constant = filter_ in self.part.constant
            out.append((filter_, (0, 0, 0) if constant else (row, column, twist)))
        return out


@cache
def setting() -> Setting:
    """The constant, four long lobes, three round ones, and one without symmetry."""
    rows = dictionary.anisotropic(DEGREE, 4).coefficients[[0, 1, 2, 3, 4, 40, 75, 104]]
    fading = torch.exp(-0.3 * torch.arange(81, dtype=F64).sqrt().floor())
    return Setting(FilterBank(torch.cat([rows, random(1, 81) * fading]), "small"))


def atoms_of(code: Support | Pursuit) -> list[Atom]:
    places = code.places.tolist() if isinstance(code, Support) else code.places
    filters = code.filters.tolist() if isinstance(code, Support) else code.filters
    return [(f, (p[0], p[1], p[2])) for f, p in zip(filters, places, strict=True)]


def cost(pursuit_: Pursuit) -> float:
    """What refits minimise: half the squared error, and the L1 norm where there is a penalty."""
    l1 = float(np.abs(pursuit_.weights).sum())
    return 0.5 * pursuit_.support().error + pursuit_.penalty * l1


def assert_error_is_that_of_the_map(it: Setting, maps: torch.Tensor, support: Support) -> None:
    difference = maps - it.maps(atoms_of(support), support.weights)
    brute = float(np.square(it.weighted(difference)).sum())
    energy = float(np.square(it.weighted(maps)).sum())
    assert support.error == pytest.approx(brute, rel=1e-9, abs=1e-13 * energy)


# against sklearn


@pytest.mark.parametrize("seed", range(3))
def test_without_thresholding_it_is_orthogonal_matching_pursuit(seed: int) -> None:
    """Same atoms, in the same order, and the same weights, as sklearn's over all 7,000 atoms."""
    it, maps = setting(), random(ROWS, 2 * ROWS, 1, seed=seed)
    atoms = it.all_atoms()
    columns = it.every_column
    norms = np.linalg.norm(columns, axis=0)
    assert np.ptp(norms) > 0.01  # so that selection has something to normalise
    count = 8
    path = orthogonal_mp(
        columns / norms, it.weighted(maps)[:, 0], n_nonzero_coefs=count, return_path=True
    )
    omp = it.start(maps, norms=True, weights="free", thresholding=False)
    for number in range(count):
        assert omp.step()
        chosen = np.flatnonzero(path[:, number])
        expected = {atoms[i]: path[i, number] / norms[i] for i in chosen}
        found = dict(zip(it.named(atoms_of(omp)), omp.weights[:, 0], strict=True))
        assert found.keys() == expected.keys()
        for atom, weight in found.items():
            assert weight == pytest.approx(expected[atom], rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_nonnegative_weights_are_those_of_nnls(seed: int) -> None:
    it, maps = setting(), random(ROWS, 2 * ROWS, 3, seed=seed) + 1
    search = it.start(maps, weights="nonnegative")
    (support,) = pursue(search, [12])
    assert len(support) == 12
    assert support.weights.min() >= 0
    columns, target = it.columns(atoms_of(support)), it.weighted(maps)
    for colour in range(3):
        expected, _ = nnls(columns, target[:, colour])
        found = support.weights[:, colour].numpy()
        np.testing.assert_allclose(found, expected, atol=1e-9 * expected.max())


@pytest.mark.parametrize("seed", range(3))
def test_l1_weights_are_those_of_lasso(seed: int) -> None:
    """argmin |x - A z|^2 / 2 + penalty |z|_1; sklearn divides the first term by the pixels."""
    it, maps = setting(), random(ROWS, 2 * ROWS, 3, seed=seed)
    search = it.start(maps, weights="l1", penalty=0.05)
    (support,) = pursue(search, [12])
    assert search.penalty > 0.01
    columns, target = it.columns(atoms_of(support)), it.weighted(maps)
    alpha = search.penalty / len(columns)
    lasso = Lasso(alpha=alpha, fit_intercept=False, tol=1e-14, max_iter=1_000_000)
    for colour in range(3):
        expected = lasso.fit(columns, target[:, colour]).coef_
        found = support.weights[:, colour].numpy()
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    free = np.linalg.lstsq(columns, target, rcond=None)[0]
    assert np.abs(support.weights.numpy() - free).max() > 0.02 * np.abs(free).max()


def test_penalty_is_a_share_of_the_largest_correlation() -> None:
    it, maps = setting(), random(ROWS, 2 * ROWS, 1)
    largest = np.abs(it.every_column.T @ it.weighted(maps)).max()
    search = it.start(maps, weights="l1", penalty=0.01)
    assert search.penalty == pytest.approx(0.01 * largest, rel=1e-9)
    assert it.start(maps, weights="free", penalty=0.01).penalty == 0


# laws of every pursuit


@pytest.mark.parametrize("thresholding", [False, True])
@pytest.mark.parametrize("weights", SIGNS)
def test_every_step_adds_one_and_descends(weights: Sign, thresholding: bool) -> None:
    """The error in plain least squares and NNLS; with its penalty under L1."""
    it, maps = setting(), random(ROWS, 2 * ROWS, 3, seed=7) + 0.5
    search = it.start(maps, weights=weights, thresholding=thresholding, penalty=1e-3)
    before = cost(search)
    for count in range(1, 17):
        assert search.step()
        assert len(search.support()) == count
        assert cost(search) < before
        before = cost(search)
        assert_error_is_that_of_the_map(it, maps, search.support())


@pytest.mark.parametrize("weights", SIGNS)
def test_thresholding_descends_where_atoms_are_nearly_alike(weights: Sign) -> None:
    """The largest eigenvalue of such a Gram matrix is nearly three times a unit step's bound.

    Positive light of a high contrast; bounded weights are exchanged many times.
    """
    it = coherent()
    exchanges, stiffest = 0, 0.0
    for seed in range(2):
        maps = (2 * random(ROWS, 2 * ROWS, 2, seed=seed)).exp()
        search = it.start(maps, weights=weights, penalty=1e-3)
        before, held = cost(search), set[Atom]()
        for count in range(1, 21):
            if not search.step():
                break
            now = set(atoms_of(search))
            assert len(now) == len(search.filters) == count
            assert cost(search) <= before * (1 + 1e-12)
            exchanges += len(held - now)
            columns = it.columns(atoms_of(search))
            stiffest = max(stiffest, np.linalg.norm(columns, 2) ** 2)
            before, held = cost(search), now
    assert exchanges > 0 or weights != "nonnegative"
    assert stiffest > 2.5


@pytest.mark.parametrize("weights", SIGNS)
def test_gradient_step_is_bounded(weights: Sign) -> None:
    """Neighbours of one missing lobe do not push out what is right.

    Each correlates more with the residual (about 1) than a held atom weighs (0.5), and a step of 1
    would keep all six and drop five held ones, an energy of 1.25; together they explain 1 at most.
    """
    it = Setting(FilterBank(dictionary.isotropic(12, 40).coefficients[[24]], "one"), rows=12)
    held: list[Atom] = [(0, (2, 3, 0)), (0, (2, 15, 0)), (0, (9, 2, 0)), (0, (9, 8, 0))]
    held.append((0, (9, 20, 0)))
    missing: Atom = (0, (5, 12, 0))
    around = [(5, 12), (5, 11), (5, 13), (6, 12), (6, 11), (6, 13)]
    maps = it.maps([*held, missing], torch.tensor([[0.5]] * 5 + [[1.0]], dtype=F64))
    search = it.start(maps, weights=weights, thresholding=False)
    search.add(held)
    before = cost(search)
    offered: list[Atom] = [(0, (row, column, 0)) for row, column in around]
    gradient = it.columns(offered).T @ it.weighted(
        maps - it.maps(held, torch.from_numpy(search.weights))
    )
    assert gradient.min() > np.abs(search.weights).max()  # a step of 1 is the wrong one
    rotated = search.rotated(offered)
    search.accept(offered, rotated, search.images(rotated))
    assert len(search.filters) == 6
    assert set(held) < set(atoms_of(search))
    assert cost(search) < before


@cache
def coherent() -> Setting:
    """Wide round lobes that hardly differ."""
    rows = dictionary.isotropic(DEGREE, 60).coefficients[10:60:8]
    return Setting(FilterBank(rows, "wide"))


# exchanges


@cache
def three_alike() -> tuple[Setting, torch.Tensor, list[Atom]]:
    """Two lobes near each other, and two weaker ones far off.

    A wide lobe between the two correlates best with their sum, so a greedy search begins with it.
    """
    bank = FilterBank(dictionary.isotropic(12, 40).coefficients[[24, 39]], "iso")
    it = Setting(bank, rows=12)
    atoms: list[Atom] = [(1, (5, 4, 0)), (1, (5, 6, 0)), (1, (6, 16, 0)), (1, (5, 20, 0))]
    weights = torch.tensor([[1.0], [1.0], [0.3], [0.25]], dtype=F64)
    return it, it.maps(atoms, weights), atoms


def test_thresholding_exchanges_what_matching_pursuit_keeps() -> None:
    it, maps, planted = three_alike()
    histories = {}
    for thresholding in (False, True):
        search = it.start(maps, weights="free", thresholding=thresholding)
        steps = []
        for _ in range(4):
            search.step()
            steps.append(set(atoms_of(search)))
        histories[thresholding] = steps, search
    (omp_steps, omp), (htp_steps, htp) = histories[False], histories[True]
    assert omp_steps[0] == htp_steps[0]
    first = next(iter(omp_steps[0]))
    assert first not in planted
    assert first in omp_steps[3]
    assert first not in htp_steps[3]
    assert htp_steps[3] == set(planted)
    assert htp.exact
    assert not omp.exact
    assert htp.support().error < 1e-6 * omp.support().error


def test_sweeps_of_exchanges_mend_a_greedy_code() -> None:
    it, maps, planted = three_alike()
    greedy = it.start(maps, weights="free", thresholding=False)
    list(pursue(greedy, [4]))
    before = greedy.support().error
    assert exchange(greedy) > 0
    assert greedy.support().error < before
    assert len(greedy.filters) == 4
    (swept,) = pursue(it.start(maps, weights="free", thresholding=False, sweeps=20), [4])
    assert set(atoms_of(swept)) == set(planted)
    assert_error_is_that_of_the_map(it, maps, swept)


@pytest.mark.parametrize("weights", SIGNS)
def test_sweeps_never_make_a_code_worse_nor_longer(weights: Sign) -> None:
    it = coherent()
    for seed in range(2):
        maps = random(ROWS, 2 * ROWS, 2, seed=seed).abs()
        search = it.start(maps, weights=weights, norms=True)
        (code,) = pursue(search, [5])
        before = code.error
        for change in (exchange, partial(exchange, refit=True), exchange_pair):
            change(search)
            after = search.support()
            assert after.error <= before * (1 + 1e-9)
            assert len(set(atoms_of(after))) == len(after) == 5
            assert_error_is_that_of_the_map(it, maps, after)
            before = after.error


@pytest.mark.slow
def test_an_exchange_of_a_pair_that_does_not_help_is_undone() -> None:
    it, maps = setting(), random(ROWS, 2 * ROWS, 2, seed=3)
    (code,) = pursue(search := it.start(maps, weights="free", sweeps=30), [5])
    assert not exchange_pair(search)
    after = search.support()
    assert set(atoms_of(after)) == set(atoms_of(code))
    assert after.error == pytest.approx(code.error, rel=1e-9)


def test_best_pair_is_that_of_all_pairs_refitted_one_by_one() -> None:
    it, maps = coherent(), random(ROWS, 2 * ROWS, 2, seed=5)
    search = it.start(maps, weights="free", thresholding=False)
    list(pursue(search, [3]))
    some = search.peaks()[:12]
    assert len(some) == 12
    errors = {}
    for pair in combinations(some, 2):
        columns = it.columns([*search.atoms, *pair])
        _, residual, _, _ = np.linalg.lstsq(columns, it.weighted(maps), rcond=None)
        errors[pair] = residual.sum()
    assert set(search.best_pair(some)) == set(min(errors, key=lambda pair: errors[pair]))


def test_peaks_are_higher_than_what_is_round_them() -> None:
    """Against the correlations of the residual with every atom's column."""
    it, maps = setting(), random(ROWS, 2 * ROWS, 1, seed=6)
    search = it.start(maps, weights="free")
    list(pursue(search, [2]))
    columns, atoms = it.every_column, it.all_atoms()
    residual = it.weighted(maps - it.maps(search.atoms, torch.from_numpy(search.weights)))
    height = dict(zip(atoms, np.abs(columns.T @ residual)[:, 0], strict=True))
    taken = set(it.named(search.atoms))
    found = it.named(search.peaks())
    assert len(found) > 10
    assert not taken & set(found)
    assert found[0] == max(height.keys() - taken, key=lambda atom: height[atom])
    assert [height[a] for a in found] == sorted((height[a] for a in found), reverse=True)
    for atom in found:
        filter_, (row, column, _) = atom
        assert filter_ != 0  # the constant is the same everywhere
        near = [
            height[other]
            for other in atoms
            if other[0] == filter_
            and other not in taken
            and abs(other[1][0] - row) <= 1
            and (other[1][1] - column + 1) % (2 * ROWS) <= 2
        ]
        assert max(near) == pytest.approx(height[atom])


# which atoms


@pytest.mark.parametrize("thresholding", [False, True])
def test_no_activation_comes_twice(thresholding: bool) -> None:
    """Not under another name either: a half-turned lobe, or the constant somewhere else."""
    it, maps = setting(), random(ROWS, 2 * ROWS, 1, seed=2) + 3
    # single precision leaves more of a residual where an atom already is
    single = Setting(it.bank, dtype=torch.float32)
    search = single.start(maps, weights="free", thresholding=thresholding)
    while len(search.filters) < 40 and search.step():
        names = it.named(atoms_of(search))
        assert len(set(names)) == len(names)
    assert len(search.filters) == 40
    assert 0 in search.filters  # the constant is there


@pytest.mark.parametrize(
    "atom", [(0, (3, 3, 3)), (1, (2, 5, 5)), (5, (4, 4, 6)), (8, (4, 4, 6))], ids=str
)
def test_taken_atoms_are_not_found_again_however_strong(atom: Atom) -> None:
    """A penalty of half the correlation leaves half of it: most of what there is."""
    it = setting()
    maps = it.maps([atom], torch.ones(1, 1, dtype=F64))
    search = it.start(maps, weights="l1", penalty=0.5, thresholding=False)
    search.step()
    assert it.named(atoms_of(search)) == it.named([atom])
    # now they may be found, and only they explain it
    search._sets[0].weights[:] = 0
    search._sets[0].penalty = 0.0
    assert search.step()
    names = it.named(atoms_of(search))
    assert len(set(names)) == 2


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("weights", SIGNS)
def test_stops_by_itself_where_everything_is_explained(weights: Sign, dtype: torch.dtype) -> None:
    it = Setting(setting().bank, dtype=dtype)
    atoms: list[Atom] = [(8, (2, 3, 1)), (4, (5, 12, 2))]
    maps = it.maps(atoms, torch.tensor([[1.0, 0.2, 0.5], [0.3, 0.9, 0.1]], dtype=F64))
    search = it.start(maps, weights=weights, penalty=1e-7)
    (code,) = pursue(search, [40])
    # two and, where the penalty takes something off both, a few that nearly stand where they do
    assert len(code) < 12
    assert not search.step()
    assert code.error < 1e-9 * float(np.square(it.weighted(maps)).sum())


def test_negative_light_is_not_coded_by_nonnegative_weights() -> None:
    it = Setting(FilterBank(dictionary.isotropic(DEGREE, 3).coefficients[:1], "constant"))
    maps = torch.full((ROWS, 2 * ROWS, 3), -1.0, dtype=F64)
    (code,) = pursue(it.start(maps, weights="nonnegative"), [3])
    assert len(code) == 0
    (free,) = pursue(it.start(maps, weights="free"), [3])
    assert len(free) == 1


def test_colours_share_their_activations() -> None:
    """One place, three colours of both signs: one activation, weights exact for each."""
    it, atom = setting(), (3, (5, 9, 2))
    colours = torch.tensor([[1.0, -2.0, 0.5]], dtype=F64)
    (code,) = pursue(it.start(it.maps([atom], colours), weights="free"), [8])
    assert it.named(atoms_of(code)) == it.named([atom])
    torch.testing.assert_close(code.weights, colours, rtol=1e-12, atol=0)


def test_selection_follows_the_principal_colour() -> None:
    """Opponent colours, whose mean is black, are seen; a plain sum would miss them."""
    it, atoms = setting(), [(7, (1, 1, 0)), (7, (6, 10, 0))]
    weights = torch.tensor([[1.0, -1.0, 0.0], [0.1, 0.1, 0.1]], dtype=F64)
    (code,) = pursue(it.start(it.maps(atoms, weights), weights="free"), [1])
    assert atoms_of(code) == atoms[:1]


@pytest.mark.parametrize("weights", SIGNS)
def test_several_counts_of_one_run_are_separate_runs(weights: Sign) -> None:
    it, maps = setting(), random(ROWS, 2 * ROWS, 3, seed=4) + 0.5
    counts = [1, 3, 6]
    together = list(pursue(it.start(maps, weights=weights), counts))
    assert [len(code) for code in together] == counts
    for count, code in zip(counts, together, strict=True):
        (alone,) = pursue(it.start(maps, weights=weights), [count])
        assert torch.equal(alone.filters, code.filters)
        assert torch.equal(alone.places, code.places)
        assert torch.equal(alone.weights, code.weights)
        assert alone.error == code.error


def test_progress_ends_at_one() -> None:
    it, seen = setting(), list[float]()
    list(pursue(it.start(random(ROWS, 2 * ROWS, 1), weights="free"), [2, 4], seen.append))
    assert seen == [0.25, 0.5, 0.75, 1.0]


def test_two_layers_are_one_dictionary() -> None:
    """A lamp of one pixel in a smooth room: the pixel part explains it, the lobes the room."""
    it = setting()
    pixel = BoxDictionary(ROWS, len(it.bank), DEGREE)
    room: Atom = (1, (4, 4, 1))
    maps = it.maps([room], torch.ones(1, 3, dtype=F64))
    maps[2, 7] += 30
    signal = SampledSignal.of(maps, it.transform, pixels=True)
    search = Pursuit([it.part, pixel], signal, PursuitOptions(weights="free"))
    (code,) = pursue(search, [2])
    lamp = (len(it.bank), (2, 7, 0))
    assert set(it.named([a for a in atoms_of(code) if a != lamp])) == set(it.named([room]))
    assert lamp in atoms_of(code)
    assert search.exact


def test_room_for_atoms_grows_as_far_as_the_rivals_need(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a weight is 0, rivals are one more than the atoms in use: more than twice as many."""
    it, maps = coherent(), (2 * random(ROWS, 2 * ROWS, 2, seed=0)).exp()
    search = it.start(maps, weights="nonnegative")
    while (np.linalg.norm(search.weights, axis=1) > 0).all():
        assert search.step()
    monkeypatch.setattr(pursuit, "_ROOM", len(search.filters))
    tight = it.start(maps, weights="nonnegative")
    (expected,) = pursue(search, [len(search.filters) + 1])
    (code,) = pursue(tight, [len(expected)])
    assert atoms_of(code) == atoms_of(expected)


def test_unknown_weights_are_refused() -> None:
    """Past the tests' own type checks, which come first."""
    options = object.__new__(PursuitOptions)
    object.__setattr__(options, "weights", "signed")
    with pytest.raises(InputError, match=r"'signed': .* l1, nonnegative, free"):
        options.__post_init__()
