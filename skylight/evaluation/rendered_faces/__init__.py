"""Path-traced people under a known light: test faces that our own renderer had no part in.

``batch`` writes folders of them (``skylight faces render``), ``files`` reads them again.
"""
