"""What a frame reaches: maps, exact regions, reach studies, files."""
