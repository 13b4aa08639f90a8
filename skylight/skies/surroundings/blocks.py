"""Boxes in plan, and the intervals of elevation through which each column sees them."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.skies.surroundings.view import View


@dataclass(frozen=True, kw_only=True)
class Plan:
    """``n`` rectangles on the ground: where their middles are, half their sides, their turn."""

    azimuth: Float[Tensor, "b n"]
    distance_m: Float[Tensor, "b n"]
    half_m: Float[Tensor, "b n 2"]
    turn: Float[Tensor, "b n"]  # of the first side, from the line of sight's right


@dataclass(frozen=True, kw_only=True)
class Hit:
    """Where the level ray through each part of a column enters and leaves a rectangle.

    ``place`` is where on its side it enters, in metres from the side's middle, ``ridge`` how
    far off it crosses the line through the middle along the first side.
    """

    hit: Bool[Tensor, "b n c"]
    enter: Float[Tensor, "b n c"]
    leave: Float[Tensor, "b n c"]
    ridge: Float[Tensor, "b n c"]
    place: Float[Tensor, "b n c"]
    gable: Bool[Tensor, "b n c"]  # it enters through a second side, across the ridge
    normal: Float[Tensor, "b n c 3"]  # level, of the side through which it enters


def cross(plan: Plan, view: View) -> Hit:
    """Rays against rectangles, by the slab method; rays from inside enter at 0."""
    side = plan.azimuth + plan.turn  # the azimuth that the second axis points to
    away = view.azimuth - side[..., None]
    # along the first axis (90 degrees to the right of the second) and the second
    step = torch.stack([torch.sin(away), torch.cos(away)], -1)
    step = torch.where(step.abs() < 1e-6, 1e-6, step)
    start = plan.distance_m[..., None] * torch.stack(
        [torch.sin(plan.turn), -torch.cos(plan.turn)], -1
    )  # the observer, from the rectangle's middle
    start, half = start[:, :, None], plan.half_m[:, :, None]
    one, other = (-half - start) / step, (half - start) / step
    enters, leaves = torch.minimum(one, other), torch.maximum(one, other)
    enter, axis = enters.max(-1)
    leave = leaves.amin(-1)
    enter = enter.clamp(min=0)
    gable = axis == 0
    at = start + enter[..., None] * step
    sign = -torch.sign(step)
    toward = torch.where(gable, side[..., None] + math.pi / 2, side[..., None].expand_as(enter))
    sign = torch.where(gable, sign[..., 0], sign[..., 1])
    normal = torch.stack([torch.sin(toward), torch.zeros_like(toward), -torch.cos(toward)], -1)
    return Hit(
        hit=leave > enter,
        enter=enter,
        leave=leave,
        ridge=(-start[..., 1] / step[..., 1]).clamp(min=0),
        place=torch.where(gable, at[..., 1], at[..., 0]),
        gable=gable,
        normal=sign[..., None] * normal,
    )
