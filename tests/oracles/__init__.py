"""Independent answers in numpy: closures by joint type and maximal coordinates, without kernels."""
