"""What all answers share: request, choice of a solver, evidence, and the words for it."""
