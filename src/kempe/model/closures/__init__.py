"""Loop closures and declared constraints, as rows for the kernels."""
