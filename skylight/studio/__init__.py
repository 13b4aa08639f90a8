"""``skylight studio``: a page on this machine that shows light instead of telling it."""
