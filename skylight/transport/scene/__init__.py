"""The evaluation scene: a ball, a ring, a block and a rabbit on grey ground."""
