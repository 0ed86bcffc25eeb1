"""One step of the differential inverse model."""
