"""Simulated days without their clouds."""

from dataclasses import replace

from skylight.skies._simulator import Day


def without_clouds(day: Day) -> Day:
    return replace(day, regime="clear", clouds=())
