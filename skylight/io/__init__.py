"""Files of radiance, tensors and records: strict reading, atomic writing."""
