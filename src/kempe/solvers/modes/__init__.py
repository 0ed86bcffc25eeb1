"""All assembly modes."""
