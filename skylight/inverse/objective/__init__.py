"""The objective of inverse lighting (thesis, Eq. 5.8), for any light model."""
