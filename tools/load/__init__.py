"""Load on the studio: pages of a browser that come, ask and go; memory; the record's table."""
