"""The only compiled code: kernels that know arrays, not the classes."""
