"""Assembly: configurations that close all loops, within one tolerance."""
