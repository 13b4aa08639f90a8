"""Environment maps converted, scored, exported and coded sparsely."""
