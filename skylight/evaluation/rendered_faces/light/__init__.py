"""The illumination of rendered faces: skies with a sun of its true size, or given maps."""
