import inspect
import math

import pytest
import torch
from hypothesis import given, strategies as st

from skylight.errors import InputError
from skylight.sphere import _frame as frame
from skylight.sphere._frame import DirectionGrid

F64 = torch.float64
azimuths = st.floats(-math.pi + 1e-9, math.pi)
zeniths = st.floats(1e-6, math.pi - 1e-6)


def scalar(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=F64)


@pytest.mark.parametrize(
    ("azimuth_deg", "zenith_deg", "axis"),
    [
        (0, 0, (0, 1, 0)),
        (0, 90, (0, 0, -1)),
        (90, 90, (1, 0, 0)),
        (180, 90, (0, 0, 1)),
        (-90, 90, (-1, 0, 0)),
        (0, 180, (0, -1, 0)),
    ],
)
def test_axes(azimuth_deg: float, zenith_deg: float, axis: tuple[int, int, int]) -> None:
    w = frame.direction_from_angles(
        scalar(math.radians(azimuth_deg)), scalar(math.radians(zenith_deg))
    )
    torch.testing.assert_close(w, torch.tensor(axis, dtype=F64), atol=1e-15, rtol=0)


@given(azimuths, zeniths)
def test_angles_there_and_back(azimuth: float, zenith: float) -> None:
    w = frame.direction_from_angles(scalar(azimuth), scalar(zenith))
    a, z = frame.angles_from_direction(w)
    assert w.norm().item() == pytest.approx(1, abs=1e-15)
    assert z.item() == pytest.approx(zenith, abs=1e-12)
    assert math.remainder(a.item() - azimuth, 2 * math.pi) == pytest.approx(0, abs=1e-9)


def test_azimuth_of_a_pole_is_zero() -> None:
    azimuth, zenith = frame.angles_from_direction(torch.tensor([[0.0, 1, 0], [0, -1, 0]]))
    assert azimuth.tolist() == [0, 0]
    assert zenith.tolist() == pytest.approx([0, math.pi])


def test_angles_keep_their_precision_near_the_pole() -> None:
    w = frame.direction_from_angles(scalar(0.3), scalar(1e-7))
    assert frame.angles_from_direction(w)[1].item() == pytest.approx(1e-7, rel=1e-12)


@given(st.floats(0, math.pi))
def test_angle_between_is_accurate_everywhere(angle: float) -> None:
    a = frame.direction_from_angles(scalar(0.0), scalar(0.0))
    b = frame.direction_from_angles(scalar(1.0), scalar(angle))
    assert frame.angle_between(3 * a, 0.1 * b).item() == pytest.approx(angle, abs=1e-14)


def test_angle_between_broadcasts() -> None:
    many = DirectionGrid.latlong(4).directions
    angles = frame.angle_between(many, torch.tensor([0.0, 1.0, 0.0], dtype=F64).expand_as(many))
    torch.testing.assert_close(angles, frame.angles_from_direction(many)[1])


def test_rotation_is_right_handed() -> None:
    x, y, z = torch.eye(3, dtype=F64)
    for axis, start, end in ((x, y, z), (y, z, x), (z, x, y)):
        turned = frame.rotation_about(axis, math.pi / 2) @ start
        torch.testing.assert_close(turned, end, atol=1e-15, rtol=0)


@given(st.floats(-7, 7), st.floats(-7, 7), azimuths, zeniths)
def test_rotations_compose_and_invert(a: float, b: float, azimuth: float, zenith: float) -> None:
    axis = 2.5 * frame.direction_from_angles(scalar(azimuth), scalar(zenith))
    first, second = frame.rotation_about(axis, a), frame.rotation_about(axis, b)
    torch.testing.assert_close(
        first @ second, frame.rotation_about(axis, a + b), atol=1e-13, rtol=0
    )
    torch.testing.assert_close(first.T @ first, torch.eye(3, dtype=F64), atol=1e-13, rtol=0)
    assert torch.linalg.det(first).item() == pytest.approx(1)


@given(azimuths, st.floats(-3, 3))
def test_turning_about_up_lowers_the_azimuth(azimuth: float, angle: float) -> None:
    w = frame.direction_from_angles(scalar(azimuth), scalar(1.0))
    up = torch.tensor([0.0, 1.0, 0.0], dtype=F64)
    turned = frame.angles_from_direction(frame.rotation_about(up, angle) @ w)[0].item()
    assert math.remainder(turned - (azimuth - angle), 2 * math.pi) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(("height", "width"), [(8, 16), (8, 32)])
