"""The skin prior against what is known of skin, light and densities."""

import importlib.util
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from scipy.sparse.linalg import eigsh
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from torch import Tensor

from skylight.faces._model import HeadModel, Region
from skylight.faces._skin import MODES, PIGMENT_COLOURS, SkinPrior, pigment_modes
from skylight.imaging._colour import srgb_to_linear
from skylight.models._base import Prior
from skylight.people._skin import skin_albedo

# Monk Skin Tone scale, sRGB, lightest first (skintone.google)
MONK = ("f6ede4", "f3e7db", "f7ead0", "eadaba", "d7bd96", "a07e56", "825c43", "604134", "3a312a",
        "292420")  # fmt: skip
SURFACE = (0.4 / 2.4) ** 2  # what skin of index 1.4 reflects at its surface, head on
# ColorChecker's two skin patches, sRGB under D65 (X-Rite)
PATCHES = ("c29682", "735244")


def albedo_of(codes: tuple[str, ...]) -> Tensor:
    """Linear Rec.709 (n, 3), float64, of sRGB hex codes."""
    values = [[int(code[i : i + 2], 16) for i in (0, 2, 4)] for code in codes]
    return srgb_to_linear(torch.tensor(values, dtype=torch.float64) / 255)


def sigmas(prior: SkinPrior, albedo: Tensor) -> Tensor:
    """Mahalanobis distance in log-albedo to the nearest component."""
    mixture = prior.log_albedo
    offset = albedo.log()[:, None] - mixture.means
    white = torch.einsum("bkp,kpq->bkq", offset, mixture.precision_factors)
    return white.norm(dim=2).min(dim=1).values


@pytest.fixture(scope="module")
def prior() -> SkinPrior:
    return SkinPrior.load()


@pytest.fixture(scope="module")
def samples(prior: SkinPrior) -> Tensor:
    return prior.sample(50_000, torch.Generator().manual_seed(0))


def test_keeps_the_protocol(prior: SkinPrior) -> None:
    assert isinstance(prior, Prior)


def test_density_integrates_to_one(prior: SkinPrior) -> None:
    # importance sampling from one broad log-normal, whose density torch writes
    centre = torch.tensor([0.16, 0.065, 0.032], dtype=torch.float64).log()
    slope = torch.tensor([1.0, 1.25, 1.55], dtype=torch.float64)  # blue falls first
    spread = 0.15 * torch.eye(3, dtype=torch.float64) + 0.7 * slope[:, None] * slope
    proposal = torch.distributions.TransformedDistribution(
        torch.distributions.MultivariateNormal(centre, spread),
        [torch.distributions.ExpTransform()],
    )
    with torch.random.fork_rng():
        torch.manual_seed(0)
        albedo = proposal.sample((400_000,))
    ratio = (prior.log_prob(albedo) - proposal.log_prob(albedo)).exp()
    standard_error = ratio.std() / len(ratio) ** 0.5
    assert standard_error < 0.005
    assert abs(ratio.mean() - 1) < 4 * standard_error


def test_samples_are_albedos_of_skin(samples: Tensor) -> None:
    inside = ((samples > 0) & (samples < 1)).all(dim=1)
    assert inside.double().mean() > 0.999
    red, green, blue = samples.mean(dim=0)
    assert red > green > blue


