"""Dictionary learning: k-means over patches, and gradient descent through the codes."""
