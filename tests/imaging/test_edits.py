"""Saturation and contrast of a picture, against W3C's filters written out in numpy."""

import numpy as np
import pytest
import torch

from skylight.imaging._edits import DISPLAY_GAMMA, Edit, edited, edited_slopes
from skylight.sphere._envmap import LUMINANCE, luminance

EDITS = [(1.4, 1.2), (0.8, 0.85), (1.5, 1.0), (1.0, 1.4)]


def picture(count: int = 50) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.rand(count, 3, generator=generator, dtype=torch.float64) + 0.2


def filtered(shown: np.ndarray, saturation: float, contrast: float, middle: float) -> np.ndarray:
    """``saturate()``, then ``contrast()`` about a middle, of display values."""
    luma = (shown @ np.array(LUMINANCE))[:, None]
    shown = luma + saturation * (shown - luma)
    return middle + contrast * (shown - middle)


@pytest.mark.parametrize(("saturation", "contrast"), EDITS)
@pytest.mark.parametrize("middle", [0.3, 0.5])
def test_an_editors_contrast_about_any_grey_is_one_about_the_pivot_and_an_exposure(
    saturation: float, contrast: float, middle: float
) -> None:
    linear, pivot = picture(), 0.6
    shown = filtered(linear.numpy() ** (1 / DISPLAY_GAMMA), saturation, contrast, middle)
    kept = pivot ** (1 / DISPLAY_GAMMA)  # the pivot's display value, and what becomes of it
    moved = middle + contrast * (kept - middle)
    slope = contrast * kept / moved
    edit = Edit(saturation=saturation * slope, contrast=slope, pivot=pivot)
    exposure = (moved / kept) ** DISPLAY_GAMMA
    want = np.maximum(shown, 0) ** DISPLAY_GAMMA
    np.testing.assert_allclose(exposure * edit.apply(linear).numpy(), want, rtol=1e-10)


@pytest.mark.parametrize(("saturation", "contrast"), EDITS)
def test_what_was_done_can_be_undone(saturation: float, contrast: float) -> None:
    edit = Edit(saturation=saturation, contrast=contrast, pivot=0.7)
    torch.testing.assert_close(edit.undo(edit.apply(picture())), picture())
    assert not torch.allclose(edit.apply(picture()), picture(), rtol=0.02)


def test_saturation_leaves_grey_and_the_pivot_as_they_are() -> None:
    grey = torch.linspace(0.1, 2, 9, dtype=torch.float64)[:, None].expand(-1, 3)
    torch.testing.assert_close(Edit(saturation=1.7).apply(grey), grey)
    at_pivot = torch.full((1, 3), 0.4, dtype=torch.float64)
    torch.testing.assert_close(Edit(contrast=1.6, pivot=0.4).apply(at_pivot), at_pivot)
    darker = Edit(contrast=1.6, pivot=0.4).apply(grey)[:2]
    assert (darker < grey[:2]).all()


def test_display_luma_is_kept_by_saturation() -> None:
    after = Edit(saturation=1.3).apply(picture())
    for before, now in zip(picture(), after, strict=True):
        luma = luminance(before ** (1 / DISPLAY_GAMMA))
        now_luma = luminance(now ** (1 / DISPLAY_GAMMA))
        torch.testing.assert_close(now_luma, luma)


def test_slopes_are_finite_where_an_edit_ends_in_black() -> None:
    linear = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.2, 0.0]]], requires_grad=True)
    numbers = torch.tensor([1.6], requires_grad=True)
    edited(linear, numbers, numbers).sum().backward()
    assert linear.grad is not None
    assert numbers.grad is not None
    assert linear.grad.isfinite().all()
    assert numbers.grad.isfinite().all()


@pytest.mark.parametrize(("saturation", "contrast"), [*EDITS, (1.6, 2.5)])
def test_derivatives_in_closed_form_are_those_of_autograd(
    saturation: float, contrast: float
) -> None:
    """The last edit makes some of the pixels black."""
    linear = picture()[None]
    changes = torch.randn(1, 4, *linear.shape[1:], generator=torch.Generator().manual_seed(1))
    changes = changes.double()
    logs = torch.tensor([saturation, contrast], dtype=torch.float64).log()

    def of(amounts: torch.Tensor) -> torch.Tensor:
        along = (amounts[:4, None, None] * changes[0]).sum(0)
        return edited(linear + along, *(logs + amounts[4:]).exp()[:, None])[0]

    expected = torch.autograd.functional.jacobian(of, torch.zeros(6, dtype=torch.float64))
    slopes, by_edits = edited_slopes(linear, *logs.exp()[:, None])
    found = torch.cat([slopes(changes), by_edits], 1)[0]
    torch.testing.assert_close(found, expected.movedim(2, 0))
    grey = slopes.grey()(changes)[0]
    torch.testing.assert_close(grey, luminance(found[:4])[..., None].expand_as(grey))
    assert contrast < 2 or bool((of(torch.zeros(6, dtype=torch.float64)) == 0).any())
