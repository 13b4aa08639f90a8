"""Meshes lit by the probe's cells: transfer, rendering, compositing and export."""
