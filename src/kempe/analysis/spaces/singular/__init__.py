"""Singular configurations: where a frame, inputs or loops lose rank."""
