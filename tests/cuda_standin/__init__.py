"""Kernels for CUDA, looked at and run where there is no GPU; see README.md."""
