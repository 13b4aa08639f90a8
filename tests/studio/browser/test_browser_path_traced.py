"""The composite against a path tracer that knows the scene: a person, ground, and an object."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from skylight.evaluation.rendered_faces.independent_render import IndependentScene, Solid
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.grid import DirectionGrid
from skylight.transport.camera import Camera
from tests.studio.browser.known_light import FAR_EYES, FOCAL, GAINS, HEAD, SIZE
from tests.studio.browser.pictures import codes, finished
from tests.studio.browser.test_browser_composite import choose, linear, moved, pixel, placement

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
    shoulders = trimesh.creation.capsule(0.29, 0.08)
    shoulders.apply_translation([0, 0, -0.145])
    shoulders.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    shoulders.apply_translation([x, y - 0.28, z - 0.03])
    trunk = trimesh.creation.capsule(1.36 - 0.28, 0.14)
    trunk.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    trunk.apply_translation([x, y - 1.6 + 0.14, z - 0.03])
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
    # the page gives the light the photo's white balance
    page = show(radiance / torch.tensor(GAINS), eyes=FAR_EYES, photo=photo)
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
