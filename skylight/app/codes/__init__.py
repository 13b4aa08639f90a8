"""Sparse codes of environment maps: encoding, decoding and a figure; files to files."""