def test_pixel_centres_are_integers(height: int, width: int) -> None:
    directions = DirectionGrid.latlong(height, width).directions
    row, column = frame.pixel_from_direction(directions, height, width)
    index = torch.arange(height * width)
    torch.testing.assert_close(row, (index // width).double(), atol=1e-12, rtol=0)
    torch.testing.assert_close(column, (index % width).double(), atol=1e-12, rtol=0)


def test_a_shape_that_is_no_map_is_refused() -> None:
    with pytest.raises(InputError, match="100x64"):
        frame.zenith_span(64, 100)


# --- conventions of other programs, each from its own formula for "which way does (u, v) look"


def openexr(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """ImfEnvmap.h: latitude pi/2 (+Y) on top; longitude +pi (left) .. -pi (right), 0 is +Z,
    pi/2 is +X."""
    longitude, latitude = math.pi * (1 - 2 * u), math.pi * (0.5 - v)
    return torch.stack(
        [
            torch.sin(longitude) * torch.cos(latitude),
            torch.sin(latitude),
            torch.cos(longitude) * torch.cos(latitude),
        ],
        -1,
    )


def threejs(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """common.glsl: u = atan(z, x) / 2 pi + 1/2, v = asin(y) / pi + 1/2 from the bottom."""
    phi, elevation = 2 * math.pi * (u - 0.5), math.pi * (0.5 - v)
    flat = torch.cos(elevation)
    return torch.stack([flat * torch.cos(phi), torch.sin(elevation), flat * torch.sin(phi)], -1)


def blender(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Cycles' equirectangular_to_direction: phi = pi (1 - 2 u), +Z up; then (x, z, -y) is +Y up."""
    phi, theta = math.pi * (1 - 2 * u), math.pi * v
    x, y, z = torch.sin(theta) * torch.cos(phi), torch.sin(theta) * torch.sin(phi), torch.cos(theta)
    return torch.stack([x, z, -y], -1)


def mitsuba(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """envmap.cpp: u = atan2(x, -z) / 2 pi, v = acos(y) / pi."""
    phi, theta = 2 * math.pi * u, math.pi * v
    flat = torch.sin(theta)
    return torch.stack([flat * torch.sin(phi), torch.cos(theta), -flat * torch.cos(phi)], -1)


@pytest.mark.parametrize("program", [openexr, threejs, blender, mitsuba])
def test_axis_coloured_map_of_each_program(program) -> None:
    """A map whose colour is the direction it shows becomes ours, and ours becomes it."""
    height, width = 16, 32
    v, u = torch.meshgrid(
        (torch.arange(height, dtype=F64) + 0.5) / height,
        (torch.arange(width, dtype=F64) + 0.5) / width,
        indexing="ij",
    )
    theirs = program(u, v)
    ours = DirectionGrid.latlong(height).directions.reshape(height, width, 3)
    name = program.__name__
    torch.testing.assert_close(
        frame.convert_latlong(theirs, name, "skylight"), ours, atol=1e-12, rtol=0
    )
    torch.testing.assert_close(
        frame.convert_latlong(ours, "skylight", name), theirs, atol=1e-12, rtol=0
    )


def test_conversions_compose() -> None:
    image = torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(0))
    via = frame.convert_latlong(
        frame.convert_latlong(image, "blender", "mitsuba"), "mitsuba", "skylight"
    )
    assert torch.equal(via, frame.convert_latlong(image, "blender", "skylight"))


def test_an_inexact_roll_is_refused() -> None:
    for height, advised in ((1, 2), (3, 2), (5, 4)):
        with pytest.raises(InputError, match=f"{2 * height} columns .* --height {advised}$"):
            frame.convert_latlong(torch.zeros(height, 2 * height, 3), "threejs", "skylight")


def test_an_unknown_convention_is_refused() -> None:
    with pytest.raises(InputError, match="openexr"):
        # the type checker of the tests would stop it first
        inspect.unwrap(frame.centre_azimuth_rad)("maya")  # pyright: ignore


def test_mitsuba_itself_sees_our_axes() -> None:
    """Rays towards the six axes meet the colours that our map has there."""
    mi = pytest.importorskip("mitsuba", reason="mitsuba is not installed")
    if "scalar_rgb" not in mi.variants():
        pytest.skip("this mitsuba has no scalar_rgb variant")
    mi.set_variant("scalar_rgb")
    height = 64
    ours = DirectionGrid.latlong(height).directions.reshape(height, 2 * height, 3)
    coded = frame.convert_latlong((ours + 1) / 2, "skylight", "mitsuba").float().contiguous()
    scene = mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(coded.numpy())},
        }
    )
    emitter = scene.environment()
    for axis in torch.cat([torch.eye(3), -torch.eye(3)]).tolist():
        ray = mi.Ray3f(mi.Point3f(0, 0, 0), mi.Vector3f(*axis))
        seen = emitter.eval(scene.ray_intersect(ray))
        expected = [(a + 1) / 2 for a in axis]
        assert [float(c) for c in seen] == pytest.approx(expected, abs=0.03)
