"""Environment maps as files of other programs, one module for each."""
