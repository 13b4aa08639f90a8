"""Skies and precomputed scenes for programs without torch: export here, relight anywhere."""
