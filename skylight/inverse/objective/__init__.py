"""The objective of inverse lighting (thesis, Eq. 5.8): its faces, weights and starts."""
