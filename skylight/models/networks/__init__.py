"""Neural networks that code skies, and the sun's coordinates among their latents."""
