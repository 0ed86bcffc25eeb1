"""How a system moves: traced, driven, rolling, simulated."""
