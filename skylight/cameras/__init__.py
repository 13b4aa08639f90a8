"""Cameras: calibration, poses from marker boards, response curves, alignment by edges."""