def test_sampling_repeats(prior: SkinPrior) -> None:
    first, second = (prior.sample(5, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, second)


def test_mean_is_that_of_samples(prior: SkinPrior, samples: Tensor) -> None:
    error = samples.std(0) / len(samples) ** 0.5
    assert (((samples.mean(0) - prior.mean) / error).abs() < 4).all()


def test_means_are_albedos_and_likely(prior: SkinPrior, samples: Tensor) -> None:
    assert ((prior.means > 0) & (prior.means < 1)).all()
    assert (prior.log_prob(prior.means) > prior.log_prob(samples).quantile(0.1)).all()


def test_colorchecker_skin_is_likely(prior: SkinPrior, samples: Tensor) -> None:
    patches = albedo_of(PATCHES) - SURFACE
    for density, at in (
        (prior.log_prob, lambda x: x),
        (prior.log_albedo.log_prob, torch.log),
    ):
        assert (density(at(patches)) > density(at(samples)).quantile(0.01)).all()
    assert (sigmas(prior, patches) < 2).all()


def test_monk_scale(prior: SkinPrior) -> None:
    """Tones 6 to 8 are within 2.5 sigmas, tone 9 within 3.5, tone 5 within 4.5.

    Tones 1 to 4 reflect 71 to 86 % of light, where the lightest of the 100 measured people
    reflects 43 %, and tone 10 reflects less than skin's surface alone: they are colours for
    screens, out of reach for pigment, and 4.5 to 6 sigmas away.
    """
    away = sigmas(prior, albedo_of(MONK))
    assert (away[5:8] < 2.5).all()
    assert away[8] < 3.5
    assert away[4] < 4.5
    assert (away[[0, 1, 2, 3, 9]] < 6).all()


def test_level_over_tones(prior: SkinPrior) -> None:
    # from light to dark along the components' means, per unit of log-albedo
    means = prior.log_albedo.means[prior.log_albedo.means.sum(dim=1).argsort()]
    steps = torch.linspace(0, 1, 9, dtype=means.dtype)[:, None]
    path = torch.cat([torch.lerp(a, b, steps) for a, b in pairwise(means)])
    height = prior.log_albedo.log_prob(path)
    assert height.max() - height.min() < 2.5  # nats


@pytest.mark.parametrize(
    "albedo", [[0.05, 0.4, 0.05], [0.05, 0.1, 0.5], [0.1, 0.3, 0.1], [0.3, 0.4, 0.5]]
)
def test_green_and_blue_are_no_skin(prior: SkinPrior, samples: Tensor, albedo: list[float]) -> None:
    unlikely = prior.log_prob(torch.tensor([albedo], dtype=torch.float64))
    assert unlikely < prior.log_prob(samples).quantile(0.001) - 20


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradient(prior: SkinPrior, dtype: torch.dtype) -> None:
    albedo = torch.tensor([[0.4, 0.25, 0.2], [0.9, 0.1, 0.01], [1e-4, 0, 0.5]], dtype=dtype)
    albedo.requires_grad_()
    value = prior.log_prob(albedo)
    value.sum().backward()
    assert value.dtype == dtype
    assert value.isfinite().all()
    assert albedo.grad.isfinite().all()
    if dtype == torch.float64:
        assert torch.autograd.gradcheck(prior.log_prob, (albedo.detach()[:2].requires_grad_(),))


@cache
def builder() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / "tools" / "build_skin_prior.py"
    spec = importlib.util.spec_from_file_location("build_skin_prior", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


NM = np.arange(380.0, 781.0)


def test_white_reflector_is_white() -> None:
    np.testing.assert_allclose(builder().sensitivities(NM).sum(axis=1), 1, atol=1e-3)


def test_d65_has_its_chromaticity() -> None:
    """x 0.3127, y 0.3290 (CIE 15:2004), within the error of the fitted matching functions."""
    light = np.interp(NM, np.arange(380, 781, 10), builder().D65)
    x, y, z = builder().matching_functions(NM) @ light
    np.testing.assert_allclose([x / (x + y + z), y / (x + y + z)], [0.3127, 0.3290], atol=1e-3)


def test_lasers_are_where_the_standard_observer_sees_them() -> None:
    """CIE 1931 (ISO 11664-1) at 450, 550 and 600 nm, within the fits' 2 % of the peak."""
    table = [[0.3362, 0.0380, 1.7721], [0.4334, 0.9950, 0.0087], [1.0622, 0.6310, 0.0008]]
    ours = builder().matching_functions(np.array([450.0, 550.0, 600.0])).T
    np.testing.assert_allclose(ours, table, atol=0.02)


@pytest.fixture(scope="module")
def inputs(shared_data: Path) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    with np.load(shared_data / "reference" / "nist_skin_reflectance_100.npz") as subjects:
        nm = subjects["wavelength_nm"].astype(np.float64)
        reflectance = subjects["reflectance"].astype(np.float64)
    with np.load(shared_data / "reference" / "chromophore_absorption.npz") as stored:
        return nm, reflectance, dict(stored)


def test_melanin_carries_the_mean_to_the_darkest_person(inputs) -> None:
    nm, reflectance, chromophores = inputs
    tool = builder()
    albedo = reflectance @ tool.sensitivities(nm).T
    darkest = albedo[(albedo @ tool.LUMINANCE).argmin()]
    spectra = tool.melanin(nm, chromophores), tool.blood(nm, chromophores)
    mean = reflectance.mean(axis=0, keepdims=True)
    gap = []
    for amount in np.linspace(0, 5, 200):
        spectrum = tool.with_pigment(mean, amount, spectra[0], 0.0, spectra[1])[0]
        gap.append(np.abs(tool.sensitivities(nm) @ spectrum / darkest - 1).max())
    assert min(gap) < 0.06


def test_tones_are_evenly_spread(inputs) -> None:
    """Each quarter of the range of log-luminance holds 15 to 35 % of the fitted albedos."""
    tool = builder()
    level = np.log(tool.skin_albedos(*inputs) @ tool.LUMINANCE)
    counts, _ = np.histogram(level, bins=np.linspace(*np.quantile(level, [0.01, 0.99]), 5))
    share = counts / counts.sum()
    assert (share > 0.15).all()
    assert (share < 0.35).all()


def test_everyone_measured_is_likely(inputs, prior: SkinPrior) -> None:
    nm, reflectance, _ = inputs
    albedo = torch.from_numpy(reflectance @ builder().sensitivities(nm).T)
    assert sigmas(prior, albedo).max() < 3


def test_shipped_file_is_what_the_builder_makes(inputs, prior: SkinPrior) -> None:
    albedos = builder().skin_albedos(*inputs)
    rebuilt = builder().fit(albedos, seed=0)
    at = torch.from_numpy(np.log(albedos[::10]))
    found, shipped = rebuilt.log_prob(at), prior.log_albedo.log_prob(at)
    # The fit stops where an iteration gains little, so fits of other builds of it differ by a few
    # hundredths where samples are few, and by much less in the likelihood of all.
    torch.testing.assert_close(found, shipped, atol=0.05, rtol=0)
    torch.testing.assert_close(found.mean(), shipped.mean(), atol=1e-3, rtol=0)


CORRELATION_M, SYMMETRY = 0.035, 0.8


@pytest.fixture(scope="module")
def face():
    """(vertices of the face, their shares of its area, the kernel between all of them).

    The kernel of the process less its mean, by the definition, with a node at each vertex.
    """
    model = HeadModel.load()
    on_face = model.regions == Region.FACE
    corners = model.faces[on_face[model.faces].all(1)]
    a, b, c = (model.mean[corners[:, i]] for i in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    area = np.zeros(len(model.mean))
    for i in range(3):
        np.add.at(area, corners[:, i], third)
    points, share = model.mean[on_face], area[on_face] / area[on_face].sum()

    def near(others):
        return np.exp(-cdist(points, others, "sqeuclidean") / (2 * CORRELATION_M**2))

    kernel = near(points) + SYMMETRY * near(points * [-1, 1, 1])
    deviation = np.sqrt(np.diag(kernel))
    kernel /= deviation[:, None] * deviation
    kernel -= share @ kernel  # a field less its mean, in either argument
    kernel -= (kernel @ share)[:, None]
    return points, share, kernel


@pytest.fixture(scope="module")
def modes():
    return pigment_modes()[HeadModel.load().regions == Region.FACE]


def test_modes_are_the_kernel_s_eigenfunctions(face, modes):
    _, share, kernel = face
    root = np.sqrt(share)
    values = eigsh(root[:, None] * kernel * root, k=MODES, return_eigenvectors=False)[::-1]
    overlaps = (modes * share[:, None]).T @ modes
    np.testing.assert_allclose(np.diag(overlaps), values, rtol=0.02)
    lengths = np.sqrt(np.diag(overlaps))
    cosines = overlaps / (lengths[:, None] * lengths)
    np.testing.assert_allclose(cosines, np.eye(MODES), atol=0.02)
    # and kernel f = lambda f
    np.testing.assert_allclose(kernel @ (share[:, None] * modes), modes * values, atol=4e-3)


def test_ten_modes_have_seven_eighths_of_the_variance(face, modes):
    _, share, kernel = face
    variance, kept = np.diag(kernel), (modes**2).sum(1)
    assert 0.86 < float(share @ kept) / float(share @ variance) < 0.89
    assert (kept < variance + 0.01).all()
    # covariances at distances of the correlation length and more come back
    assert np.sqrt(np.mean((modes @ modes.T - kernel) ** 2)) < 0.03


def test_modes_leave_the_mean_of_the_face_to_its_albedo(face, modes):
    _, share, _ = face
    assert np.abs(share @ modes).max() < 5e-3


def test_modes_are_even_or_odd_and_even_ones_come_first(face, modes):
    points, _, _ = face
    _, across = KDTree(points).query(points * [-1, 1, 1])
    parity = (modes[across] * modes).sum(0) / (modes**2).sum(0)
    np.testing.assert_allclose(np.abs(parity), 1, atol=1e-3)
    assert (parity[:5] > 0).all()
    assert (parity < 0).any()


def test_other_things_than_skin_do_not_vary():
    model = HeadModel.load()
    for region in (Region.EYEBALL, Region.MOUTH):
        assert (pigment_modes()[model.regions == region] == 0).all()


def test_colours_are_those_of_computed_skin():
    """Slopes of log albedo over the logs of the two amounts, with green at 1."""
    amounts, step = np.log([0.05, 0.017]), 0.1
    for axis, colour in enumerate(PIGMENT_COLOURS):
        either = np.array([amounts, amounts])
        either[:, axis] += [-step, step]
        less, more = np.log(skin_albedo(*np.exp(either).T))
        np.testing.assert_allclose((more - less) / (more - less)[1], colour, atol=0.02)
