"""An estimate as one web page that needs no server and no network."""
