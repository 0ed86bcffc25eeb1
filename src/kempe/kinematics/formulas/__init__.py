"""Models as formulas, by sympy."""
