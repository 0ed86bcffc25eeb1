"""Values that people type, and files of them."""
