"""Mathematics that several parts need, each piece once."""
