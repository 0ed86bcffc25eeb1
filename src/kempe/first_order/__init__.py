"""First-order analysis at one configuration: constraint graph, screws, ranks, idle freedoms."""
