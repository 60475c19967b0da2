"""The conditional variational autoencoder, its objective, and the learner that trains it online."""
