"""What the layers from here on share: results of verbs, tables of numbers, Gauss-Newton steps,
threads.
"""
