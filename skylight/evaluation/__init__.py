"""The tables of this project: what is measured, how it is run, how it is written down."""
