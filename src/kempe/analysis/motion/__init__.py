"""How a mechanism moves, alone or driven."""
