"""The thesis' tables and others: what is measured, how it is run and written."""
