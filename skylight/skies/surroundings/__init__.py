"""What stands between an observer and the sky: land, trees, buildings, roofs."""
