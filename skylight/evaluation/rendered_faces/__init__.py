"""Path-traced people under known illumination, independent of the renderer of skylight.

``batch`` writes folders of them (``skylight faces render``), ``files`` reads them again.
"""
