"""What is recognised in a chain, in words."""
