"""Cameras: calibration, poses from boards in pictures and films, responses, edges, turns."""
