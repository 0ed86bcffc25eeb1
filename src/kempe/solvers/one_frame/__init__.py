"""The numerical inverse model of one frame of a tree."""
