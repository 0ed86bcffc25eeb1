"""Where everything is, in numbers and in symbols."""
