"""The thesis' tables and figures beside what was measured here, row by row."""
