"""Compiled kernels for training and inference on the CPU.

Entry points: `library.load_kernels`, `loss.NativeLoss` (training) and `convolutions.NativeConvolutions` (inference).
`bindings` declares the C functions of kernels.c.
"""
