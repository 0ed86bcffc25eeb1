"""The page in which a system is seen and moved: what it shows, what it answers, and how it is sent
to a browser."""
