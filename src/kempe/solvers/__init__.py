"""Which configurations do what is asked: the inverse model."""
