"""What Jacobians say of a mechanism: counting, rank, redundant constraints, idle freedoms,
wrenches.
"""
