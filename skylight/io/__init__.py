"""Files: read strictly, written beside their place and moved there."""
