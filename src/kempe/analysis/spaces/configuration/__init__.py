"""The configuration space of a system: its shape and dimension, samples, components, ways through
it.
"""
