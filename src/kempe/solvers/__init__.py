"""Which configurations do what is required: the inverse model."""
