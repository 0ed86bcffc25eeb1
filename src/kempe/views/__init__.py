"""What people look at: reports, data for JSON, drawings."""
