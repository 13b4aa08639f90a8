"""The composite against a path tracer that knows the scene: a person, ground, and an object."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from skylight.faces._model import HeadModel
from skylight.people._independent_render import IndependentScene, Solid
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import Camera
from tests.studio.browser.composite_page import (
    choose,
    click_corners,
    linear,
    moved,
    pixel,
    placement,
    sunlight,
)
from tests.studio.browser.known_light import FAR_EYES, FOCAL, GAINS, HEAD, SIZE
from tests.studio.browser.pictures import FOR_DOCUMENTATION, codes, finished, picture

pytest.importorskip("mitsuba", reason="mitsuba is not installed")
trimesh = pytest.importorskip("trimesh")
pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Page

HALF = 64  # pixels of the crop
SAMPLES = 400
ALBEDO = 0.4  # of the ground


def person() -> list[Solid]:
    """A head, shoulders and a trunk."""
    x, y, z = FAR_EYES
    head = trimesh.creation.icosphere(4)
    head.apply_scale(HEAD)
    head.apply_translation(FAR_EYES)
    shoulders, trunk = trimesh.creation.capsule(0.29, 0.08), trimesh.creation.capsule(1.08, 0.14)
    for part, axis, below in ((shoulders, [0, 1, 0], 0.28), (trunk, [1, 0, 0], 0.92)):
        part.apply_translation(-part.bounds.mean(0))
        part.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, axis))
        part.apply_translation([x, y - below, z - 0.03])
    return [solid(mesh, 0.3) for mesh in (head, shoulders, trunk)]


def solid(mesh: Any, albedo: float) -> Solid:
    return Solid(vertices=np.array(mesh.vertices), triangles=np.array(mesh.faces), albedo=albedo)


def lights() -> dict[str, torch.Tensor]:
    """An even sky, and a sun in a darker one, each over the ground that it lights."""
    grid = DirectionGrid.latlong(64)
    solid_angles = grid.solid_angles.reshape(64, 128)
    even, sunny = torch.full((64, 128, 3), 0.5), torch.full((64, 128, 3), 0.15)
    sunny[18, 100:102] += 1.2 / float(solid_angles[18, 100:102].sum())
    for radiance in (even, sunny):
        sky = radiance.reshape(-1, 3)[: 32 * 128].double()
        irradiance = (grid.directions[:, 1] * grid.solid_angles)[: 32 * 128] @ sky
        radiance[32:] = (ALBEDO / torch.pi * irradiance).float()
    return {"even": even, "sunny": sunny}


def coded(linear_light: np.ndarray) -> np.ndarray:
    return np.rint(codes(linear_light)).astype(np.uint8)


@pytest.mark.parametrize("light", ["even", "sunny"])
@pytest.mark.parametrize("model", ["ball", "box"])
def test_an_object_on_the_ground_looks_as_if_it_had_been_there(
    show: "Callable[..., Page]", light: str, model: str
) -> None:
    """Shading, shadows, returned light: the errors of half and of 99 % of the pixels."""
    radiance = lights()[light]
    ground = FAR_EYES[1] - 1.6
    corners = [[x, ground, z] for x, z in [(-300, 300), (300, 300), (300, -300), (-300, -300)]]
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    floor = Solid(vertices=np.array(corners), triangles=triangles, albedo=ALBEDO)
    row, column = pixel([0.675, ground, FAR_EYES[2]])
    top, left = min(row - HALF, SIZE - 2 * HALF), column - HALF
    crop = np.s_[top : top + 2 * HALF, left : left + 2 * HALF]
    middle = (SIZE / 2 - left, SIZE / 2 - top)
    camera = Camera(focal_px=FOCAL, width=2 * HALF, height=2 * HALF, center_px=middle)

    def traced(*more: Solid) -> np.ndarray:
        scene = IndependentScene([floor, *person(), *more], EnvironmentMap(radiance=radiance))
        return scene.radiance(camera, np.eye(3), np.zeros(3), samples=SAMPLES)

    before = traced()
    photo = np.full((SIZE, SIZE, 3), 128, np.uint8)
    photo[crop] = coded(before)
    estimated = radiance / torch.tensor(GAINS)  # the page gives it the photo's white balance
    estimated[32:] /= 2  # the ground's own light is taken from the photo
    page = show(estimated, eyes=FAR_EYES, photo=photo)
    choose(page, "Object", model)
    choose(page, "Surface", "matte")
    seen = linear(finished(page, 1)[crop][..., :3])

    at = placement(page)
    size = at["size"]
    is_ball = model == "ball"
    shape = trimesh.creation.icosphere(5, size / 2) if is_ball else trimesh.creation.box([size] * 3)
    turn = trimesh.transformations.rotation_matrix(np.radians(at["turnDeg"]), [0, 1, 0])
    shape.apply_transform(turn)
    shape.apply_translation(moved(at["foot"], 0, size / 2, 0))
    error = np.abs(seen - traced(solid(shape, 0.8)).clip(0, 1)) / before.mean()
    assert float(np.quantile(error, 0.5)) < 0.012  # noise of the path tracer, and 8 bits
    assert float(np.quantile(error, 0.99)) < 0.2
    # without the object 3 % of the pixels are wrong by twice as much, and more
    assert float(np.quantile(np.abs(seen - before) / before.mean(), 0.97)) > 0.4


BUST = (-0.19, 0.0, -1.05)  # where its eyes are; its neck stands on the table
TABLE = -0.18
MAT = np.array([0.06, TABLE, -0.98]), 0.3, 0.24, 12.0  # middle, sides, turned by degrees


def painted(mesh: Any, colour: tuple[float, float, float]) -> Solid:
    paint, uv = np.full((1, 1, 3), colour, np.float32), np.zeros((len(mesh.vertices), 2))
    return replace(solid(mesh, 0.0), paint=paint, uv=uv)


def on_a_table(radiance: torch.Tensor, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """A photo of a plaster bust on a table beside a red mat, and the mat's corners."""
    model = HeadModel.load()
    shape = model.vertices(model.average, np.zeros(len(model.expression_names)))
    bust = Solid(vertices=shape + np.array(BUST), triangles=model.faces, albedo=0.6)
    top, mat = trimesh.creation.box([3, 0.04, 1.2]), trimesh.creation.box([MAT[1], 0.002, MAT[2]])
    top.apply_translation([0, TABLE - 0.02, -1.1])
    turn = trimesh.transformations.rotation_matrix(np.radians(MAT[3]), [0, 1, 0])
    mat.apply_transform(turn)
    mat.apply_translation(MAT[0])
    scene = IndependentScene(
        [bust, painted(top, (0.4, 0.27, 0.16)), painted(mat, (0.5, 0.08, 0.06))],
        EnvironmentMap(radiance=radiance),
    )
    camera = Camera(focal_px=FOCAL, width=SIZE, height=SIZE, center_px=(SIZE / 2, SIZE / 2))
    photo = coded(scene.radiance(camera, np.eye(3), np.zeros(3), samples=samples))
    around = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]]) / 2
    corners = around * [MAT[1], 0, MAT[2]] @ turn[:3, :3].T + MAT[0]
    return photo, corners


