"""The spherical-partitions probe (thesis, chapter 4): designed, printed, captured, relit."""
