"""What the pictures of an estimate show."""

import pytest
import torch
from matplotlib.figure import Figure

from skylight.app.report import show_residual
from skylight.faces.observe import FaceView
from skylight.sphere.grid import DirectionGrid
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import GBuffer
from skylight.transport.matrix import TransportMatrix
from skylight.transport.observation import Observation


def test_what_is_brighter_than_an_over_exposed_pixel_is_no_residual():
    count, grid = 4, DirectionGrid.latlong(4)
    places, zeros = torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]]), torch.zeros(4, 3)
    view = FaceView(
        image=torch.ones(2, 2, 3),
        camera=Camera(focal_px=2.0, width=2, height=2, center_px=(1.0, 1.0)),
        surface=GBuffer(
            layout=(2, 2),
            pixels=places,
            positions=zeros,
            origins=zeros,
            normals=zeros,
            geometric_normals=zeros,
            faces=torch.zeros(count, dtype=torch.long),
            barycentric=zeros,
        ),
        used=torch.ones(count, dtype=torch.bool),
        observation=Observation(
            pixels=torch.ones(count, 3),
            weights=torch.ones(count),
            places=places,
            transport=TransportMatrix(matrix=torch.ones(count, len(grid)), grid=grid),
            clipped=torch.tensor([True, True, False, False]),
        ),
    )
    rendered = torch.tensor([1.4, 0.8, 1.4, 0.8])[:, None].expand(-1, 3)
    shown = show_residual(Figure().add_subplot(), view, rendered, "residual").get_array()
    assert shown is not None
    assert shown.flatten().tolist() == pytest.approx([0, -0.2, 0.4, -0.2], abs=1e-5)
