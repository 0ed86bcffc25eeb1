"""All solutions of six joints in closed form."""
