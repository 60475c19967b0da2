"""C kernels for the convolutions of the model on CPUs."""
