"""Environment maps converted, exported and scored."""
