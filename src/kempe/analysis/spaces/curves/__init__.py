"""Configuration spaces with one freedom as curves, whose components are proven."""
