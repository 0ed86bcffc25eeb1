"""The inverse geometric model in closed form and by elimination: every configuration that reaches a
target.
"""
