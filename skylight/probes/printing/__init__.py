"""Printing of probes: thin-walled parts that press together, their checks, files and mount."""
