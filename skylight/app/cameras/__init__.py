"""Camera calibration, photographs of boards, video and exposures; files to files."""
