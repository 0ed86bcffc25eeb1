"""What all solvers share: questions, answers, targets, proofs, the clock, and the tracer of curves."""
