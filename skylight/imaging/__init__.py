"""Files in and out, colour, and scores."""
