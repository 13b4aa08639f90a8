"""``skylight studio``: a local web application."""
