"""Relighting with numpy and onnxruntime: precomputed scenes and the sky decoder."""
