"""What a workspace holds, and how it is decided whether a pose is reached."""
