"""All solutions of six joints in general position, by elimination."""
