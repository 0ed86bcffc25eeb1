"""What must hold at a configuration: residuals and derivatives of constraints and tasks, and the
independent judge.
"""
