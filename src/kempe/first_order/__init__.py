"""Velocities at one configuration: constraint graph, screws, ranks, idle freedoms."""
