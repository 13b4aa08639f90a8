"""Training of the autoencoder, its priors and dictionaries."""
