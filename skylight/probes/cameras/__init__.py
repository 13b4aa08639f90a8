"""Cameras: calibration boards, lens and response, merged exposures, live film."""
