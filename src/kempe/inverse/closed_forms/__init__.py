"""Plans by which a chain is solved in closed form or by elimination."""
