"""Relighting with numpy and onnxruntime alone, and light as files of other programs."""
