"""How many degrees of freedom, and why."""
