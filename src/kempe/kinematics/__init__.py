"""Where everything is: the forward model, the configuration space, constraints."""
