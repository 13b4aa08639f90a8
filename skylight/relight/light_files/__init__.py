"""A light probe as the files of other programs: one module for each, each with its convention."""
