"""Training of the sky autoencoder, its priors and dictionaries."""
