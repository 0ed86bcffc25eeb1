"""The true local dimension of a mechanism, from higher derivatives."""
