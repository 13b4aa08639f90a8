"""The partitions probe: designs, printing, capture, relighting."""