def test_a_teapot_stands_on_a_mat_whose_corners_are_clicked(
    show: "Callable[..., Page]", pictures: Path
) -> None:
    sky = torch.tensor([0.3, 0.4, 0.55]).expand(64, 128, 3)
    radiance = sky + 0.6 * sunlight(110, 50) * torch.tensor([1.0, 0.9, 0.75])
    photo, corners = on_a_table(radiance, samples=144 if FOR_DOCUMENTATION else 16)
    page = show(radiance / torch.tensor(GAINS), eyes=BUST, photo=photo, color_scheme="light")
    choose(page, "It stands", "rectangle")
    click_corners(page, corners)
    told = page.get_by_text("Tilted by")
    told.wait_for()
    assert float((told.text_content() or "").split()[2].rstrip("°")) <= 2
    side = page.get_by_label("From the first corner to the second, cm")
    side.fill(str(100 * MAT[1]))
    side.blur()
    assert placement(page)["foot"] == pytest.approx(MAT[0], abs=0.02)
    choose(page, "Object", "teapot")
    choose(page, "Surface", "clay")
    seen = finished(page, 1 if FOR_DOCUMENTATION else 1 / 8)[..., :3]
    foot, size = np.array(placement(page)["foot"]), placement(page)["size"]
    # the sun is on the right and behind the camera
    shadow, lit = (
        pixel(moved(foot, -1.3 * size, 0, -0.4 * size)),
        pixel(moved(foot, 0, 0, 1.3 * size)),
    )
    if FOR_DOCUMENTATION:
        section = page.get_by_role("tabpanel", name="Objects")
        picture(section, pictures / "studio_table.png")
    assert linear(seen[shadow]).sum() < 0.7 * linear(photo[shadow]).sum()
    assert linear(seen[lit]).sum() > 0.95 * linear(photo[lit]).sum()
