"""The inverse model of several tasks, on any frames of any system."""
