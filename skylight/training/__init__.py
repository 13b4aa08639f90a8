"""Training: one readable loop for the autoencoder, one fit for the priors."""
