"""Arithmetic that all kernels share: the compiler's decorators, vectors, angles, random numbers,
small matrices."""
