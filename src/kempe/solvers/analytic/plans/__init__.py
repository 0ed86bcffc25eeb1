"""How a chain is solved: its axes, what they have in common, and the plan that follows."""
