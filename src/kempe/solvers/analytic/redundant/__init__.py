"""Solutions of redundant chains as functions of a parameter."""
